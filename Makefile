# Every target does its own set-up. PYTHON=... picks the interpreter, TORCH_INDEX=... where pip looks for torch.
BIN := .venv/bin
export PYTHON TORCH_INDEX
# One worker a file: what its tests share is made once.
PYTEST := $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder --durations=15

.PHONY: setup setup-dev demo tiny test test-all bench times docs faults check format dist clean

setup:  ## .venv with this project and what running needs; system packages where something is missing
	@.ci/setup

setup-dev:  ## the same, and what tests, checks and the extras need
	@.ci/setup dev

demo: setup  ## the whole chain on a living room: drive, see, learn, position, show
	$(BIN)/deepgps run demo

tiny: setup  ## the same, small
	$(BIN)/deepgps run tiny

test: setup-dev  ## every law, quickly
	$(PYTEST) -m "not slow"

test-all: setup-dev  ## all tests: whole runs and studies, killed ones too, examples, every command of the documentation
	$(PYTEST)

bench: setup  ## how fast this machine runs the demo, draws, trains and positions; ARGS=--scale: 8,000 to 64,000 images
	PYTHONPATH=. $(BIN)/python tests/bench.py $(ARGS)

times: setup-dev  ## how long set-up, demo and tests take on this machine: the README's table
	PYTHONPATH=. $(BIN)/python docs/times.py

docs: setup-dev  ## the reference from the code, and the documentation, in build/docs; warnings are errors
	$(BIN)/python -m docs.generate
	$(BIN)/sphinx-build -W --keep-going -q docs build/docs
	@echo "look at it: build/docs/index.html"

faults: setup-dev  ## attack all of it from outside and write build/faults.md, other cases each time
	@mkdir -p build
	$(BIN)/python -m tests.faults --out build/faults.md

check: setup-dev  ## style, types and who may import whom
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/pytest tests/test_imports.py

format: setup-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

dist: setup  ## a wheel and a source archive in dist/
	$(BIN)/hatchling build

clean:  ## what setup and the checks made; runs/ stays
	rm -rf .venv build dist .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
