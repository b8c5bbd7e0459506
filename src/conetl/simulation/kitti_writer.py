"""Writer of drives in the layout of KITTI's raw data (synced and rectified), plus truth.csv."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.simulation.rig import SimulatedRig
from conetl.simulation.scenario import ScenarioPass
from conetl.simulation.trajectory import MAP_SRID, map_SE3_road

Array = NDArray[np.float64]

TRUTH_COLUMNS = (
    "cone_id", "easting_m", "northing_m", "height_ellipsoidal_m", "cone_height_m", "map_srid", "present", "change"
)  # fmt: skip


def timestamp(start: datetime, seconds: float) -> str:
    """KITTI's time stamp with nanoseconds, UTC."""
    whole = start.replace(microsecond=0)
    nanoseconds = round(start.microsecond * 1000 + seconds * 1e9)
    moment = whole + timedelta(seconds=nanoseconds // 1_000_000_000)
    return f"{moment:%Y-%m-%d %H:%M:%S}.{nanoseconds % 1_000_000_000:09d}"


def write_calibration(folder: Path, rig: SimulatedRig, made_on: datetime) -> None:
    """The three calib_*.txt files."""
    head = f"calib_time: {made_on:%d-%b-%Y %H:%M:%S}\n"
    k, size = rig.k(), (rig.camera.width_px, rig.camera.height_px)
    lines = [head, "corner_dist: 9.950000e-02\n"]
    for number, t in rig.t_rect_m.items():
        # Calibration before rectification: without lens distortion, because the images are rendered rectified.
        r_rect = rig.rect_R_cam0
        matrices = {
            "S": np.array(size, dtype=float), "K": k, "D": np.zeros(5), "R": np.eye(3), "T": r_rect.T @ t,
            "S_rect": np.array(size, dtype=float), "R_rect": r_rect, "P_rect": k @ np.column_stack([np.eye(3), t]),
        }  # fmt: skip
        lines += [f"{name}_{number:02d}: {_numbers(value)}\n" for name, value in matrices.items()]
    (folder / "calib_cam_to_cam.txt").write_text("".join(lines))
    for name, pose in (("velo_to_cam", rig.cam0_SE3_velo), ("imu_to_velo", rig.velo_SE3_imu)):
        text = f"{head}R: {_numbers(pose[:3, :3])}\nT: {_numbers(pose[:3, 3])}\n"
        (folder / f"calib_{name}.txt").write_text(text)


def write_oxts(folder: Path, records: Iterable[list[float]], stamps: Iterable[str]) -> None:
    """oxts/data/*.txt and oxts/timestamps.txt."""
    (folder / "oxts" / "data").mkdir(parents=True)
    for n, record in enumerate(records):
        words = [f"{value:.12f}" if k < 2 else f"{value:.10g}" for k, value in enumerate(record)]
        (folder / "oxts" / "data" / f"{n:010d}.txt").write_text(" ".join(words) + "\n")
    (folder / "oxts" / "timestamps.txt").write_text("".join(f"{stamp}\n" for stamp in stamps))


def write_truth(path: Path, scenario: ScenarioPass) -> None:
    """truth.csv: the foot centre (of the base plate's underside) of each cone, present or removed."""
    place = map_SE3_road()
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TRUTH_COLUMNS)
        for cone, present in [(c, 1) for c in scenario.world.cones] + [(c, 0) for c in scenario.removed]:
            e, n, h = place[:3, :3] @ [cone.x_m, cone.y_m, 0.0] + place[:3, 3]
            change = scenario.changes[cone.cone_id]
            writer.writerow(
                [cone.cone_id, f"{e:.4f}", f"{n:.4f}", f"{h:.4f}", f"{cone.height_m:.3f}", MAP_SRID, present, change]
            )


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(values))
