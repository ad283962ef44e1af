# `make demo` and `make test` need Python 3.11 or later and nothing else.
PYTHON ?= python3
VENV := .venv
# Recordings that lie beside the checkout are used in place of a download.
DATA ?= $(wildcard ../shared/data)

.PHONY: demo test lint dist clean

demo: $(VENV)/installed
	$(VENV)/bin/tactile demo --seeds 2 $(if $(DATA),--root "$(DATA)")

test: $(VENV)/installed
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(VENV)/bin/python -m pytest -n auto --maxprocesses 8 --dist loadgroup

lint: $(VENV)/installed
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

dist: $(VENV)/installed
	rm -rf dist
	$(VENV)/bin/python -m build
	$(VENV)/bin/twine check --strict dist/*
	$(VENV)/bin/python .ci/check_dist.py dist

$(VENV)/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed: make PYTHON=python3.11 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt torch --editable ".[dev]"
	@touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info
