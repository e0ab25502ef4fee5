# Needs python3 (>= 3.11) with venv, and make; everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN_STAMP := $(VENV)/.installed
DEV_STAMP := $(VENV)/.installed-dev
SAMPLE := $(wildcard replay/data/*.tlog)
OUT := out
# Live tests wait most of the time; tests/conftest.py keeps them from meeting each other.
SIDE_BY_SIDE := -n 2 --dist loadgroup

.PHONY: run test test-all lint clean

run: $(RUN_STAMP)
	@mkdir -p $(OUT)
	$(BIN)/companion replay $(SAMPLE) --out $(OUT)/sample.mcap

# The kernels are compiled beforehand, so that no test measures or races a compiler.
test: $(DEV_STAMP)
	$(BIN)/python -m replay.kernels
	$(BIN)/python -m pytest $(SIDE_BY_SIDE)

# With the long fuzz runs.
test-all: $(DEV_STAMP)
	$(BIN)/python -m replay.kernels
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) -m 'slow or not slow'

lint: $(DEV_STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

$(VENV)/pyvenv.cfg:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "companion needs Python 3.11 or newer; this is " + sys.version.split()[0] + ": try make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)

$(RUN_STAMP): $(VENV)/pyvenv.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(DEV_STAMP): $(VENV)/pyvenv.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@ $(RUN_STAMP)

clean:
	rm -rf $(VENV) $(OUT) build *.egg-info companion/__pycache__/kernels-*
