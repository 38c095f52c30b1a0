# make demo        render a video and an image of an LWR mirrored from UDP packets to out/
# make test        run the tests
# make thorough    run the tests with all cases, and the short robustness report: every night, and
#                  before closing an issue
# make quick       run the tests that need no windows, browsers or videos, and are not slow
# make core        run the quick tests of the core with all extensions blocked
# make mutations   test whether each scenario detects the faults in tests/mutations; on a cluster
#                  with ENGINE="--engine dask --scheduler tcp://head:8786"
# make lint        check style, types, spelling and words
# make docs        build out/docs/index.html
# make bench       run benchmarks, which print ratios
# make peers       update docs/peers.md: the same tasks with Pinocchio, viser, MeshCat, rerun and
#                  others (10 GB from PyPI)
# make robustness  write out/robustness/index.html: fuzzing, faults, a run of 10 minutes; QUICK=1 for
#                  a short run, SECONDS=86400 for a day, SEED=N to repeat the cases of a run
# make verdicts    measure how often the verdicts of compare are right, by their confidence (1 hour);
#                  writes out/verdicts; VERDICTS="--robots lwr --seeds 1" for a shorter run
# make foreign     compare robots of example-robot-data, robosuite and dm_control (350 MB from PyPI)
# make gallery     update docs/gallery.md and its images
# make oldest      run the quick tests with the oldest package versions that pyproject.toml allows
# make wheel       build dist/*.whl with models and scenes, its hash, and the list of its dependencies

BIN := .venv/bin
# Tests start some hundred programs; without compiled files, each one would compile all modules.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test thorough quick core mutations oldest lint docs bench peers robustness verdicts foreign gallery wheel clean

.venv/.run .venv/.test: pyproject.toml .ci/setup
	@.ci/setup $(@:.venv/.%=%)

demo: .venv/.run
	@$(BIN)/sero-mj demo --out out

# Parallel windows and browsers can overload a machine with two cores, so failed tests are reported
# and repeated alone.
test: .venv/.test
	$(BIN)/python -m pytest -q -n auto $(PYTEST) || \
	  $(BIN)/python -m pytest -q --last-failed --last-failed-no-failures none $(PYTEST)
	$(BIN)/python -m pytest -q -m realtime $(PYTEST)

thorough:
	$(MAKE) test PYTEST="--no-skips --hypothesis-profile=thorough"
	$(MAKE) robustness QUICK=1

quick: .venv/.test
	$(BIN)/python -m pytest -q -n auto -m "not gl and not slow and not live"

# The core must work without extensions.
core: .venv/.test
	PYTHONPATH=tests/blocking $(BIN)/python -m pytest -q -n auto --ignore tests/extensions \
	  -m "not gl and not slow and not live and not extensions"

mutations: .venv/.test
	@undetected=0; for file in tests/mutations/*.toml; do \
	  $(BIN)/sero-mj sweep $$(basename $$file .toml) --mutations $$file $(ENGINE) || undetected=1; \
	done; exit $$undetected

lint: .venv/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	.ci/js check
	$(BIN)/codespell README.md CONTRIBUTING.md CHANGELOG.md docs models scenes sero_mj
	$(BIN)/python .ci/words.py

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

verdicts: .venv/.test
	$(BIN)/python benchmarks/verdicts $(VERDICTS)

foreign: .venv/.test
	$(BIN)/python -m pip install --quiet --group foreign
	$(BIN)/python -m pip install --quiet --no-deps "robosuite>=1.5"  # its models alone
	$(BIN)/python benchmarks/foreign.py
	$(BIN)/python benchmarks/foreign_mjcf.py

gallery: .venv/.run
	$(BIN)/python docs/gallery.py $(SHOTS)

# A release consists of sdist and wheel, their hashes, and a CycloneDX list of all packages that an
# installation of the wheel installs, with versions and licenses.
wheel: .venv/.test
	rm -rf dist
	$(BIN)/python -m pip install --quiet build cyclonedx-bom
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m venv --clear .peers/wheel
	.peers/wheel/bin/python -m pip install --quiet dist/*.whl
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible \
	  -o dist/sbom.json .peers/wheel/bin/python
	cd dist && sha256sum *.whl *.tar.gz sbom.json > SHA256SUMS

OLDEST := figures,fmu,foxglove,gltf,gymnasium,identify,notebook,ros2,xacro,zenoh,camera
oldest: .venv/.test
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python .peers/oldest
	$(BIN)/uv pip install --quiet --python .peers/oldest/bin/python --resolution lowest-direct \
	  --group dev --editable ".[$(OLDEST)]"
	.peers/oldest/bin/python -m pytest -q -n auto -m "not gl and not slow and not live" \
	  -W "ignore::DeprecationWarning" tests

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
