# The recipes of the project; `.ci/run` calls the same ones.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

# On the command line, not from the environment: `clean` removes them, and others use these names, too.
VENV := .venv
OUT := demo-out
BIN := $(VENV)/bin
READY := $(VENV)/.ready
# An environment holds this folder and its own in full: one that was moved or copied, or whose interpreter is gone, is
# set up anew. Set-up writes both folders into .ready.
SOUND := $(shell { [ "$$(cat "$(READY)")" = "$$(realpath . "$(VENV)")" ] && "$(BIN)/python" -SEc ''; } 2>/dev/null && echo yes)
export VENV PYTHON TORCH_INDEX

.PHONY: help setup demo test lint format docs bench bench-solver serve lock clean unsound

help: ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 22

setup: $(READY) ## system packages, virtual environment, pinned requirements

$(READY): requirements.txt requirements-dev.txt pyproject.toml scripts/setup.sh scripts/system-packages.sh scripts/find-python.sh $(if $(SOUND),,unsound)
	@scripts/setup.sh

demo: $(READY) ## the whole chain, small, into demo-out/ (OUT=folder)
	@$(BIN)/drapemeter demo --out "$(OUT)"

test: $(READY) ## the test suite, in two halves side by side (ARGS="tests/simcore -k bending" for a part)
	@$(if $(ARGS),$(BIN)/python -m pytest $(ARGS),scripts/test.sh $(BIN)/python) \
	    && echo "make test: all tests passed" || { echo "make test: FAILED, see above" >&2; exit 1; }

lint: $(READY) ## ruff, ruff format, mypy strict, import order
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports
	@echo "make lint: clean"

format: $(READY) ## let ruff put the code in form
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

docs: $(READY) ## write the generated pages anew: docs/errors.md, the text of docs/effects.md
	@$(BIN)/python -m services.error_page docs/errors.md
	@$(BIN)/python -m diagnosis.pages.effect_page docs/effects.md --text

bench: $(READY) ## all of bench/ (hours; JSON under out/bench) but bench_other_simulator.py, which asks for a folder
	@failed=; for script in bench/bench_*.py; do \
	    [ "$$script" != bench/bench_other_simulator.py ] || continue; echo "== $$script"; \
	    $(BIN)/python "$$script" || failed="$$failed $$script"; done; \
	    [ -z "$$failed" ] || { echo "make bench: FAILED:$$failed" >&2; exit 1; }

bench-solver: $(READY) ## CPU seconds per drape on one core
	@OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python bench/bench_solver.py

serve: $(READY) ## the REST service on http://127.0.0.1:8000
	@$(BIN)/drapemeter serve

lock: $(READY) ## write the requirements files from what is installed
	@$(BIN)/python scripts/lock.py

clean: ## remove what the recipes made, the environment too
	@rm -rf "$(VENV)" "$(OUT)" out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis .benchmarks
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
