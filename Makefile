# make demo: install what is locked, run the main job. make test: install, then every check. Both work on a fresh machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ROOMS := wingbeat fsw hal sim telemetry fault tests

.PHONY: demo setup test lint check lock clean

demo: $(VENV)/ready
	$(BIN)/wingbeat sil paper

setup: $(VENV)/ready

test: lint check

lint: $(VENV)/ready-test
	$(BIN)/ruff check $(ROOMS)
	$(BIN)/ruff format --check $(ROOMS)
	$(BIN)/mypy
	$(BIN)/lint-imports

check: $(VENV)/ready-test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile -m "not alone"
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m alone

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
	rm -rf $(VENV) runs build *.egg-info
