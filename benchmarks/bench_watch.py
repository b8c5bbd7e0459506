"""Latency of `conetl watch`: a recorded KITTI drive is written again, frame pair by frame pair, at the rate of a camera.

    python benchmarks/bench_watch.py [DRIVE] [--rate 10] [--frames 154]

Images are written in place in pieces, as a recorder does, after the OXTS record and the time stamps. Prints what
`conetl watch` says at its end, and the load of the machine. The provisional features go to
CONETL_DATABASE_URL, or to a private cluster of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("CONETL_SHARED_DATA", ROOT.parent / "shared" / "data"))
KITTI = SHARED / "kitti_2011_09_26_drive_0005_sync"
_PIECE = 65_536


def write_in_pieces(source: Path, target: Path) -> None:
    """Copy a file so that whoever looks meanwhile sees a part of it."""
    data = source.read_bytes()
    with target.open("wb", buffering=0) as file:
        for start in range(0, len(data), _PIECE):
            file.write(data[start : start + _PIECE])


def append_line(source: list[str], number: int, target: Path) -> None:
    with target.open("a") as file:
        file.write(source[number] + "\n")


def replay(drive: Path, folder: Path, rate_hz: float, frames: int) -> float:
    """Write the drive into `folder`; the longest that a pair was late, in seconds."""
    stamps = {
        name: (drive / name / "timestamps.txt").read_text().splitlines() for name in ("image_02", "image_03", "oxts")
    }
    for name in stamps:
        (folder / name / "data").mkdir(parents=True)
    begin, late_s = time.monotonic(), 0.0
    for picture in sorted((drive / "image_02" / "data").iterdir())[:frames]:
        number = int(picture.stem)
        due = begin + number / rate_hz
        time.sleep(max(0.0, due - time.monotonic()))
        late_s = max(late_s, time.monotonic() - due)
        for name in ("image_02", "image_03"):
            append_line(stamps[name], number, folder / name / "timestamps.txt")
        append_line(stamps["oxts"], number, folder / "oxts" / "timestamps.txt")
        shutil.copyfile(
            drive / "oxts" / "data" / f"{picture.stem}.txt", folder / "oxts" / "data" / f"{picture.stem}.txt"
        )
        for name in ("image_02", "image_03"):
            write_in_pieces(drive / name / "data" / picture.name, folder / name / "data" / picture.name)
    (folder / "COMPLETE").touch()
    return late_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", nargs="?", type=Path, default=KITTI)
    parser.add_argument("--rate", type=float, default=10.0, help="frame pairs a second")
    parser.add_argument("--frames", type=int, default=10_000, help="at most so many frame pairs")
    arguments = parser.parse_args()
    if not arguments.drive.is_dir():
        sys.exit(f"there is no drive at {arguments.drive}: name one in KITTI's layout")
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home) / f"{arguments.drive.name}_live"
        folder.mkdir()
        for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
            place = arguments.drive if (arguments.drive / name).is_file() else arguments.drive.parent
            shutil.copy(place / name, folder)
        command = [sys.executable, "-c", "from conetl.cli import main; main()", "watch", str(folder), "--json"]
        command += ["--idle-seconds", "30"]
        environment = {"CONETL_HOME": f"{home}/home", **os.environ}
        own_cluster = "CONETL_DATABASE_URL" not in environment
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
        ) as watch:
            assert watch.stderr is not None
            if "Watching" not in (said := watch.stderr.readline()):
                sys.exit(said + watch.stderr.read())
            load = os.getloadavg()[0]
            late_s = replay(arguments.drive, folder, arguments.rate, arguments.frames)
            told, complaints = watch.communicate(timeout=300)
        if own_cluster:
            subprocess.run([*command[:3], "db", "down"], env=environment, check=False, stdout=subprocess.DEVNULL)
    if complaints:
        print(complaints, file=sys.stderr)
    print(json.dumps(json.loads(told), indent=1))
    loads = f"load {load:.1f} before, {os.getloadavg()[0]:.1f} after"
    print(f"replayed at {arguments.rate:g} Hz, at most {1000 * late_s:.0f} ms late; {loads}")


if __name__ == "__main__":
    main()
