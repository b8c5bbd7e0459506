# conetl: `make demo` runs the sample drives, `make test` the tests. Both install what they need.
.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON ?= python3
# For two cores: tests that wait for servers and pages leave a core idle.
TEST_WORKERS ?= 3
BIN := .venv/bin
export PYTHON
export PREFECT_SERVER_ANALYTICS_ENABLED := false
export DO_NOT_TRACK := 1
export NO_MKDOCS_2_WARNING := 1
# As many containers set it: every process, such as those of tests, would compile conetl again, which takes it a second.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: $(shell sed -nE 's/^([a-z-]+):.*/\1/p' $(firstword $(MAKEFILE_LIST)))

help:           ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup:          ## install the locked dependencies into .venv, and PostGIS from the system's packages
	@scripts/setup.sh
	@[ "$(MAKECMDGOALS)" != setup ] || echo 'Ready. Next: `export PATH=$$PWD/.venv/bin:$$PATH`, then `conetl init path/to/folder` for your recording, or `make demo` for the sample drives.'

demo: setup     ## ingest three sample drives and compare the map with the ground truth
	@$(BIN)/conetl demo

up: setup       ## start PostGIS, Prefect, workers, schedules and the map viewer
	@$(BIN)/conetl up

down:           ## stop what `make up` started; data are kept
	@$(BIN)/conetl down

# A file's tests stay on one worker: they share servers, and some build on the one before. tests/conftest.py orders the files.
PYTEST := $(BIN)/python -m pytest -n $(TEST_WORKERS) --dist loadfile --no-loadscope-reorder
test: setup     ## run the tests of every change
	@$(PYTEST) -m 'not release' --durations=15

test-all: setup ## run all tests, as before a release
	@$(PYTEST) --durations=30

lint: setup     ## check style, types, import contracts, wording and documentation
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python scripts/check_wording.py
	$(BIN)/mkdocs build --strict

check: lint     ## run the lint checks and the fast tests
	$(BIN)/python -m pytest -q -n 2 --dist loadfile tests/unit

docs: setup     ## build the documentation in build/site
	@$(BIN)/mkdocs build --strict

web: setup      ## build the front end of `conetl view` into src/conetl/web/static (needs Node 20.19 or newer)
	@$(BIN)/python -c 'import json; from conetl.web.app import create_app; print(json.dumps(create_app("", "").openapi()))' > web/openapi.json
	@cd web && npm ci --no-audit --no-fund && npm run build

bench-detect: setup  ## measure the detector beside YOLOv3 and a network of YOLO11n's size (ARGS='--images FOLDER' ...)
	@$(BIN)/python benchmarks/bench_detect.py $(ARGS)

bench-intersection: setup  ## measure forward intersection beside OpenCV
	@$(BIN)/python benchmarks/bench_intersection.py

bench-trajectory: setup  ## measure pose refinement: time, and drift of cones with and without it (DRIVE=folder)
	@$(BIN)/python benchmarks/bench_trajectory.py $(DRIVE)

bench-calibration: setup  ## calibrate with random halves of a folder of board images and compare (ARGS='FOLDER --board chessboard:9x6:37.8mm')
	@$(BIN)/python benchmarks/bench_calibration.py $(ARGS)

bench-export: setup  ## export a million cones to GeoParquet: time and memory (ARGS='--what history --versions 5' ...)
	@$(BIN)/python benchmarks/bench_export.py $(ARGS)

bench-ogc: setup  ## query OGC API Features on a map of a million cones, 20 users (ARGS='--side-m 1000 --seconds 60' ...)
	@$(BIN)/python benchmarks/bench_ogc.py $(ARGS)

bench-changes: setup  ## simulate 200 days of changes: confusion matrix of the map (1 minute of processor time)
	@$(BIN)/python benchmarks/bench_changes.py $(ARGS)

bench-map: setup  ## merge a drive of 100,000 cones into maps of 100,000 and 1 million features (SIZES="... 10000000" for more)
	@$(BIN)/python benchmarks/bench_map.py --sizes $(or $(SIZES),100000 1000000)

bench-view: setup  ## measure the map viewer: first frame, clicks, frame rate (POINTS=3000000 for a large cloud; needs Chromium)
	@$(BIN)/python benchmarks/bench_view.py --points $(or $(POINTS),100000)

bench-fleet: setup  ## run one and eight writers on one map, and a month of 200 vehicles at 1:100 (ARGS='--only writers' ...)
	@$(BIN)/python benchmarks/bench_fleet.py $(ARGS)

bench-kills: setup  ## kill 200 ingests at random times and check tables, locks and files (KILLS=20 for fewer)
	@$(BIN)/python benchmarks/bench_kills.py --kills $(or $(KILLS),200)

bench-overhead: setup  ## measure the overhead of Prefect on a drive of 1,000 pairs (ARGS='--pairs 200', ARGS='--dask 4' ...)
	@$(BIN)/python benchmarks/bench_overhead.py $(ARGS)

bench-ingest: setup  ## measure an ingest, and decoding and detection alone: pairs per second, memory (ARGS='--pairs 150 --stages' ...)
	@$(BIN)/python benchmarks/bench_ingest.py $(ARGS)

bench-alike: setup  ## analyse drives whose pairs show the same: stops, 30 Hz; time and cones beside those without (ARGS='--only stop')
	@$(BIN)/python benchmarks/bench_alike.py $(ARGS)

bench-watch: setup  ## replay a KITTI drive at 10 Hz: latency of conetl watch (ARGS='DRIVE --rate 5')
	@$(BIN)/python benchmarks/bench_watch.py $(ARGS)

bench-health: setup  ## run the health checks on simulated good drives: false alarms, NEES, cost (ARGS='--drives 50 --no-cost')
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/bench_health.py $(ARGS)

bench-mutants: setup  ## ingest faulty recordings: effect on the map, and whether the cause is named (ARGS='--only TEXT --failures' ...)
	@$(BIN)/python benchmarks/bench_mutants.py $(ARGS)

bench-honest: setup  ## check logs with errors of many shapes, as large as stated: held ones, NEES (ARGS='--drives 40 --only white' ...)
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 nice -n 5 $(BIN)/python benchmarks/bench_honest.py $(ARGS)

bench-plans: setup  ## compare permits with the zones of a simulated city: precision and recall (ARGS='--zones 40 --seeds 1' ...)
	@$(BIN)/python benchmarks/bench_plans.py $(ARGS)

bench-recordings: setup  ## ingest the sample drives and KITTI as videos and bags with nine logs, and compare the cones (ARGS='DRIVE --parts clocks' ...)
	@$(BIN)/python benchmarks/bench_recordings.py $(ARGS)

bench-text-limits: setup  ## read large text files of every kind: time and memory (ARGS='--only log --scale 0.1' ...)
	@$(BIN)/python -m benchmarks.bench_text_limits $(ARGS)

fuzz: setup     ## run all readers on mutated files: no crash, at most 2 s and 1 GB (ARGS='--cases 10000 --reader kitti')
	@$(BIN)/python -m tests.fuzz.fuzz_readers $(ARGS)

LOCK := --no-header --no-emit-index-url --no-annotate --python-version 3.11
# The oldest Python decides, so that each Python gets the versions that the tests ran with.
lock: setup     ## renew the locked dependencies from pyproject.toml
	@install -D requirements.txt build/oldest_python.txt
	$(BIN)/uv pip compile pyproject.toml --extra dev $(LOCK) -o build/oldest_python.txt
	$(BIN)/uv pip compile pyproject.toml --extra dev -c build/oldest_python.txt --universal --generate-hashes $(LOCK) -o requirements.txt
	$(BIN)/uv pip compile pyproject.toml --extra s3 --extra dask -c requirements.txt --universal --generate-hashes $(LOCK) -o requirements-runtime.txt
