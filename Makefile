# make demo: install what is locked, run the main job. make test: install, then every check. Both work on a fresh machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ROOMS := wingbeat fsw hal sim telemetry fault tests

# Tests that the flight core's protection has to itself: every branch taken, and mutants killed.
CORE_TESTS := tests/test_fault_*.py

.PHONY: demo setup test lint check coverage mutation lock clean

demo: $(VENV)/ready
	$(BIN)/wingbeat sil paper

setup: $(VENV)/ready

test: lint coverage check

lint: $(VENV)/ready-test
	$(BIN)/ruff check $(ROOMS)
	$(BIN)/ruff format --check $(ROOMS)
	$(BIN)/mypy
	$(BIN)/lint-imports

check: $(VENV)/ready-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile -m "not alone"
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m alone

# Every branch of fault protection, tables and commands.
coverage: $(VENV)/ready-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile $(CORE_TESTS) --cov=fault --cov-branch --cov-report=term:skip-covered \
		--cov-fail-under=100

# How many small errors in the same files the same tests notice; about ten minutes. Results stay in mutants/.
mutation: $(VENV)/ready-test
	$(BIN)/python -m mutmut run > mutants.log 2>&1 || true
	tail -c 200 mutants.log

$(VENV)/ready: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

$(VENV)/ready-test: requirements-test.lock $(VENV)/ready
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-test.lock
	touch $@

# Exact versions for the ranges of pyproject.toml, without the address of any index.
lock: $(VENV)/ready-test
	$(BIN)/pip install --quiet pip-tools
	$(BIN)/pip-compile --quiet --no-emit-index-url --no-emit-find-links --no-emit-trusted-host --strip-extras \
		--all-build-deps --allow-unsafe -o requirements.lock pyproject.toml
	$(BIN)/pip-compile --quiet --no-emit-index-url --no-emit-find-links --no-emit-trusted-host --strip-extras \
		--extra test -o requirements-test.lock -c requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) runs build mutants mutants.log .coverage *.egg-info
