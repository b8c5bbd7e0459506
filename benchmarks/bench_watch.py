"""Latency of `conetl watch`: a recorded KITTI drive is written again, frame pair by frame pair, at the rate of a camera.

    python benchmarks/bench_watch.py [DRIVE] [--rate 10] [--frames 154]
    python benchmarks/bench_watch.py --polls 36000       # cost of looking for new pairs in a long drive, without images

Images are written in place in pieces, as a recorder does, after the OXTS record and the time stamps. The output is that of
`conetl watch` at its end, and the load of the machine. The provisional features go to CONETL_DATABASE_URL, or to a private
cluster.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.harness import CONETL, arguments_of, best_ms, load, write_json
from conetl.readers.recording import ArrivingKitti, open_arriving
from tests.folders import KITTI

_PIECE = 65_536


def write_in_pieces(source: Path, target: Path) -> None:
    """Copy a file so that a reader meanwhile sees a part of it."""
    data = source.read_bytes()
    with target.open("wb", buffering=0) as file:
        for start in range(0, len(data), _PIECE):
            file.write(data[start : start + _PIECE])


def replay(drive: Path, folder: Path, rate_hz: float, frames: int) -> float:
    """Write the drive into `folder`; the largest delay of a pair, in seconds."""
    names = ("image_02", "image_03", "oxts")
    stamps = {name: (drive / name / "timestamps.txt").read_text().splitlines() for name in names}
    for name in names:
        (folder / name / "data").mkdir(parents=True)
    begin, late_s = time.monotonic(), 0.0
    for image in sorted((drive / "image_02" / "data").iterdir())[:frames]:
        number = int(image.stem)
        due = begin + number / rate_hz
        time.sleep(max(0.0, due - time.monotonic()))
        late_s = max(late_s, time.monotonic() - due)
        for name in names:
            with (folder / name / "timestamps.txt").open("a") as file:
                file.write(stamps[name][number] + "\n")
        record = f"oxts/data/{image.stem}.txt"
        shutil.copyfile(drive / record, folder / record)
        for name in names[:2]:
            write_in_pieces(drive / name / "data" / image.name, folder / name / "data" / image.name)
    (folder / "COMPLETE").touch()
    return late_s


def measure_polls(pairs: int) -> dict[str, float]:
    """Milliseconds of the steps that look for new pairs, in a KITTI drive of empty files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for camera in ("image_02", "image_03"):
            (folder / camera / "data").mkdir(parents=True)
            for number in range(pairs):
                (folder / camera / "data" / f"{number:010d}.jpg").touch()
            stamps = (f"2026-03-02 09:41:{number % 60:02d}.{number:06d}000\n" for number in range(pairs))
            (folder / camera / "timestamps.txt").write_text("".join(stamps))
        drive = open_arriving(folder)
        assert isinstance(drive, ArrivingKitti)
        numbers = iter(range(pairs))
        return {
            "frame_pairs": pairs,
            "first_poll_ms": best_ms(lambda: drive.new_pairs(None), 1),
            "poll_without_new_pairs_ms": best_ms(lambda: drive.new_pairs(None), 7),
            "time_of_a_pair_ms": best_ms(lambda: drive._time("image_02/timestamps.txt", next(numbers)), 7),
        }


def measure_latency(source: Path, rate_hz: float, frames: int) -> dict[str, object]:
    """The output of `conetl watch` for a replayed drive."""
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home) / f"{source.name}_live"
        folder.mkdir()
        for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
            shutil.copy(source / name if (source / name).is_file() else source.parent / name, folder)
        environment = {"CONETL_HOME": f"{home}/home", **os.environ}
        command = [*CONETL, "watch", str(folder), "--json", "--idle-seconds", "30"]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        ) as watch:
            assert watch.stderr is not None
            if "Watching" not in (first := watch.stderr.readline()):
                sys.exit(first + watch.stderr.read())
            before = load()
            late_s = replay(source, folder, rate_hz, frames)
            output, errors = watch.communicate(timeout=300)
        if "CONETL_DATABASE_URL" not in environment:
            subprocess.run([*CONETL, "db", "down"], env=environment, check=False, stdout=subprocess.DEVNULL)
    if errors:
        print(errors, file=sys.stderr)
    replayed = {"rate_hz": rate_hz, "largest_delay_ms": round(1000 * late_s), "load": [before, load()]}
    return {"watch": json.loads(output), "replay": replayed}


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("drive", nargs="?", type=Path, default=KITTI)
    parser.add_argument("--rate", type=float, default=10.0, help="frame pairs per second")
    parser.add_argument("--frames", type=int, default=10_000, help="at most this many frame pairs")
    parser.add_argument("--polls", type=int, metavar="PAIRS", help="measure only the search for new pairs")
    options = parser.parse_args()
    if options.polls:
        figures: dict[str, object] = {**measure_polls(options.polls)}
    else:
        if not options.drive.is_dir():
            sys.exit(f"there is no drive at {options.drive}: name one in KITTI's layout")
        figures = measure_latency(options.drive, options.rate, options.frames)
    print(json.dumps(figures, indent=1))
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
