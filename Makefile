# make demo    create the environment, verify the shipped example, write the plot
# make test    create the environment, run the tests
# make check   what CI runs: format, lint, types, import contracts, tests

VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.setrl-stamp

.DEFAULT_GOAL := help
.PHONY: help env verifiers demo test test-slow check format format-check lint types contracts docstrings clean

help:
	@echo 'make env          create $(VENV) and install setrl into it (quick when it is up to date)'
	@echo 'make demo         verify the shipped example and write demo/flowpipe.png'
	@echo 'make test         run the tests'
	@echo 'make test-slow    run the tests that take longer'
	@echo 'make check        what CI runs: format, lint, types, import contracts, docstrings, tests'
	@echo 'make format       format the code'
	@echo 'make verifiers    install the external verifiers of setrl crosscheck into $(VERIFIERS) (gigabytes)'
	@echo 'make clean        remove the environment and everything that was built'
	@echo
	@echo 'PYTHON=python3.12 chooses the interpreter, VENV=folder the environment.'

env: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@python=; for candidate in $(or $(PYTHON),python3 python3.13 python3.12 python3.11); do \
	    if "$$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null; then \
	        python=$$candidate; break; \
	    fi; \
	done; \
	if [ -z "$$python" ]; then \
	    found=$$("$(or $(PYTHON),python3)" --version 2>/dev/null || echo 'not there'); \
	    echo "setrl needs Python 3.11 to 3.13, but $(or $(PYTHON),python3) is $$found." \
	        "Install one of them, or name it: make PYTHON=/path/to/python3.12 env" >&2; \
	    exit 1; \
	fi; \
	echo "Installing setrl into $(VENV) with $$("$$python" --version)"; \
	"$$python" -m venv $(VENV) && \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

demo: env
	@mkdir -p demo
	$(BIN)/setrl verify --plot demo/flowpipe.png

# one process per processor, each with one BLAS thread: more would wait for each other
PYTEST := OMP_NUM_THREADS=1 $(BIN)/pytest -n auto --dist worksteal

test: env
	$(PYTEST)

test-slow: env
	$(PYTEST) -m slow

check: format-check lint types contracts docstrings test

format: env
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

format-check: env
	$(BIN)/ruff format --check .

lint: env
	$(BIN)/ruff check .

types: env
	$(BIN)/mypy

contracts: env
	PYTHONPATH=.src $(BIN)/lint-imports --no-logo

docstrings: env
	$(BIN)/pytest -q tests/test_docstrings.py

# Verifiers that others wrote, for `setrl crosscheck`: their versions of onnx and torch (gigabytes) stay out of $(VENV).
VERIFIERS ?= .verifiers

verifiers: env
	$(BIN)/python -m venv $(VERIFIERS)
	$(VERIFIERS)/bin/python -m pip install --quiet --disable-pip-version-check -r verify/crosscheck/requirements.txt

clean:
	rm -rf $(VENV) build dist demo .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
