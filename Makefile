# Everything is kept in .venv, made from this tree's own files; nothing else on the machine is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DATA ?= ../shared/data

.PHONY: all demo test test-slow lint schemas catalogues wheel benchmark clean

all: $(READY)

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "planrunner needs Python 3.11 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: $(READY)
	$(BIN)/planrunner check plans/flexure_gyro_eight_position.yaml
	$(BIN)/planrunner run plans/flexure_gyro_eight_position.yaml --set device_serial=DEMO-1 --set operator=demo --runs runs

test: $(READY)
	$(BIN)/pytest -n 2 -m 'not slow'

test-slow: $(READY)
	$(BIN)/pytest -n 2 -m slow

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

schemas: $(READY)
	$(BIN)/python -m planrunner.plan.schema schemas

# Texts of the templates into locales/, where translators go on.
catalogues: $(READY)
	$(BIN)/pybabel extract --mapping babel.cfg --omit-header --no-location --no-wrap --sort-output --output locales/planrunner.pot .
	for catalogue in locales/*.po; do \
	  $(BIN)/pybabel update --input-file locales/planrunner.pot --output-file $$catalogue --locale $$(basename $$catalogue .po) \
	    --omit-header --no-wrap --no-fuzzy-matching --ignore-obsolete; done

benchmark: $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[bench]'
	$(BIN)/python -m benchmarks

wheel: $(READY)
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) dist build
