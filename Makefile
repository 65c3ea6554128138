# Needs only Python 3.11 or newer and make. Everything else goes into .venv.
# Another Python: make test PYTHON=/path/to/python3.12

PYTHON ?= $(shell command -v python3.11 || command -v python3)
TASK ?= wall
ARM ?= neatq
ARENAS ?= 1
SEED ?= 0
OUT ?= runs/$(subst :,-,$(subst /,-,$(TASK)))-$(ARM)-$(shell date +%Y%m%d-%H%M%S)

# The length of a run: TICKS in worlds of robots, GENERATIONS on Gymnasium tasks; else the task's own.
TICKS ?=
GENERATIONS ?=
LENGTH = $(if $(TICKS),--ticks $(TICKS)) $(if $(GENERATIONS),--generations $(GENERATIONS))

# Inputs of each kind for make fuzz: minutes.
INPUTS ?= 100000

# Test processes; 0 runs the tests in one process, which is easier to debug.
WORKERS ?= 2

# How often `make soak` kills: an hour or less for each hundred.
KILLS ?= 50

VENV := .venv
# Windows has its programs elsewhere.
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
# Without --no-compile all of torch is compiled to bytecode, of which a tenth is imported.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable
WHEEL_DIR := build/wheel

# One thread for each test process: many small tensors, and the same sums in the same order.
export OMP_NUM_THREADS := 1

.DEFAULT_GOAL := help
.PHONY: help train test style compiled docs bench fuzz soak format clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-8s %s\n", $$1, $$2}' Makefile

train: $(VENV)/train.stamp ## train (TASK, ARM, TICKS or GENERATIONS, ARENAS, SEED, OUT), results in runs/
	$(BIN)/neatq train --task $(TASK) --arm $(ARM) $(LENGTH) --arenas $(ARENAS) --seed $(SEED) \
	    --out $(OUT)

test: $(VENV)/test.stamp ## check everything: style, types, layers, wheel, site, tests, notebooks
	$(MAKE) --no-print-directory --jobs 2 style compiled
	$(BIN)/python -m pytest -n $(WORKERS)

# Both take one core, for about as long.
style:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	rm -rf $(WHEEL_DIR)
	$(BIN)/python -m build --wheel --no-isolation --outdir $(WHEEL_DIR)
	$(BIN)/check-wheel-contents $(WHEEL_DIR)
	$(BIN)/pyright --pythonpath $(BIN)/python

compiled:
	$(BIN)/python tests/compiled.py

docs: $(VENV)/docs.stamp ## build the site into build/site; a broken link is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(VENV)/bench.stamp ## measure what the parts cost, minutes for each row; results in docs/benchmarks.md
	$(BIN)/python -m benchmarks --save

fuzz: $(VENV)/test.stamp ## read INPUTS mutated genomes, scenarios, configurations and checkpoints, each
	$(BIN)/python -m benchmarks.fuzz --inputs $(INPUTS)

soak: $(VENV)/test.stamp ## kill runs at random moments, KILLS times, and compare with runs that nobody killed
	$(BIN)/python -m benchmarks.soak --kills $(KILLS)

format: $(VENV)/test.stamp ## mend style and order of imports
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean: ## remove .venv, build outputs and caches; runs/ stays
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps make the installation happen once, and again when a dependency changes.
$(VENV)/train.stamp: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "Python 3.11 or newer is needed; got: $(PYTHON). Try: make PYTHON=python3.12 ..."; exit 1; }
	@echo "Installing into $(VENV). This happens once and takes a minute or two."
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) .
	@touch $@

$(VENV)/test.stamp: $(VENV)/train.stamp
	$(INSTALL) '.[dev]'
	@touch $@

$(VENV)/docs.stamp: $(VENV)/train.stamp
	$(INSTALL) '.[docs]'
	@touch $@

$(VENV)/bench.stamp: $(VENV)/train.stamp
	$(INSTALL) '.[bench,box2d]'
	@touch $@
