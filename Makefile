# Two commands, on a machine with Python and make:
#   make run     fly the first minute of Simulation 3 (ARGS="--duration 1080": all)
#   make test    lint, types and tests (PART=network: the tests of one package)
# The first of them creates .venv from requirements.lock. PYTHON=/path/to/python picks another one.

PYTHON ?=
JOBS ?= 2
# tests at once: one more than processors, because some tests wait for other programs
WORKERS ?= $(shell expr $(JOBS) + 1)
ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
COMPILED := $(VENV)/.compiled
CLIENTS := .venv-clients
CLIENTS_STAMP := $(CLIENTS)/.installed
TRAINING := .venv-training
TRAINING_STAMP := $(TRAINING)/.installed
TOOLS := .venv-release
TOOLS_STAMP := $(TOOLS)/.installed
UV := $(BIN)/uv
MAKEFLAGS += --no-print-directory
# Bytecode is kept: tests start some hundred processes, and each would compile the testbed's text.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help environment setup run test checks warm-sensors warm-flights warm-tests lint types tests clients check-all train bench rates results predictions delay numbers arduplane netem fly docs release audit newest lock clean

help:
	@sed -n 's/^# \{0,1\}//p' Makefile | sed -n '1,4p'

setup: $(STAMP)
	@:

run: $(COMPILED)
	@echo "fly: Simulation 3" >&2
	@$(BIN)/testbed run scenarios/simulation-3.yaml $(or $(ARGS),--duration 60)

# Kernels for the tests' flights, and the tests, are compiled once, in parallel with the checks that
# fly nothing.
# PART=network: the tests of this package alone. The first shard has lint and types for all.
test:
	@$(if $(PART),,$(MAKE) -j 3 clients $(if $(filter-out 1/%,$(TESTBED_SHARD)),,checks) warm-sensors warm-flights $(if $(wildcard tests/__pycache__),,warm-tests))
	@$(MAKE) tests

checks: lint types

warm-sensors warm-flights: warm-%: $(STAMP)
	@$(BIN)/python tests/warm.py $*

# Errors are those of the tests themselves.
warm-tests: $(STAMP)
	-@$(BIN)/pytest -q --collect-only >/dev/null

lint: $(STAMP)
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --check --quiet .

types: $(STAMP)
	@$(BIN)/mypy --no-error-summary

# One thread each for numpy's linear algebra: there are as many tests at once as processors.
# TESTBED_SHARD=1/3 runs a third of the tests, by whole files. Files that are unchanged since they
# passed are left out, but not in CI; ALL=1 runs them.
tests: $(STAMP) $(if $(PART),,$(CLIENTS_STAMP))
	@OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -q -n $(WORKERS) --durations 5 $(if $(PART),tests/$(PART)) $(ARGS)

# Ground stations and libraries that tests/clients runs as programs, in an environment of their own.
clients: $(CLIENTS_STAMP)
	@:

# Trains a policy that holds a slot, and compares it with the trim and with the paper's law: docs/rl.md.
train: $(STAMP) $(TRAINING_STAMP)
	@added=$$($(TRAINING)/bin/python -c "import sysconfig; print(sysconfig.get_path('purelib'))"); \
		PYTHONPATH="$$added$${PYTHONPATH:+:$$PYTHONPATH}" \
		$(BIN)/python examples/hold_slot_training.py $(ARGS)

# Every part on its large sample, and the results into docs/contributing/development.md: hours.
# ARGS="--list" prints the parts, ARGS="--only theorem" runs one.
check-all: $(STAMP) $(CLIENTS_STAMP)
	@$(BIN)/python tests/check_all.py --jobs $(JOBS) $(ARGS)

# Cost of a flight relative to bare JSBSim, by size of the fleet (ARGS="--json FILE --into
# docs/speed.md" writes it); of coherent turbulence and of sensor errors; of the network of 100 aircraft;
# of a live view; of four ArduPlanes; of stepping from Python; how late `testbed link` delivers; and the
# time to start.
bench: $(STAMP)
	@$(BIN)/python benchmarks/speed.py $(ARGS)
	@$(BIN)/python benchmarks/scenario_cost.py --set air.turbulence.model=coherent
	@$(BIN)/python benchmarks/scenario_cost.py --set leader.sensors=pixhawk --set 'fleet.*.sensors=pixhawk'
	@$(BIN)/python benchmarks/network_cost.py
	@$(BIN)/python benchmarks/view_cost.py
	@$(BIN)/python benchmarks/arduplane.py
	@$(BIN)/python benchmarks/stepping.py
	@$(BIN)/python benchmarks/link.py
	@$(BIN)/python benchmarks/companion.py --cold
	@$(BIN)/python benchmarks/startup.py

include paper/targets.mk

# Flies every row of the tables in docs/results/simulations.md, experiments.md, air.md, network.md, sensors.md,
# faults.md, own-law.md and large.md, and of those of the folder paper that are not studies, and writes them there.
results: $(STAMP) freedoms leader-acceleration
	@$(BIN)/python benchmarks/results.py --into docs/results/simulations.md $(ARGS)
	@$(BIN)/python benchmarks/experiments.py --into docs/results/experiments.md $(ARGS)
	@$(BIN)/python benchmarks/air.py --into docs/air.md $(ARGS)
	@$(BIN)/python benchmarks/network.py --into docs/network.md $(ARGS)
	@$(BIN)/python benchmarks/sensors.py --into docs/sensors.md $(ARGS)
	@$(BIN)/python benchmarks/faults.py --into docs/faults.md $(ARGS)
	@$(BIN)/python benchmarks/examples.py --into docs/own-law.md docs/large.md $(ARGS)

# Makes again what is older than one of its inputs, and nothing else: tables and pictures of all pages.
# ARGS=--check makes all but times again, and compares them with the pages; without writing.
numbers: $(STAMP)
	@$(BIN)/python benchmarks/stale.py --jobs $(JOBS) $(or $(ARGS),--write)

# Predicts the margins of every profile, and compares predictions with flights: tables of docs/margins.md,
# a quarter of an hour.
predictions: $(STAMP)
	@$(BIN)/python benchmarks/predictions.py --into docs/margins.md $(ARGS)

# Predicts and flies what message delay, loss and large disturbances do: tables of docs/margins.md.
delay: $(STAMP)
	@$(BIN)/python benchmarks/delay.py --jobs $(JOBS) --into docs/margins.md $(ARGS)

# Flies the studies of the rates in docs/speed.md, resuming interrupted ones: 62 flights of some 1000 s and
# 120 of 300 s, a quarter of an hour on two quiet cores.
rates: $(STAMP)
	@$(BIN)/python benchmarks/convergence.py --jobs $(JOBS) --into docs/speed.md $(ARGS)

# Flies Simulation 3 with virtual autopilots and compares it with the recording of four real ArduPlanes:
# the tables of docs/arduplane.md and docs/autopilot.md, and their figure; replays the recording of one
# ArduPlane and writes its tables there and in aircraft/rascal110/SOURCE.md.
arduplane: $(STAMP)
	@$(BIN)/python benchmarks/real_arduplane.py --into docs/arduplane.md docs/autopilot.md $(ARGS)
	@$(BIN)/python benchmarks/recorded_arduplane.py --into docs/autopilot.md aircraft/rascal110/SOURCE.md $(ARGS)

# Compares arithmetic: netem with this kernel's tc netem, as root, without leaving files of root.
netem: SUDO = $(if $(filter 0,$(shell id -u)),,sudo)
netem: $(STAMP)
	@cache=$$(mktemp -d) && trap "$(SUDO) rm -rf $$cache" EXIT && $(SUDO) env \
		PYTHONDONTWRITEBYTECODE=1 NUMBA_CACHE_DIR=$$cache \
		TESTBED_PACKETS=$${TESTBED_PACKETS:-20000} \
		$(BIN)/pytest -q -p no:cacheprovider tests/network/truth/test_netem.py

# Flies from an empty folder as a user does: an own scenario, aircraft and law, and check.
fly: $(STAMP)
	@rm -rf build/flight && $(BIN)/python release/flight.py $(BIN)/formation-testbed build/flight

# The site in build/site: open index.html there; the search works in files, too. Lists tables and pictures
# that are older than one of their inputs, which `make release` refuses.
docs: $(STAMP)
	@$(BIN)/python benchmarks/stale.py >&2 || [ $$? -eq 3 ]
	@$(BIN)/python website/build.py

# Wheel, sdist, pins, bill of materials and checksums in dist/, built from the last commit, checked, and
# flown from a new environment. TAG=v1.2.3 (environment) is compared with version and changelog.
release: $(STAMP) $(TOOLS_STAMP)
	@$(BIN)/python release/make_release.py $(ARGS)
	@$(TOOLS)/bin/python release/valid.py dist/*.cdx.json

# The newest JSBSim and Rerun in place of the pinned ones: tests of flight models and of the viewer.
# ARGS="jsbsim==1.4" tries another release.
newest: $(STAMP)
	@$(BIN)/python release/newest.py $(ARGS)

# Known vulnerabilities of all pinned packages, from PyPI's database; a package that cannot be looked up
# is a failure. And unsafe constructs in the workflows.
audit: $(TOOLS_STAMP)
	@$(TOOLS)/bin/zizmor --offline --quiet .github action.yml
	@for lock in requirements.lock release/requirements.lock release/installer.lock \
		tests/clients/requirements.lock examples/training.lock; do \
		echo "$$lock:"; \
		$(TOOLS)/bin/pip-audit --strict --require-hashes --disable-pip --progress-spinner off \
			-r $$lock || exit 1; \
	done

# Pins the newest releases inside the ranges of pyproject.toml.
PINS = $(UV) pip compile --universal --python-version 3.11 --generate-hashes --no-annotate --no-config \
	--system-certs --upgrade --quiet --custom-compile-command "make lock"
lock: $(UV)
	@$(PINS) pyproject.toml --extra dev --extra docs -o requirements.lock
	@$(PINS) tests/clients/requirements.in --no-deps -o tests/clients/requirements.lock
	@$(PINS) examples/training.in --no-deps -o examples/training.lock
	@$(PINS) release/requirements.in -o release/requirements.lock
	@$(PINS) release/installer.in -o release/installer.lock

clean:
	@rm -rf $(VENV) $(CLIENTS) $(TRAINING) $(TOOLS) build dist .mypy_cache .pytest_cache .ruff_cache

# Made anew where its Python is gone or too old.
environment:
	@set -e; \
	fits='import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 15))'; \
	if ! $(BIN)/python -c "$$fits" 2>/dev/null; then \
		found=; \
		for candidate in $(or $(PYTHON),python3 python3.14 python3.13 python3.12 python3.11 python); do \
			if "$$candidate" -c "$$fits" 2>/dev/null; then found="$$candidate"; break; fi; \
		done; \
		if [ -z "$$found" ]; then \
			echo "No Python 3.11 to 3.14 found: run make PYTHON=/path/to/python" >&2; exit 2; \
		fi; \
		"$$found" -m venv --clear $(VENV) || { \
			echo "$$found cannot make environments: on Debian, apt-get install python3-venv" >&2; \
			exit 2; }; \
	fi

# pip installs it; where there is none for this system, pip installs everything.
$(UV): release/installer.lock | environment
	-@$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: \
		--no-deps --require-hashes -r release/installer.lock
	@touch -c $(UV)

# $(call install,ENVIRONMENT,LOCK FILES): the lock files are complete (--no-deps). Modules are compiled
# when they are first imported, most never. uv does it in seconds. pip, which has settings of its own
# for indexes and certificates, does it where uv cannot. Without a terminal uv only prints errors.
define install
@UV_CACHE_DIR=$(1)/.cache $(UV) pip install $(shell test -t 2 || echo --quiet) --python $(1) \
	--system-certs --no-config --no-deps --require-hashes $(addprefix -r ,$(2)) || { \
	echo "uv cannot install into $(1): pip does, in a minute or more" >&2; \
	$(BIN)/python -m pip --python $(1) install --disable-pip-version-check --no-compile \
		--no-deps --require-hashes $(addprefix -r ,$(2)); }
@rm -rf $(1)/.cache
endef

$(STAMP): requirements.lock pyproject.toml | $(UV)
	@echo "install: the pinned packages into $(VENV); once, 1.6 GB" >&2
	$(call install,$(VENV),requirements.lock)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--no-deps --no-build-isolation --editable .
	@touch $(STAMP)

# What flights need is compiled before the first one, which then takes a second.
$(COMPILED): $(STAMP)
	@echo "compile: flight models, autopilots and the law; once, half a minute" >&2
	@$(BIN)/python tests/warm.py first
	@touch $(COMPILED)

$(CLIENTS_STAMP): tests/clients/requirements.lock | $(UV)
	@echo "Installing the MAVLink clients of the tests into $(CLIENTS); once"
	@$(BIN)/python -m venv --clear --without-pip $(CLIENTS)
	$(call install,$(CLIENTS),$<)
	@touch $(CLIENTS_STAMP)

# Beside .venv, which has the rest; PyPI's PyTorch for Linux would bring gigabytes of CUDA.
$(TRAINING_STAMP): examples/training.lock examples/torch.lock | $(STAMP)
	@echo "Installing Stable-Baselines3 and PyTorch into $(TRAINING); once, a minute"
	@$(BIN)/python -m venv --clear --without-pip $(TRAINING)
	$(call install,$(TRAINING),$^)
	@touch $(TRAINING_STAMP)

$(TOOLS_STAMP): release/requirements.lock | $(STAMP)
	@echo "Installing the tools of releases into $(TOOLS); once"
	@$(BIN)/python -m venv --clear --without-pip $(TOOLS)
	$(call install,$(TOOLS),$<)
	@touch $(TOOLS_STAMP)
