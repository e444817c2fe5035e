PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.PHONY: setup compare paper test lint types unit readme lock clean

setup: $(READY)

$(READY): requirements.lock pyproject.toml
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
	MUJOCO_GL=$${MUJOCO_GL:-egl} $(BIN)/prioritized-ik paper --out results/paper

test: lint types unit

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

unit: setup
	MUJOCO_GL=$${MUJOCO_GL:-egl} $(BIN)/python -m pytest

# What the README shows: its tables and its picture.
readme: setup
	MUJOCO_GL=$${MUJOCO_GL:-egl} $(BIN)/prioritized-ik paper --out results/paper --readme README.md
	MUJOCO_GL=$${MUJOCO_GL:-egl} $(BIN)/prioritized-ik wind --tilt 0.3 --record docs/wound.png

lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	    --extra solvers --extra report --extra cluster --extra dev pyproject.toml --output-file requirements.lock

clean:
	rm -rf .venv results
