"""Every benchmark runs once with little to do. Its figures are checked where they do not depend on the machine."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.cases import cases
from tests.chromium import CHROMIUM
from tests.command import conetl
from tests.folders import ROOT, SAMPLE, SHARED
from tests.integration.small_drives import cut_drive

BOARDS = SHARED / "feb_stereo_chessboard" / "pairs"


@dataclass(frozen=True)
class Tiny:
    """Arguments of a small run, where {boards}, {drive} and {sample} stand for folders, and what holds of its figures."""

    arguments: str
    holds: Callable[[Any], bool]
    skipped: str = ""
    """Why it cannot run on this machine."""


def few_boards(folder: Path) -> Path:
    """Every third pair of the images of a chessboard, where they are at hand."""
    folder.mkdir()
    for number in (2 * pair + side for pair in range(0, 40, 3) for side in (0, 1)):
        (folder / f"{number:05d}.jpg").symlink_to(BOARDS / f"pic{number:05d}.jpg")
    return folder


def held_no_drive(found: dict[str, Any]) -> bool:
    return found["false alarms"][0]["held"] == 0 and len(found["positions"]) == 4 and len(found["clocks"]) == 2


def merged_all(found: dict[str, Any]) -> bool:
    commits = [row["commits"] for row in found["writers"]]
    return (
        (found["pairs"]["merged"], found["pairs"]["deadlocks"], found["pairs"].get("audits failed", 0)) == (4, 0, 0)
        and commits == [2, 2, 2]
        and found["month"]["audits failed"] == "none"
        and found["month"]["drives"] >= 16
    )


def same_errors(rows: list[dict[str, Any]]) -> bool:
    conetl_m, _, opencv_m = (row["median error m"] for row in rows)
    return abs(conetl_m / opencv_m - 1) < 0.01


TINY = {
    "alike": Tiny(
        "--drive {sample} --pairs 20 --stop-s 3 --only stop",
        lambda f: (f[0]["searched"], f[1]["searched"], f[1]["pairs"]) == (20, 21, 50) and f[1]["apart mm"] < 20,
    ),
    "calibration": Tiny(
        "{boards} --board chessboard:9x6:37.8mm --pairing even-odd --halves 1",
        lambda f: f["sigma_mm"] > 0 and abs(f["differences_sigmas"][0]) < 5,
        "" if BOARDS.is_dir() else f"no chessboard images at {BOARDS}; set CONETL_SHARED_DATA",
    ),
    "changes": Tiny(
        "--days 4 --roads 2 --processes 1", lambda f: f["f1"] > 0.9 and sum(n for *_, n in f["confusion"]) > 20
    ),
    "detect": Tiny("--runs 1", lambda f: all(d["passes"]["conetl whole"]["objects_found"] for d in f["detections"])),
    "export": Tiny("--features 1000", lambda f: f["rows"] == 1000),
    "fleet": Tiny("--writers 2 --drives 1 --days 8 --scale 400 --zones 1 --pairs 2", merged_all),
    "health": Tiny("--drives 2 --no-cost", held_no_drive),
    "honest": Tiny(
        "--drives 1 --recordings 1 --only ^steps",
        lambda f: [one["on"] for one in f] == ["simulated motions", "drive 1"],
    ),
    "ingest": Tiny(
        "--pairs 4", lambda f: list(f) == ["decode + network", "whole job, refined", "whole job, logged poses"]
    ),
    "intersection": Tiny("--points 1000 --rounds 1", same_errors),
    "kills": Tiny("--kills 1", lambda f: f["faults"] == [] and sum(f["outcome"].values()) == 1),
    "map": Tiny(
        "--sizes 2000 --sightings 1000 --audits",
        lambda f: [row["sightings"] for row in f] == ["10 per track", "1 per track"],
    ),
    "mutants": Tiny(
        "--only ^good.on.drive.1$",
        lambda f: [(o["cones"] > 5, o["wrong"], o["phantoms"], o["exit"]) for o in f] == [(True, 0, 0, 0)],
    ),
    "ogc": Tiny(
        "--features 1000 --users 2 --seconds 0.5 --pause-s 0.1", lambda f: all(row["requests"] > 0 for row in f)
    ),
    "overhead": Tiny("--pairs 4 --rounds 1", lambda f: set(f["cold_s"]) == {"plain", "prefect"}),
    "plans": Tiny(
        "--zones 20 --nights 20 --seeds 1",
        lambda f: (
            f[0]["rows"] > 20
            and min(f[0]["precision"], f[0]["recall"]) > 0.9
            and not f[0]["not_looked_called_not_found"]
        ),
    ),
    "recordings": Tiny(
        "{drive} --parts logs --containers 'ROS 2 bag'",
        lambda f: len(f["logs"]) == 2 and all(row["held"] == "no" for row in f["logs"]),
    ),
    "text_limits": Tiny(
        "--scale 0.001 --only :",
        lambda f: len(f) > 12 and sum(row["result"] == "read" for row in f) == len(f) - 3,  # three are no calibrations
    ),
    "trajectory": Tiny("{drive}", lambda f: len(f) == 4 and all(row["largest shift of a cone m"] < 0.5 for row in f)),
    "view": Tiny(
        "--points 1000 --cones 20 --lines 8 --runs 1 --rows 100 --seconds 0.5",
        lambda f: (f["points"], f["list_gaps"]) == (1000, 0) and 90 <= f["list_rows"] <= 100,
        "" if CHROMIUM else "no Chromium on this machine (Debian: apt install chromium)",
    ),
    "watch": Tiny("{sample} --rate 5 --frames 6", lambda f: 1 <= f["watch"]["frame_pairs"] <= 6),
}

#: They take most of the time of all, and what they run has tests of its own.
LONG = (
    "alike", "calibration", "changes", "detect", "fleet", "health", "honest", "ingest", "kills", "map", "mutants", "ogc",
    "overhead", "plans", "recordings", "trajectory", "view", "watch",
)  # fmt: skip


def test_every_benchmark_is_here() -> None:
    assert {path.stem.removeprefix("bench_") for path in (ROOT / "benchmarks").glob("bench_*.py")} == set(TINY)


@pytest.mark.parametrize("name", cases(*(name for name in TINY if name not in LONG), release=LONG))
def test_a_benchmark_gives_plausible_figures(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    tiny = TINY[name]
    if tiny.skipped:
        pytest.skip(tiny.skipped)
    folders = {
        "boards": few_boards(tmp_path / "boards"),
        "drive": cut_drive(SAMPLE, tmp_path / "drive", frames=range(6, 18)),
        "sample": SAMPLE,
    }
    server = request.getfixturevalue("prefect") if name in ("ingest", "overhead") else {}
    words = [word.format(**folders) for word in shlex.split(tiny.arguments)]
    done = conetl(*words, "--json", tmp_path / "figures.json", module=f"benchmarks.bench_{name}", **server)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert tiny.holds(figures), figures
