"""Every kind of recording against the images it was made of: the same drives as videos and bags, with logs of many formats.

The sample drives, and KITTI where it is in the shared data, are re-encoded; `analyse` must find the same cones. Differences
are those of the positions on sample drives, and of the distances between pairs of cones on KITTI, whose GNSS is accurate to
0.4 m. The log of a video has a record at each of its frames. Time (processor time, and by the clock) is that of reading and
analysing with the first log of a container: later ones find the detections of the same frames. Then positions alone at 1 Hz,
and the clock of images that is wrong by seconds. Run it more than once: libx264 does not write the same file in every run, and
one far cone of the third sample drive moves by 1 to 2.5 cm between them.

    python benchmarks/bench_recordings.py [DRIVE ...] [--parts logs sparse clocks] [--containers 'ROS 2 bag'] [--folder FOLDER]
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.geometry.packing import cov_matrix
from conetl.model.errors import ConetlError
from conetl.model.health import hold_reason
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.readers.drives.drive_yaml import read_drive_yaml
from conetl.readers.drives.video import preview
from tests.folders import KITTI, SAMPLES
from tests.unit.readers import trajectory_files as logs
from tests.unit.readers.drive_formats import write_bag, write_ros1_bag
from tests.video_drives import LOGS, frames_of, known_of, with_log, write_video_drive

#: A cone farther than this from every cone of the images is another one.
SAME_M = 2.0
VIDEOS: dict[str, dict[str, Any]] = {
    "2 x H.264": {"codec": "libx264", "options": {"crf": "18"}},
    "H.265 side by side": {
        "layout": "left-right", "codec": "libx265", "options": {"crf": "18", "x265-params": "log-level=none"},
    },
}  # fmt: skip
BAGS: dict[str, Callable[..., Path]] = {"ROS 1 bag": write_ros1_bag, "ROS 2 bag": write_bag}
CLOCK_ERRORS_S = (-20, -13.3, -5, 0, 5, 13.3, 20)
FIGURES = ("largest m", "median m", "horizontal m", "in sigmas", "pairs", "s per pair", "throughput", "by the clock")


class Run(NamedTuple):
    """An analysed recording and what it cost."""

    analysed: AnalysedDrive
    lost: int
    processor_s: float
    clock_s: float

    @property
    def per_pair_s(self) -> float:
        return self.processor_s / len(self.analysed.drive.frame_pairs)


def run(root: Path, home: Path) -> Run:
    """Read and analyse a recording. Raises ConetlError."""
    started, began = time.process_time(), time.monotonic()
    drive, rejections = read_drive(root, images_folder=home / "images")
    analysed = analyse(drive, rejections=rejections, settings=Settings(home=home, workers=2))
    return Run(analysed, len(rejections), time.process_time() - started, time.monotonic() - began)


class Differences(NamedTuple):
    """Of cones that both recordings have: of their positions, or of their distances from each other."""

    space_m: NDArray[np.float64]
    horizontal_m: NDArray[np.float64]
    sigmas: float | None
    """The largest component of a position's difference by its stated sigma."""


def differences(found: AnalysedDrive, true: AnalysedDrive, *, of_distances: bool) -> Differences:
    ours, theirs = (np.array([t.xyz_m for t in a.tracks]).reshape(-1, 3) for a in (found, true))
    apart = np.linalg.norm(ours[:, None] - theirs, axis=2)
    first, second = linear_sum_assignment(apart)
    same = apart[first, second] < SAME_M
    first, second = first[same], second[same]
    off = ours[first] - theirs[second]
    if not of_distances:
        sigma = np.sqrt([np.diag(cov_matrix(found.tracks[k].cov_m2)) for k in first]).reshape(-1, 3)
        in_sigmas = float(np.abs(off / sigma).max(initial=0.0))
        return Differences(np.linalg.norm(off, axis=1), np.linalg.norm(off[:, :2], axis=1), in_sigmas)
    one, other = np.triu_indices(len(off), 1)
    between = [p[one] - p[other] for p in (ours[first], theirs[second])]
    space, horizontal = (
        np.abs(np.subtract(*(np.linalg.norm(line[:, :axes], axis=1) for line in between))) for axes in (3, 2)
    )
    return Differences(space, horizontal, None)


def compared(names: Mapping[str, str], root: Path, home: Path, true: Run, *, cold: bool) -> dict[str, object]:
    """A row of the table. cold: nothing of these images was found before, so that the processor time is that of all steps."""
    try:
        found = run(root, home)
        if cold:  # the first run of a kind of file also pays for loading its libraries
            found = min(found, run(root, home.with_name(f"{home.name} again")), key=lambda run: run.processor_s)
    except ConetlError as error:
        return {**names, "cones": "refused", **dict.fromkeys(FIGURES), "held": str(error)}
    off = differences(found.analysed, true.analysed, of_distances=names["drive"].startswith("KITTI"))
    return {
        **names,
        "cones": f"{len(found.analysed.tracks)}/{len(true.analysed.tracks)}",
        "largest m": float(off.space_m.max()) if len(off.space_m) else None,
        "median m": float(np.median(off.space_m)) if len(off.space_m) else None,
        "horizontal m": float(off.horizontal_m.max()) if len(off.space_m) else None,
        "in sigmas": off.sigmas,
        "pairs": f"{len(found.analysed.drive.frame_pairs)}/{len(true.analysed.drive.frame_pairs)}",
        "s per pair": found.per_pair_s if cold else None,
        "throughput": true.per_pair_s / found.per_pair_s if cold else None,
        "by the clock": true.clock_s / found.clock_s if cold else None,
        "held": hold_reason(found.analysed.health) or "no",
    }


def every_second(t: logs.Known) -> logs.Known:
    """The records nearest to whole seconds since the first one."""
    age_s = (t.times_ns - t.times_ns[0]) * 1e-9
    rows = sorted({int(np.abs(age_s - second).argmin()) for second in range(int(age_s[-1]) + 1)})
    return logs.Known._make(column[rows] for column in t)


def corrected_s(analysed: AnalysedDrive) -> float:
    """By how much the analysis moved the poses in time: a small or doubtful offset is stated, and left as it is."""
    clock, assumed_s = analysed.trajectory.clock, analysed.drive.clock_sigma_s
    assumed_s = analysed.params.trajectory.clock_sigma_s if assumed_s is None else assumed_s
    return clock.offset_s if clock is not None and clock.is_applied(assumed_s) else 0.0


def clock_row(
    names: Mapping[str, str], videos: Path, root: Path, log: str, t: logs.Known, error_s: float,
    part_s: tuple[float, float] | None, home: Path, true: AnalysedDrive,
) -> dict[str, object]:  # fmt: skip
    """How well an error of `images.start` is found, and, for the largest one, what is left of it after the analysis.

    part_s: only these seconds of the video, so that the log is longer.
    """
    start_ns = int(t.times_ns[0]) + round(error_s * 1e9)
    images: dict[str, Any] = {"start": f"{np.datetime64(start_ns, 'ns')}Z".replace("T", " ")}
    if part_s:
        images |= {"from_s": part_s[0], "to_s": part_s[1]}
    with_log(videos, root, LOGS[log], t, images=images, clock={"offset_s": "estimate"})
    row = {
        **names,
        "log": log,
        "video": "all" if part_s is None else f"{part_s[0]:g} to {part_s[1]:g} s",
        "wrong by s": error_s,
    }
    found: dict[str, object] = {"found off by ms": None, "sigma ms": None, "after analysis ms": None}
    try:
        clock = preview(root, read_drive_yaml(root)).timing.clock
        off_ms = 1000 * (clock.offset_s + error_s)
        found |= {"found off by ms": off_ms, "sigma ms": 1000 * clock.sigma_s}
        if error_s == CLOCK_ERRORS_S[-1]:
            found["after analysis ms"] = off_ms - 1000 * (corrected_s(run(root, home).analysed) - corrected_s(true))
    except ConetlError as error:
        return {**row, **found, "held": str(error)}
    return {**row, **found, "held": "no"}


def rows_of(
    source: Path, folder: Path, parts: list[str], containers: list[str]
) -> Iterator[tuple[str, dict[str, object]]]:
    """The rows of one drive, each with the part that it belongs to."""
    name = "KITTI 0005" if source == KITTI else source.name[:10]
    true = run(source, folder / "home images")
    drive = read_drive(source)[0]  # with the poses as recorded
    t = known_of(drive)
    if "logs" in parts:
        # Once more: the first run of a process pays for loading the model and its libraries.
        again = run(source, folder / "home images again")
        true = min(true, again, key=lambda run: run.processor_s)
        yield "logs", {"drive": name, "container": "images", "log": "as recorded", "cones": f"{len(true.analysed.tracks)}",
                       **dict.fromkeys(FIGURES), "pairs": f"{len(drive.frame_pairs)}", "s per pair": true.per_pair_s,
                       "throughput": 1.0, "by the clock": 1.0, "held": hold_reason(true.analysed.health) or "no"}  # fmt: skip
        frames = frames_of(drive)
        for kind, write in ((kind, write) for kind, write in BAGS.items() if kind in containers):
            root = write(folder / kind.replace(" ", ""), frames, drive.rig)
            names = {"drive": name, "container": kind, "log": "NavSatFix + Imu"}
            yield "logs", compared(names, root, folder / f"home {kind}", true, cold=True)
    for kind, how in VIDEOS.items():
        if kind not in containers:
            continue
        if "logs" not in parts and kind != "2 x H.264":
            continue
        videos = write_video_drive(folder / f"videos {kind}", drive, trajectory=False, **how)
        home = folder / f"home {kind}"
        for number, (log_name, log) in enumerate(LOGS.items() if "logs" in parts else ()):
            names = {"drive": name, "container": kind, "log": log_name}
            root = with_log(videos, folder / f"{kind} {number}", log, t)
            yield "logs", compared(names, root, home, true, cold=number == 0)
        if kind != "2 x H.264":
            continue
        if "sparse" in parts and source == KITTI:
            root = with_log(videos, folder / "sparse", LOGS["RTKLIB .pos"], every_second(t))
            names = {"drive": name, "container": kind, "log": "RTKLIB .pos, 1 Hz"}
            yield "sparse", compared(names, root, home, true, cold=False)
        if "clocks" in parts:
            # Sample drives of 4 s are too short for an estimate, whatever the error is.
            pieces: list[tuple[float, float] | None] = [None, (3.0, 13.0)] if source == KITTI else [None]
            errors_s = CLOCK_ERRORS_S if source == KITTI else (5,)
            cases = itertools.product(("CSV", "RTKLIB .pos"), pieces, errors_s)
            for number, (log_name, piece, error_s) in enumerate(cases):
                root = folder / f"clock {number}"
                yield (
                    "clocks",
                    clock_row({"drive": name}, videos, root, log_name, t, error_s, piece, home, true.analysed),
                )


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("drives", nargs="*", type=Path, metavar="DRIVE", help="default: the sample drives and KITTI")
    parser.add_argument(
        "--parts", nargs="+", choices=("logs", "sparse", "clocks"), default=["logs", "sparse", "clocks"]
    )
    parser.add_argument("--containers", nargs="+", choices=[*BAGS, *VIDEOS], default=[*BAGS, *VIDEOS])
    parser.add_argument(
        "--folder", type=Path, help="where recordings are written (300 MB; default: a temporary folder)"
    )
    args = parser.parse_args()
    cv2.setNumThreads(1)
    sources = args.drives or [path for path in (*SAMPLES, KITTI) if path.is_dir()]
    tables: dict[str, list[dict[str, object]]] = {}
    for source in sources:
        with TemporaryDirectory(prefix="conetl-recordings-", dir=args.folder) as folder:
            for part, row in rows_of(source, Path(folder), args.parts, args.containers):
                tables.setdefault(part, []).append(row)
                print(*(f"{v:.3g}" if isinstance(v, float) else v for v in row.values()), sep=" | ", flush=True)
    titles = {
        "logs": "Recordings against the images they were made of",
        "sparse": "Positions alone, once per second",
        "clocks": "images.start wrong, clock: {offset_s: estimate}",
    }
    for part, rows in tables.items():
        print_rows(f"\n{titles[part]}", [{k: v for k, v in row.items() if k != "held"} for row in rows])
    for row in (row for rows in tables.values() for row in rows if row.get("held", "no") != "no"):
        print(f"held or refused: {row['drive']}, {row.get('container', 'clock')}, {row['log']}: {row['held']}")
    write_json(args.json, tables)


if __name__ == "__main__":
    main()
