PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.PHONY: setup system compare paper test lint types unit unit-fast package docs gallery readme lock clean

setup: system $(READY)

# Installs system packages where that needs no password; says in one line what else is missing, and goes on.
system:
	@PYTHON=$(PYTHON) tools/system-packages

# The core of the solve is compiled in place when the package is installed.
CORE := hatch_build.py $(wildcard src/prioritized_ik/solvers/compiled/*pp)

$(READY): requirements.lock pyproject.toml $(CORE)
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(READY)

# The main job: every solver on the same windings, measured anew; the table, and the report, Parquet, Markdown and JSON in
# results/. One that was interrupted goes on with: .venv/bin/prioritized-ik compare --out results/compare
compare: setup
	mkdir -p results
	$(BIN)/prioritized-ik compare --fresh --out results/compare --json results/compare.json

# Every table and figure of the paper, and the report, in results/paper/.
paper: setup
	$(BIN)/prioritized-ik paper --out results/paper

# The checks go side by side, the tests after them.
test: setup
	@$(MAKE) --no-print-directory --jobs 2 lint types package
	@$(MAKE) --no-print-directory unit

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

# Three processes, as on two cores one of them often waits; a file at a time in the order of tests/support/slow.py.
PYTEST := $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

unit: setup
	$(PYTEST)

# The fast tests, within a minute.
unit-fast: setup
	$(PYTEST) -m "not slow"

# The wheel and the source archive: what they hold and say, and that they install and start on their own.
package: setup
	$(BIN)/python tools/check_package.py

# The documentation, in results/docs/; a warning is an error.
docs: setup
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs results/docs
	@echo "results/docs/index.html"

# The pictures of the gallery, each by its example.
gallery: setup
	cd docs/gallery && for script in ../../examples/*.py; do ../../$(BIN)/python $$script || exit 1; done

# What the README and the pages beside it show: their tables and the picture.
readme: setup
	$(BIN)/prioritized-ik paper --out results/paper --readme README.md --readme docs/winding.md
	$(BIN)/prioritized-ik wind --tilt 0.3 --record docs/wound.png

lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	    --extra all --extra docs --extra dev pyproject.toml --output-file requirements.lock

clean:
	rm -rf .venv results
