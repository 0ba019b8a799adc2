# make up      set up this machine, then train and show the cuboid world
# make test    set up this machine, then all checks and tests but the slow ones
# make help    the rest
PYTHON ?= python3
SCENARIO ?= scenarios/cuboid.toml
BIN := .venv/bin
export OMP_NUM_THREADS ?= 1

.PHONY: help setup up test check test-slow test-compose format bench clean

help:
	@echo "make setup      prepare .venv from uv.lock (about 5 GB, nearly all torch's CUDA wheels)"
	@echo "make up         train and show a world here; SCENARIO=scenarios/dumbbell.toml for another"
	@echo "make test       checks and all tests but the slow ones"
	@echo "make check      format, lint, types, import contracts"
	@echo "make test-slow  full experiments and soak runs (tens of minutes)"
	@echo "make test-compose  those of them with containers; they need a Docker engine (about 10 minutes)"
	@echo "make bench      speed and memory as ratios (minutes)"

setup: $(BIN)/.ready

# uv is bootstrapped into .venv; the stamp is renewed when the lock or the project changes.
$(BIN)/.ready: pyproject.toml uv.lock deploy/bootstrap.py
	$(PYTHON) deploy/bootstrap.py
	$(BIN)/uv sync --quiet --locked --all-extras
	@touch $@

up: setup
	$(BIN)/babble up $(SCENARIO)

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

# Tests with real processes measure times, so they run one by one; the others share two cores.
test: check
	$(BIN)/python -m pytest -m "not slow" -n 2 tests/unit tests/protocol tests/simulated
	$(BIN)/python -m pytest -m "not slow" tests/processes

test-slow: setup
	$(BIN)/python -m pytest -m slow --timeout 3600

test-compose: setup
	$(BIN)/python -m pytest -m compose --timeout 3600

bench: setup
	$(BIN)/python -m bench

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf .venv .mypy_cache .ruff_cache .hypothesis
