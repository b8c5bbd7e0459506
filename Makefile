# conetl: `make demo` shows the main job, `make test` runs the tests. Both set up what they need.
.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON ?= python3
BIN := .venv/bin
export PYTHON
export PREFECT_SERVER_ANALYTICS_ENABLED := false
export DO_NOT_TRACK := 1
export NO_MKDOCS_2_WARNING := 1

.PHONY: $(shell sed -nE 's/^([a-z-]+):.*/\1/p' $(firstword $(MAKEFILE_LIST)))

help:           ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup:          ## virtual environment with locked dependencies, PostGIS from the system's packages
	@scripts/setup.sh

demo: setup     ## the main job: three sample drives become a versioned cone map
	@$(BIN)/conetl demo

up: setup       ## PostGIS, Prefect, workers, schedules and the web view; make down ends them
	@$(BIN)/conetl up

down:           ## stop what `make up` started; data are kept
	@$(BIN)/conetl down

# A file's tests stay on one worker: they share servers, and some build on the one before. tests/conftest.py orders the files.
test: setup     ## all tests
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --durations=15

lint: setup     ## lint, types, import contracts, wording and documentation
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python scripts/check_wording.py
	$(BIN)/mkdocs build --strict

check: lint     ## the same, and the fast tests
	$(BIN)/python -m pytest -q -n 2 --dist loadfile tests/unit

docs: setup     ## the documentation as a site, in build/site
	@$(BIN)/mkdocs build --strict

web:            ## build the front end of `conetl view` into src/conetl/web/static (needs Node 20.19 or newer)
	@cd web && npm ci --no-audit --no-fund && npm run build

bench-detect: setup  ## speed of the detector beside YOLOv3 and a network of YOLO11n's size (ARGS='--pictures FOLDER' ...)
	@$(BIN)/python benchmarks/bench_detect.py $(ARGS)

bench-intersection: setup  ## speed of forward intersection beside OpenCV
	@$(BIN)/python benchmarks/bench_intersection.py

bench-trajectory: setup  ## refinement of a drive's poses: time, and how far cones slide with and without (DRIVE=folder)
	@$(BIN)/python benchmarks/bench_trajectory.py $(DRIVE)

bench-calibration: setup  ## random halves of a folder of board images against each other (ARGS='FOLDER --board chessboard:9x6:37.8mm')
	@$(BIN)/python benchmarks/bench_calibration.py $(ARGS)

bench-export: setup  ## export of a million cones to GeoParquet: time and memory (ARGS='--what history --versions 5' ...)
	@$(BIN)/python benchmarks/bench_export.py $(ARGS)

bench-ogc: setup  ## OGC API Features over a million cones, 20 users (ARGS='--side-m 1000 --seconds 60' ...)
	@$(BIN)/python benchmarks/bench_ogc.py $(ARGS)

bench-changes: setup  ## what the map makes of 200 simulated days of changes: confusion matrix (1 minute of processor time)
	@$(BIN)/python benchmarks/bench_changes.py $(ARGS)

bench-map: setup  ## a drive of 100,000 cones into maps of 100 thousand and 1 million features (SIZES="... 10000000" for more)
	@$(BIN)/python benchmarks/bench_map.py --sizes $(or $(SIZES),100000 1000000)

bench-view: setup  ## first frame of the web view, clicks and frames (POINTS=3000000 for a large cloud; needs Chromium)
	@$(BIN)/python benchmarks/bench_view.py --points $(or $(POINTS),100000)

bench-fleet: setup  ## one and eight writers on one map, and a month of 200 vehicles at 1:100 (ARGS='--only writers' ...)
	@$(BIN)/python benchmarks/bench_fleet.py $(ARGS)

bench-kills: setup  ## 200 ingests killed at random instants: equal tables, no lock, no file left (KILLS=20 for fewer)
	@$(BIN)/python benchmarks/bench_kills.py --kills $(or $(KILLS),200)

bench-overhead: setup  ## what Prefect costs on a drive of 1,000 pairs, beside the same steps in a plain loop (ARGS='--pairs 200', ARGS='--dask 4' ...)
	@$(BIN)/python benchmarks/bench_overhead.py $(ARGS)

bench-ingest: setup  ## the whole job beside decoding and the network alone: pairs per second, memory (ARGS='--pairs 150 --stages' ...)
	@$(BIN)/python benchmarks/bench_ingest.py $(ARGS)

bench-watch: setup  ## a recorded KITTI drive written again at 10 Hz: latency of conetl watch (ARGS='DRIVE --rate 5')
	@$(BIN)/python benchmarks/bench_watch.py $(ARGS)

bench-health: setup  ## health checks on simulated good drives: false alarms, NEES of places and clocks, cost (ARGS='--drives 50 --no-cost')
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_health.py $(ARGS)

bench-mutants: setup  ## wrong recordings: what each does to a map, and whether its cause is named (ARGS='--only TEXT --failures' ...)
	@$(BIN)/python benchmarks/bench_mutants.py $(ARGS)

bench-recordings: setup  ## the sample drives and KITTI as videos and bags with nine logs: the same cones as the images (ARGS='--only TEXT' ...)
	@$(BIN)/python benchmarks/bench_recordings.py $(ARGS)

fuzz: setup     ## all readers on mutated files: no crash, 2 s and 1 GB at most (ARGS='--cases 10000 --reader kitti')
	@$(BIN)/python -m tests.fuzz.fuzz_readers $(ARGS)

lock:           ## renew the locked dependencies from pyproject.toml (needs uv)
	uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --no-annotate -o requirements.txt
	uv pip compile pyproject.toml --extra s3 --extra dask -c requirements.txt --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --no-annotate -o requirements-runtime.txt
