# make demo   a film and a picture of an LWR mirrored from UDP packets, under out/
# make test   the tests
# make lint   style and types
# make bench  benchmarks, as ratios
# make wheel  build the wheel, install it elsewhere, try it from another directory

BIN := .venv/bin
PORT ?= 32000

.PHONY: demo test lint bench wheel clean

.venv/.installed: pyproject.toml .ci/setup
	@.ci/setup

demo: .venv/.installed
	@$(BIN)/python -m sero_mj.demo --port $(PORT)

test: .venv/.installed
	$(BIN)/python -m pytest -q

lint: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: .venv/.installed
	$(BIN)/python benchmarks/run.py

wheel: .venv/.installed
	.ci/try-wheel

clean:
	rm -rf .venv out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
