# Everything is kept in .venv, made from this tree's own files; nothing else on the machine is touched.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check
DATA ?= ../shared/data
CASES ?= 3000
SEED ?= 41
JOBS ?= 2
WORKERS ?= 3
BUILD ?= build
DIST ?= dist
CAMPAIGN ?= build/blind-$(SEED)-$(CASES)

.PHONY: all demo test test-slow lint schemas catalogues wheel lock sbom benchmark campaign campaign-real worlds faults tampering fuzz clean

all: $(READY)

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "planrunner needs Python 3.11 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes --requirement constraints.txt
	$(INSTALL) --no-deps --no-build-isolation --editable .
	touch $@

demo: $(READY)
	$(BIN)/planrunner check plans/flexure_gyro_eight_position.yaml
	$(BIN)/planrunner run plans/flexure_gyro_eight_position.yaml --set device_serial=DEMO-1 --set operator=demo --runs runs

# Three workers for two cores: some tests wait for a process that they started. Each worker computes in one thread.
test test-slow fuzz: export OMP_NUM_THREADS := 1
test test-slow fuzz: export OPENBLAS_NUM_THREADS := 1
test: $(READY)
	$(BIN)/pytest -n $(WORKERS) -m 'not slow'

test-slow: $(READY)
	$(BIN)/pytest -n $(WORKERS) -m slow --durations=60

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

schemas: $(READY)
	$(BIN)/python -m planrunner.tasks.write_schemas schemas

# Texts of the certificate and of the estimators into locales/, where translators continue.
catalogues: $(READY)
	$(BIN)/pybabel extract --mapping babel.cfg --keywords said --keywords counted:1,2 --omit-header --no-location --no-wrap --sort-output --output locales/planrunner.pot .
	for catalogue in locales/*.po; do \
	  $(BIN)/pybabel update --input-file locales/planrunner.pot --output-file $$catalogue --locale $$(basename $$catalogue .po) \
	    --omit-header --no-wrap --no-fuzzy-matching --ignore-obsolete; done

benchmark: $(READY)
	$(INSTALL) --require-hashes --requirement constraints-benchmarks.txt
	$(BIN)/python -m benchmarks

# Coverage of the intervals and warnings in independent worlds; hours with RUNS=1000. Goes on where it stopped.
worlds: RUNS ?= 200
worlds: $(READY)
	mkdir -p build
	$(BIN)/python -m tests.worlds --runs $(RUNS) --keep build/worlds.jsonl

# Recordings with sealed effects, answered by the diagnosis, an oracle and baselines; goes on where it stopped. See docs/blind-campaign.md.
campaign: export OMP_NUM_THREADS := 1
campaign: $(READY)
	mkdir -p build
	$(BIN)/python -m tests.blind make $(CASES) --seed $(SEED) --jobs $(JOBS) $(CAMPAIGN)
	$(BIN)/python -m tests.blind answer $(CAMPAIGN) --jobs $(JOBS) --by planrunner --by oracle \
	  --by stepwise-bic --by whitened-bic --by lasso --by stlsq
	$(BIN)/python -m tests.blind score $(CAMPAIGN) --json $(CAMPAIGN)/score.json

# The same with the noise of real recordings at rest, answered by the diagnosis alone.
campaign-real: export OMP_NUM_THREADS := 1
campaign-real: REAL ?= build/real-$(SEED)-$(CASES)
campaign-real: $(READY)
	mkdir -p build
	$(BIN)/python -m tests.blind make $(CASES) --seed $(SEED) --jobs $(JOBS) --real-noise $(REAL)
	$(BIN)/python -m tests.blind answer $(REAL) --jobs $(JOBS)
	$(BIN)/python -m tests.blind score $(REAL) --json $(REAL)/score.json

# Every fault of the table and 200 random ones on a simulated bench, in processes (an hour or so). See docs/fault-campaign.md.
faults: $(READY)
	PLANRUNNER_FAULTS=all $(BIN)/pytest -n $(JOBS) -m 'slow or not slow' tests/faults

# Changes of runs and of the log of an archive: 10 000 random flips, and a writer killed at every write (a quarter of an hour).
tampering: $(READY)
	PLANRUNNER_FLIPS=10000 PLANRUNNER_KILLS=1 $(BIN)/pytest -n $(JOBS) -m 'slow or not slow' tests/tasks/test_verify.py \
	  tests/tasks/test_run_log.py tests/tasks/test_time_stamps.py tests/archive/test_verifying_by_hand.py

# Mutated plans: 30 000 checked, 60 000 held against the schema, 30 000 compared with their originals (an hour or so). Then 20 000 plans,
# checked and run (an hour or two).
fuzz: $(READY)
	PLANRUNNER_FUZZ=30000 $(BIN)/pytest -n $(JOBS) -m slow tests/plan tests/review/test_mutants.py
	PLANRUNNER_AGREEMENT=20000 $(BIN)/pytest -n $(JOBS) --dist load -m slow tests/agreement/test_check_agrees_with_run.py

wheel: $(READY)
	$(BIN)/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .

# The versions and hashes that everything above installs, for every Python and platform: after a change of the dependencies in
# pyproject.toml, or with UPGRADE=--upgrade for newer versions.
LOCK = $(BIN)/uv pip compile pyproject.toml --quiet --universal --python-version 3.11 --generate-hashes --no-annotate --no-emit-index-url \
  --custom-compile-command 'make lock'
lock: $(READY)
	$(LOCK) $(UPGRADE) --extra dev --extra bench --output-file constraints-benchmarks.txt
	$(LOCK) --constraint constraints-benchmarks.txt --extra dev --output-file constraints.txt
	$(LOCK) --constraint constraints.txt --output-file constraints-runtime.txt

# What planrunner runs on (components, licences, what needs what), as CycloneDX JSON.
sbom: $(READY)
	$(PYTHON) -m venv --clear --without-pip $(BUILD)/runtime
	$(BIN)/pip --python $(BUILD)/runtime/bin/python install --quiet --disable-pip-version-check --require-hashes \
	  --requirement constraints-runtime.txt
	mkdir -p $(DIST)
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --validate \
	  --output-file $(DIST)/planrunner.cdx.json $(BUILD)/runtime/bin/python

clean:
	rm -rf $(VENV) dist build
