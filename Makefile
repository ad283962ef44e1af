# `make demo` and `make test` need Python 3.11 or later and nothing else.
PYTHON ?= python3
VENV := .venv
# Recordings that lie beside the checkout are used in place of a download.
DATA ?= $(wildcard ../shared/data)

.PHONY: demo test tutorials lint clean

demo: $(VENV)/installed
	$(VENV)/bin/tactile demo --seeds 2 $(if $(DATA),--root "$(DATA)")

test: $(VENV)/installed
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(VENV)/bin/python -m pytest -n auto --maxprocesses 8 --dist loadgroup

tutorials: $(VENV)/installed
	OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(VENV)/bin/python tutorials/run.py --jobs 2 \
	  $(if $(DATA),--data "$(DATA)")

lint: $(VENV)/installed
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

$(VENV)/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed: make PYTHON=python3.11 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt torch --editable ".[dev]"
	@touch $@

clean:
	rm -rf $(VENV) build *.egg-info
