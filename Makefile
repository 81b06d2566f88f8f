# make demo: install what is locked, run the main job. make test: install, then every check. Both work on a fresh machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ROOMS := wingbeat fsw hal sim telemetry fault tests

# Fault protection, tables and commands, and the tests that they have to themselves: every branch is taken.
CORE := fault fsw.tables fsw.commands telemetry.commands telemetry.uplink telemetry.mavlink_packet telemetry.mavlink_uplink
CORE_TESTS := $(wildcard tests/test_fault_*.py tests/test_table*.py) tests/test_commands.py tests/test_mavlink_uplink.py \
	tests/test_uplink.py tests/test_scenario.py tests/test_bad_input.py

# Tests that need the machine for themselves: no other file need be read for them.
ALONE_TESTS := $(shell grep -l "mark.alone" tests/test_*.py)

.PHONY: demo setup test kernels lint check coverage mutation lock clean

demo: kernels
	$(BIN)/wingbeat sil paper

setup: $(VENV)/ready

# Kernels are compiled once, beside what needs none of them; two workers of pytest would each compile all.
test: $(VENV)/ready
	$(MAKE) -j 2 kernels lint
	$(MAKE) check
	$(MAKE) coverage

kernels: $(VENV)/ready
	$(BIN)/wingbeat compile

lint: $(VENV)/ready-test
	$(BIN)/ruff check $(ROOMS)
	$(BIN)/ruff format --check $(ROOMS)
	$(BIN)/mypy
	$(BIN)/lint-imports

# Files in their order: those with the fewest tests, which would else come last, are the longest.
check: $(VENV)/ready-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not alone" $(CORE_TESTS:%=--ignore=%)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m alone $(ALONE_TESTS)

coverage: $(VENV)/ready-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile $(CORE_TESTS) $(CORE:%=--cov=%) --cov-branch \
		--cov-report=term-missing:skip-covered --cov-fail-under=100

# How many small errors in fault protection, tables and commands their tests notice; long. Results stay in mutants/.
mutation: $(VENV)/ready-test
	OMP_NUM_THREADS=1 $(BIN)/python -m mutmut run > mutants.log 2>&1 || true
	$(BIN)/python -m mutmut export-cicd-stats && cat mutants/mutmut-cicd-stats.json

# Byte code is made on all cores, where pip uses one, and none of other people's tests. It only saves time later: as with
# pip, a file of theirs that this Python cannot compile is no failure.
$(VENV)/ready: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	$(BIN)/python -m compileall -qq -j 0 -x '/tests/' $(VENV)/lib || true
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
