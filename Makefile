# make bench   install and measure the ring scene: tables and pictures in results/report
# make test    install and run all tests
# Both make .venv first; nothing needs root, a compiler, or an OpenCL driver of the system.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: install bench test lint types docs speed growth trade fuzz clean

install: $(VENV)/installed

$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "clrelight needs Python 3.11 or newer, $(PYTHON) is `$(PYTHON) -V`: try make PYTHON=python3.12" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -e '.[dev]'
	# pip would do this on one processor, for 20 s, of tests as well; what is no Python of this version stays as it is.
	@$(BIN)/python -m compileall -qq -j 0 -x '/(tests?|pip|setuptools|mypy)/' $(VENV)/lib || true
	@touch $@

bench: install
	@mkdir -p results
	$(BIN)/clrelight bench ring --out results/ring.h5
	$(BIN)/clrelight report results/ring.h5 --out results/report

test: install
	# The numerics are small: BLAS threads would only wait for each other. Each process would compile the
	# package anew: bytecode is kept.
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal tests

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/mypy

# The site, with the examples run: build/docs/html/index.html. Any warning fails.
docs: install
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs/html

speed: install
	$(BIN)/python -m benchmarks.stages --markdown docs/performance.md

growth: install
	@mkdir -p results
	$(BIN)/clrelight bench --speed --out results/speed.json --report results/speed
	$(BIN)/python -m benchmarks.growth results/speed.json

trade: install
	rm -rf results/trade
	$(BIN)/python -m benchmarks.trade_page

fuzz: install
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[fuzz]'
	# A minute for each of some forty targets, with up to a million executions.
	$(BIN)/python -m tests.python_fuzz --seconds 60

clean:
	rm -rf $(VENV) results build dist docs/gallery
