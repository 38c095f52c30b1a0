# make demo   a film and a picture of an LWR mirrored from UDP packets, under out/
# make test   the tests
# make thorough   the same with all cases, and the short report of robustness: every night, and before
#             an issue is closed
# make quick  those of logic: without windows, browsers, films and what else is slow
# make core   those of logic with all extensions blocked
# make mutations   whether every scenario notices what may be wrong in it; on a cluster with
#             ENGINE="--engine dask --scheduler tcp://head:8786"
# make lint   style and types, of Python and of JavaScript
# make docs   out/docs/index.html
# make bench  benchmarks, as ratios
# make peers  docs/peers.md: the same work by Pinocchio, viser, MeshCat, rerun and others (10 GB from PyPI)
# make robustness   out/robustness/index.html: fuzzing, faults, a run of 10 minutes; QUICK=1 in short,
#             SECONDS=86400 for a day, SEED=N for the cases of another run
# make foreign   robots of example-robot-data, robosuite and dm_control (350 MB from PyPI), compared
# make gallery   docs/gallery.md and its pictures
# make oldest   the quick tests with the oldest versions of packages that pyproject.toml allows
# make wheel  dist/*.whl with models and scenes inside, its hash, and a list of what it depends on

BIN := .venv/bin
# Tests start some hundred programs; without compiled files each would compile all of ours anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test thorough quick core mutations oldest lint docs bench peers robustness foreign gallery wheel clean

.venv/.run .venv/.test: pyproject.toml .ci/setup
	@.ci/setup $(@:.venv/.%=%)

demo: .venv/.run
	@$(BIN)/sero-mj demo --out out

# Windows and browsers beside each other may outrun a machine of two cores, so what fails is told,
# and run once more alone; what then fails has failed.
test: .venv/.test
	$(BIN)/python -m pytest -q -n auto $(PYTEST) || \
	  $(BIN)/python -m pytest -q --last-failed --last-failed-no-failures none $(PYTEST)
	$(BIN)/python -m pytest -q -m realtime $(PYTEST)

thorough:
	$(MAKE) test PYTEST="--no-skips --hypothesis-profile=thorough"
	$(MAKE) robustness QUICK=1

quick: .venv/.test
	$(BIN)/python -m pytest -q -n auto -m "not gl and not slow and not live"

# The quick tests of the core with all extensions blocked: it works without them.
core: .venv/.test
	PYTHONPATH=tests/blocking $(BIN)/python -m pytest -q -n auto --ignore tests/extensions \
	  -m "not gl and not slow and not live and not extensions"

mutations: .venv/.test
	@unnoticed=0; for file in tests/mutations/*.toml; do \
	  $(BIN)/sero-mj sweep $$(basename $$file .toml) --mutations $$file $(ENGINE) || unnoticed=1; \
	done; exit $$unnoticed

lint: .venv/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	.ci/js check
	$(BIN)/codespell README.md CONTRIBUTING.md CHANGELOG.md docs models scenes sero_mj

docs: .venv/.test
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going docs out/docs

bench: .venv/.test
	$(BIN)/python benchmarks/run.py
	$(BIN)/python benchmarks/streams.py
	$(BIN)/python benchmarks/controllers.py
	$(BIN)/python benchmarks/plant.py
	$(BIN)/python benchmarks/simulate.py
	$(BIN)/python benchmarks/many.py
	$(BIN)/python benchmarks/learn.py
	$(BIN)/python benchmarks/web.py

peers: .venv/.test
	$(BIN)/python benchmarks/peers.py

robustness: .venv/.test
	$(BIN)/python benchmarks/robustness.py $(if $(QUICK),--quick) \
	  $(if $(SECONDS),--seconds $(SECONDS)) $(if $(SEED),--seed $(SEED))

foreign: .venv/.test
	$(BIN)/python -m pip install --quiet --group foreign
	$(BIN)/python -m pip install --quiet --no-deps "robosuite>=1.5"  # its models alone
	$(BIN)/python benchmarks/foreign.py
	$(BIN)/python benchmarks/foreign_mjcf.py

gallery: .venv/.run
	$(BIN)/python docs/gallery.py $(SHOTS)

# What a release is: sdist and wheel, their hashes, and all packages that an installation of the
# wheel alone brings, with versions and licences (CycloneDX).
wheel: .venv/.test
	rm -rf dist
	$(BIN)/python -m pip install --quiet build cyclonedx-bom
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m venv --clear .peers/wheel
	.peers/wheel/bin/python -m pip install --quiet dist/*.whl
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible \
	  -o dist/sbom.json .peers/wheel/bin/python
	cd dist && sha256sum *.whl *.tar.gz sbom.json > SHA256SUMS

OLDEST := figures,fmu,foxglove,gltf,gymnasium,notebook,ros2,xacro,zenoh,camera
oldest: .venv/.test
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python .peers/oldest
	$(BIN)/uv pip install --quiet --python .peers/oldest/bin/python --resolution lowest-direct \
	  --group dev --editable ".[$(OLDEST)]"
	.peers/oldest/bin/python -m pytest -q -n auto -m "not gl and not slow and not live" \
	  -W "ignore::DeprecationWarning" tests

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
