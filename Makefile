# One line a target; everything runs in .venv, installed from the lock.
PYTHON ?= python3
BIN := .venv/bin
SCENARIO ?= handover
# Small matrices: threads would only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: docs help install run test test-long fuzz hostile pictures bless lint type imports check bench lock wheel clean

help:       ## say what there is
	@grep -E '^[a-z-]+: .*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 14

install: .venv/installed .venv/compiled  ## set up .venv for development, and compile the laws of a tick

# What a run needs; everything else comes with `install`.
.venv/run: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' || { echo "Python 3.11 or 3.12 is needed, $(PYTHON) is another; say PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

.venv/installed: requirements-dev.lock .venv/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

.venv/compiled: .venv/run $(wildcard workcell/control/laws/*.py)
	@$(BIN)/workcell compile
	@touch $@

run: .venv/run .venv/compiled  ## run a scenario headlessly into runs/ (SCENARIO=handover)
	$(BIN)/workcell run $(SCENARIO)

test: install  ## the tests, under five minutes on two cores
	$(BIN)/python -m pytest -n 2

test-long: install  ## the suites that take longer
	$(BIN)/python -m pytest -n 2 -m long

fuzz: install  ## 5,800 mutated inputs, seeded: none may end in a traceback, a hang or two gigabytes
	$(BIN)/python -m tests.fuzz

pictures: install  ## make the pictures of README and docs anew, from the reference runs
	$(BIN)/python docs/images/make.py

hostile: install  ## a thousand judged runs against a hostile hand, into runs/hostile (RUNS=1000)
	$(BIN)/python -m workcell.study.hostile --runs $(or $(RUNS),1000)

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

RESOLVE := --universal --python-version 3.11 --generate-hashes --quiet --no-emit-index-url --no-emit-find-links
lock: install  ## resolve both lock files anew
	$(BIN)/uv pip compile pyproject.toml --group build --group dev --group docs --all-extras $(RESOLVE) --output-file requirements-dev.lock
	$(BIN)/uv pip compile pyproject.toml --group build $(RESOLVE) --constraint requirements-dev.lock --output-file requirements.lock

docs: install  ## build the documentation site into .site/; a warning is an error
	$(BIN)/mkdocs build --quiet

wheel: install  ## build the wheel into dist/
	$(BIN)/python -m hatchling build --target wheel

clean:      ## remove what was made
	rm -rf .venv dist runs .benchmarks
