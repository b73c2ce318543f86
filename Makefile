# One line a target; everything runs in .venv, installed from the lock.
PYTHON ?= python3
BIN := .venv/bin
SCENARIO ?= handover
# Small matrices: threads would only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help install run test test-long bless lint type imports check bench lock wheel clean

help:       ## say what there is
	@grep -E '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 14

install: .venv/installed .venv/compiled  ## set up .venv from the lock, and compile what a tick computes

.venv/installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed, $(PYTHON) is older; say PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

# Without it everything works as well, slower.
.venv/compiled: .venv/installed $(wildcard workcell/control/kernels/*.py)
	-@$(BIN)/workcell compile
	@touch $@

run: install  ## run a scenario headlessly into runs/ (SCENARIO=handover)
	$(BIN)/workcell run $(SCENARIO)

test: install  ## the tests, under five minutes on two cores
	$(BIN)/python -m pytest -n 2

test-long: install  ## the suites that take longer
	$(BIN)/python -m pytest -n 2 -m long

bless: install  ## make what a scenario does now its reference (SCENARIO=... REASON="...")
	$(BIN)/workcell bless $(SCENARIO) --reason "$(REASON)"

lint: install  ## style
	$(BIN)/ruff check . && $(BIN)/ruff format --check .

type: install  ## types
	$(BIN)/pyright

imports: install  ## who may import whom
	$(BIN)/lint-imports

check: lint type imports  ## style, types and layering

bench: install  ## timings, as ratios within one process
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest tests/bench --benchmark-only -rs --benchmark-json=.benchmarks/latest.json

lock: install  ## resolve requirements.lock anew
	$(BIN)/uv pip compile pyproject.toml --group dev --all-extras --universal --python-version 3.11 --generate-hashes --quiet --output-file requirements.lock

wheel: install  ## build the wheel into dist/
	$(BIN)/python -m hatchling build --target wheel

clean:      ## remove what was made
	rm -rf .venv dist runs .benchmarks
