# Everything runs in .venv, made on first use. `make help` lists the targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# setuptools warns of what an editable installation is.
PIP := PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
PROGRAM_INSTALLED := $(VENV)/.installed-program
INSTALLED := $(VENV)/.installed
BENCH_INSTALLED := $(VENV)/.installed-bench
SPEED_INSTALLED := $(VENV)/.installed-speed
RELEASE_INSTALLED := $(VENV)/.installed-release
SIMULATORS_INSTALLED := $(VENV)/.installed-simulators

.PHONY: help demo test test-all test-web quick mutate check accept accept-short bench bench-accuracy bench-truth bench-speed fuzz soak soak-short \
  docs pictures sample dist dist-try release-check \
  bench-public startup lock clean
.DEFAULT_GOAL := help

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

$(PROGRAM_INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or newer is needed; name one with: make PYTHON=python3.12 ..." >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable .
	@touch $@

# The pip of Python 3.11 and 3.12 knows no dependency groups.
$(INSTALLED): $(PROGRAM_INSTALLED)
	$(PIP) 'pip>=25.1'
	$(PIP) --editable '.[fleet,cluster,mcap]' --group dev
	@touch $@

demo: $(PROGRAM_INSTALLED) ## fly the emulator and identify it on the live screen
	$(BIN)/gcs-sysid demo

# What the tests of exports load their files with: 60 MB without what they draw and train with.
$(SIMULATORS_INSTALLED): $(INSTALLED)
	$(PIP) --no-deps mujoco mujoco-core rotorpy drake
	@touch $@

# One thread a process: more would only wait for each other.
test test-all test-web quick mutate soak soak-short: export OMP_NUM_THREADS = 1
# Workers and the programs that tests start would compile every file again: bytecode is kept,
# whatever PYTHONDONTWRITEBYTECODE says, beside its source, where that of packages lies already.
test test-all test-web quick mutate: export PYTHONDONTWRITEBYTECODE =

test: $(SIMULATORS_INSTALLED) ## the tests
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test-all: $(SIMULATORS_INSTALLED) ## those too that repeat on more flights what others show on one
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m ''

# Debian: apt-get install chromium npm
AXE := build/node_modules/axe-core/axe.min.js
$(AXE):
	npm install --silent --no-save --prefix build axe-core@4.14.1

test-web: $(INSTALLED) $(AXE) ## the pages in a Chromium, with axe-core from npm
	$(BIN)/python -m pytest -n 0 tests/web -m ''

quick: $(SIMULATORS_INSTALLED) ## the tests without whole flights
	$(BIN)/python -m pytest -n auto --dist loadfile -m "not slow and not thorough"

# Not on Windows: mutants are loaded in forked processes. MODULES="signals/smoothers.py ..." SAMPLE=0
# for all mutants of some modules.
SAMPLE ?= 20
mutate: $(INSTALLED) ## the tests against SAMPLE mutants of each module of the core (15 min)
	$(BIN)/python tools/mutate.py --sample $(SAMPLE) $(MODULES)

check: $(INSTALLED) ## lint, format, types, import contracts, prose, known vulnerabilities
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/prose.py
	$(BIN)/python tools/audit.py

FUZZ_INPUTS ?= 1000000
fuzz: $(INSTALLED) ## fuzz every reader with FUZZ_INPUTS inputs, found ones into build/fuzz
	@$(PIP) --group fuzz || echo "no atheris: inputs are drawn at random"
	$(BIN)/python -m benchmarks.reliability.fuzz --inputs $(FUZZ_INPUTS)

accept accept-short: export OMP_NUM_THREADS = 1
accept: $(SIMULATORS_INSTALLED) ## is it still right? digits, and figures beside the stored ones (30 min)
	$(BIN)/python -m benchmarks.accept

accept-short: $(INSTALLED) ## some rows of each kind, as CI runs them (4 min)
	$(BIN)/python -m benchmarks.accept --short

bench: $(INSTALLED) ## cost of emulator, estimator and live session, and of commands against the last release
	$(BIN)/python -m benchmarks.cost
	$(BIN)/python -m benchmarks.accept judge --only cost

$(BENCH_INSTALLED): $(INSTALLED)
	$(PIP) --group bench
	@touch $@

bench-accuracy: $(BENCH_INSTALLED) ## Monte Carlo over seeds: docs/accuracy.md (15 min)
	$(BIN)/python -m benchmarks.accuracy

VEHICLES ?= 8
RECORDED ?= $(wildcard ../shared/logs)
bench-truth: export OMP_NUM_THREADS = 1
bench-truth: $(SIMULATORS_INSTALLED) ## vehicles that are not the model: docs/truth.md; VEHICLES=...
	$(BIN)/python -m benchmarks.truth --vehicles $(VEHICLES) $(addprefix --logs ,$(RECORDED))

$(SPEED_INSTALLED): $(INSTALLED)
	@$(PIP) 'scikit-build-core>=0.10' 'pybind11>=2.13'
	@for reader in fasttlogparser mavpose; do \
	  $(PIP) --no-build-isolation $$reader || echo "$$reader cannot be installed: left out"; \
	done
	@touch $@

RECORDED_LOGS = $(addprefix --logs ,$(RECORDED))
bench-public: export OMP_NUM_THREADS = 1
bench-public: $(BENCH_INSTALLED) $(SIMULATORS_INSTALLED) ## outside estimators on the same flights: docs/benchmark.md
	$(BIN)/python -m benchmarks.public $(RECORDED_LOGS)

startup: $(INSTALLED) ## how long every command takes to start
	$(BIN)/python -m benchmarks.startup

bench-speed: $(SPEED_INSTALLED) ## reading logs, against other readers (10 min)
	$(BIN)/python -m benchmarks.speed

MINUTES ?= 60
soak: $(INSTALLED) ## flights with faults drawn at random, an hour long; MINUTES=...
	$(BIN)/python -m benchmarks.reliability.soak --minutes $(MINUTES)

soak-short: $(INSTALLED) ## the same, five minutes of flight
	$(BIN)/python -m benchmarks.reliability.soak --flights 5

docs: $(INSTALLED) ## the documentation as a site, into build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

pictures: $(INSTALLED) ## the documentation's pictures of screen and report (needs a Chromium)
	$(BIN)/python tools/screenshot.py --demo -o docs/screen.svg
	$(BIN)/python tools/screenshot.py --demo --keys l --size 100x30 -o docs/pilot.svg
	$(BIN)/python tools/report_picture.py -o docs/report.png

sample: $(INSTALLED) ## the sample flight under logs/
	$(BIN)/sim-bridge --airframe paper --mission paper --noise paper --sigma 0.02 --rate 20 \
	  --seed 1 --speed max --force --tlog logs/sample.tlog --truth logs/sample.truth.json

$(RELEASE_INSTALLED): $(INSTALLED)
	$(PIP) --group release
	@touch $@

# GCS_SYSID_URL, the address to publish, makes the links of the README whole: see setup.py.
dist: $(RELEASE_INSTALLED) ## sdist and wheel into dist/, checked
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl

PYTHONS ?= $(PYTHON)
dist-try: dist ## install what is in dist/ in clean environments; PYTHONS="python3.12 ..."
	$(BIN)/python tools/try_wheel.py $(PYTHONS)

VERSION ?= $(shell $(PYTHON) -c 'import sys; sys.path.insert(0, "src"); import gcs_sysid; print(gcs_sysid.__version__)')
release-check: dist-try check soak-short ## what a release must pass; VERSION=... names its notes
	$(BIN)/python tools/audit.py --release
	$(BIN)/python tools/release_notes.py $(VERSION)

lock: $(RELEASE_INSTALLED) ## constraints.txt and hashes of its files into requirements.lock
	$(BIN)/python tools/lock.py

clean: ## remove the virtual environment and caches
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
