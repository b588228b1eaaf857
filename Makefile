# make demo: the main job on the simulated Pepper. make view: the simulated Pepper in the browser. make check: style and types. make test: check, then tests.
# make test-all: also what takes minutes (plants for a minute, examples, docs, packages), and ten times the examples of property tests.
# make flakes: the tests again and again, alone and next to busy processes; interrupted, it continues where it was.
# make naoqi: install what a robot over NAOqi needs, and its stand-in. make lint: style. make types: mypy.
# make format: rewrite as make lint requires it. make build: sdist and wheel. make bench-controller: compared with pink and mink.
# make clean: remove all that was made. All need Python 3.11 to 3.13 and nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= 3

.PHONY: demo view naoqi check test test-all flakes lint types format build bench-controller clean

# One stamp for each extra: installed again when pyproject.toml changes.
$(VENV)/.extra-%: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[$*]"
	@touch $@

demo: $(VENV)/.extra-plot
	$(BIN)/pepper demo --out runs/demo

view: $(VENV)/.extra-viewer
	$(BIN)/pepper view

naoqi: $(VENV)/.extra-naoqi

check: lint types

# Kernels are compiled before the workers start, who would all compile them. Tests in real time run alone: others would
# keep the processors busy. Once, with checked bounds, robots do all they can.
CHECKED := NUMBA_BOUNDSCHECK=1 $(BIN)/python -m pytest

test: check
	$(BIN)/python -c "from pepper_driver import Pepper; Pepper('mujoco')"
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not whole and not realtime"
	$(BIN)/python -m pytest -m "realtime and not whole"
	$(CHECKED) tests/pepper_driver/test_compiled_before_ticks.py

test-all: check
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not realtime" --hypothesis-profile nightly
	$(BIN)/python -m pytest -m realtime
	$(CHECKED) -n $(WORKERS) --dist worksteal -m "not whole and not realtime"
	$(BIN)/pepper bench --soak 300

flakes: $(VENV)/.extra-dev
	$(BIN)/python benchmarks/flakes.py --workers $(WORKERS)

lint: $(VENV)/.extra-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.extra-dev
	$(BIN)/mypy

format: $(VENV)/.extra-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

build: $(VENV)/.extra-dev
	$(BIN)/python -m build

bench-controller: $(VENV)/.extra-peers
	$(BIN)/pepper bench --peers --seconds 72

clean:
	rm -rf $(VENV) build dist runs *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
