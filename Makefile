# make demo   a film and a picture of an LWR mirrored from UDP packets, under out/
# make test   the tests
# make quick  those of logic: without windows, browsers, films and what else is slow
# make mutations   whether every scenario notices what may be wrong in it
# make lint   style and types
# make docs   out/docs/index.html
# make bench  benchmarks, as ratios
# make foreign   robots of example-robot-data, robosuite and dm_control (350 MB from PyPI), compared
# make gallery   docs/gallery.md and its pictures
# make wheel  dist/*.whl, with models and scenes inside

BIN := .venv/bin
# Tests start some hundred programs; without compiled files each would compile all of ours anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test quick mutations lint docs bench foreign gallery wheel clean

.venv/.run .venv/.test: pyproject.toml .ci/setup
	@.ci/setup $(@:.venv/.%=%)

demo: .venv/.run
	@$(BIN)/sero-mj demo --out out

# Windows and browsers beside each other may outrun a machine of two cores, so what fails is told,
# and run once more alone; what then fails has failed.
test: .venv/.test
	$(BIN)/python -m pytest -q -n auto $(PYTEST) || \
	  $(BIN)/python -m pytest -q --last-failed --last-failed-no-failures none $(PYTEST)

quick: .venv/.test
	$(BIN)/python -m pytest -q -n auto -m "not gl and not slow and not live"

mutations: .venv/.test
	$(BIN)/python -m pytest -q -n auto --hypothesis-profile=everything tests/test_mutations.py

lint: .venv/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

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

foreign: .venv/.test
	$(BIN)/python -m pip install --quiet --group foreign
	$(BIN)/python -m pip install --quiet --no-deps "robosuite>=1.5"  # its models alone
	$(BIN)/python benchmarks/foreign.py
	$(BIN)/python benchmarks/foreign_mjcf.py

gallery: .venv/.run
	$(BIN)/python docs/gallery.py $(SHOTS)

wheel: .venv/.test
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
