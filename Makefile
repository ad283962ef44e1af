# `make demo` and `make test` need Python 3.11 or later and nothing else.
PYTHON ?= python3
VENV := .venv
# Recordings that lie beside the checkout are used in place of a download.
DATA ?= $(wildcard ../shared/data)
# Without bytecode, every process that a test starts compiles the package again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-random test-full check tutorials notebooks lint docs linkcheck dist clean
TESTS = OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(VENV)/bin/python -m pytest -n auto --maxprocesses 8 --dist loadgroup
TUTORIALS = OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(VENV)/bin/python tutorials/run.py --jobs 2 --limit 150 --total 1200 \
  $(if $(DATA),--data "$(DATA)")
SPHINX = OMP_NUM_THREADS=1 $(VENV)/bin/python -m sphinx -W --keep-going -j auto -d docs/build/doctrees

demo: $(VENV)/demo
	$(VENV)/bin/tactile demo $(if $(DATA),--root "$(DATA)")

test: $(VENV)/installed
	$(TESTS) -m "not full"

# The same tests, the files and the tests of each file in a random order. The order of a run comes again
# with the seed that it printed: make test-random SEED=4711
SEED := $(or $(SEED),$(shell date +%s))
test-random: $(VENV)/installed
	@echo "order of the tests: make test-random SEED=$(SEED)"
	$(TESTS) -m "not full" --random-order --random-order-seed=$(SEED)

# What takes long: kills, full disks, clusters, mutated checkpoints, whole pages.
test-full: $(VENV)/installed
	$(TESTS) -m full

# All that must hold before a change lands, on one machine: about 30 minutes.
check: export TACTILE_CHECKPOINT_CASES = 10000
check: test-random test-full lint docs tutorials dist
	OMP_NUM_THREADS=1 $(VENV)/bin/python tests/fuzz/run.py --cases 20000

# The limits are guards that a busy machine passes too; the times are printed. Without the options:
# 60 s of processor time each, 7 minutes together.
tutorials: $(VENV)/installed
	$(TUTORIALS)

# Runs them, and writes the committed notebooks with the new outputs, which the site shows.
notebooks: $(VENV)/installed
	$(TUTORIALS) --write

lint: $(VENV)/installed
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(VENV)/bin/codespell

# docs/build/html is the site, complete in this folder, with the committed tutorials; without them:
# TACTILE_DOCS_TUTORIALS=0. Links into the documentation of other projects come
# from docs/inventories; from their sites: TACTILE_DOCS_ONLINE=1.
docs: $(VENV)/installed
	$(SPHINX) -q -b html docs docs/build/html
	$(VENV)/bin/python docs/check_site.py docs/build/html

linkcheck: $(VENV)/installed
	$(SPHINX) -b linkcheck docs docs/build/linkcheck

dist: $(VENV)/installed
	$(VENV)/bin/python .ci/check_version.py
	rm -rf dist build packaging/live/build
	$(VENV)/bin/python -m build
	$(VENV)/bin/python -m build --wheel --outdir dist packaging/live
	$(VENV)/bin/twine check --strict dist/*
	$(VENV)/bin/python .ci/check_dist.py dist
	$(VENV)/bin/python .ci/check_live.py dist

# The first command installs what it needs only: 1.6 GB, where the rest makes 2.8 GB of it.
$(VENV)/demo: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed: make PYTHON=python3.11 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt torch --editable ".[demo]"
	@touch $@

$(VENV)/installed: $(VENV)/demo
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt torch --editable ".[dev]"
	@touch $@

clean:
	rm -rf $(VENV) build dist docs/build docs/generated docs/tutorials *.egg-info
