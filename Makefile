# make demo   a whole simulated measurement, from frames to friction parameters
# make test   install what tests need and run them all
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check
# Of what is installed most is never imported: the rest is compiled at its first import.
INSTALL = $(PIP) install --quiet --no-compile

# Where the environment forbids bytecode, every process of the tests would compile all modules again.
export PYTHONDONTWRITEBYTECODE =

.DELETE_ON_ERROR:
.PHONY: demo test test-quick test-kernel bench validation ledger lint format schema pictures drawings docs hooks pins wheel clean

# Into the folder that README and docs go on with; called again, into one named by date and time.
demo: $(VENV)/.installed
	$(BIN)/rig run configs/demo.toml $(if $(wildcard runs/first/*),,-o runs/first) $(ARGS)

# tests/conftest.py says how many workers `auto` is, and which files come first.
test: $(VENV)/.kernels
	$(BIN)/python -m pytest -n auto --no-loadscope-reorder -m "not bench and not kernel" $(ARGS)

test-quick: $(VENV)/.kernels
	$(BIN)/python -m pytest -n auto --no-loadscope-reorder -m "not slow and not realtime and not bench and not kernel" $(ARGS)

test-kernel: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n 2 -m kernel tests/kernel -rs $(ARGS)

lint: $(VENV)/.installed-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.installed-test
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# The JSON schema of results.json follows from the values in rig/analysis/results.py.
schema: $(VENV)/.installed
	$(BIN)/python -c 'from rig.analysis import results_schema; print(results_schema(), end="")' > docs/results.schema.json

# The pictures of README and docs, from a run of the demonstration.
pictures: $(VENV)/.installed-test
	$(BIN)/python docs/pictures/make_pictures.py $(ARGS)
	$(BIN)/python docs/pictures/desk.py

# The drawings of docs, and its gallery of troubles, from the simulated rig.
drawings: $(VENV)/.installed
	$(BIN)/python docs/pictures/drawings.py
	$(BIN)/python docs/pictures/troubles.py

# The documents as a site in build/site, without a network; a link that leads nowhere is an error.
docs: $(VENV)/.installed-test
	$(BIN)/python -m sphinx -E -W --keep-going -q -c docs/site -b html . build/site

bench: $(VENV)/.installed-test
	-$(PIP) install --quiet --editable ".[bench]"
	$(BIN)/python -m tests.benchmarks $(ARGS)

# Every claim with its number: docs/validation.md and what it follows from. ARGS="--quick", ARGS="gum iso11146".
validation: $(VENV)/.installed-test
	-$(PIP) install --quiet --editable ".[bench]"
	$(BIN)/python -m tests.validation $(ARGS)

# Of what is committed, in dist; the Containerfile takes it from there.
wheel: $(VENV)/.installed
	rm -f dist/*.whl
	$(BIN)/python -m hatchling build -d dist -t wheel

# What a user sees of fixed sessions, against what is kept in tests/ledger; ARGS="--write" keeps it anew.
ledger: $(VENV)/.installed-test
	$(BIN)/python -m tests.ledger $(ARGS)

# Of what they run nothing is downloaded; pre-commit itself is in no pins, for nothing else needs it.
hooks: $(VENV)/.installed-test
	$(PIP) install --quiet "pre-commit>=4"
	$(BIN)/pre-commit install

# A virtual environment is rebuilt only when what goes into it has changed.
$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("python >= 3.11 is needed, this is " + sys.version.split()[0] + "; try: make PYTHON=python3.12") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv $(VENV)

# Everything is pinned with hashes, which pip checks; then the package itself, with nothing left to resolve.
$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "installing $$(grep -c == constraints.txt) packages into $(VENV), 2 to 3 minutes; the largest are rerun-sdk, llvmlite, pyarrow, opencv"
	$(PIP) install --no-compile --requirement constraints.txt
	$(INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed constraints-test.txt
	$(INSTALL) --requirement constraints-test.txt
	@touch $@

# Compiled before the tests, and again when a module has changed that holds one.
$(VENV)/.kernels: $(VENV)/.installed-test tests/compile_kernels.py $(shell grep -rl --include='*.py' '^@kernel' acquisition calibration processing)
	$(BIN)/python -m tests.compile_kernels
	@touch $@

# Pins are renewed by hand, with pip-tools in the environment, when a range in pyproject.toml changes.
COMPILE = $(BIN)/pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras --no-header --no-emit-index-url \
  --no-emit-find-links --no-emit-trusted-host --no-emit-options --annotation-style=line

pins: $(VENV)/.installed
	$(PIP) install --quiet pip-tools
	$(COMPILE) --extra test --extra docs --output-file constraints-test.txt pyproject.toml constraints.in
	$(COMPILE) --output-file constraints.txt pyproject.toml constraints.in

clean:
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
