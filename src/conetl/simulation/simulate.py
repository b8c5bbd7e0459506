"""One pass of a simulated world as a drive in the layout of KITTI's raw data (synced and rectified), with its truth.

The calibration chain is KITTI's (Geiger et al., IJRR 2013): IMU -> velodyne -> camera 0 -> rectified camera 0 -> P_rect_0i = K [I
| t_i]. It is computed independently of the code that reads calibration files, so that each checks the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from datetime import datetime
from pathlib import Path
from typing import Literal

import numpy as np
import yaml

from conetl.geometry.camera import matrix_k
from conetl.model.arrays import Floats
from conetl.model.base import ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.rig import Camera
from conetl.reports.camera_images import jpeg
from conetl.simulation import trajectory
from conetl.simulation.mixed_world import mixed_pass
from conetl.simulation.scenario import scenario_pass
from conetl.simulation.scene import build_scene, develop, exposure_gain, render
from conetl.simulation.truth_files import write_truth

WorldName = Literal["taper", "mixed"]
JPEG_QUALITY = 74
CAMERAS = (2, 3)
F_PX, CX_PX, CY_PX = 640.0, 478.35, 146.20
"""For images of 960 x 320."""
DESIGN_SIZE = (960, 320)


def timestamp(start: datetime, seconds: float) -> str:
    """KITTI's time stamp with nanoseconds, UTC."""
    time_ns = ns_from_utc(start) + round(seconds * 1e9)
    return f"{utc_from_ns(time_ns):%Y-%m-%d %H:%M:%S}.{time_ns % 10**9:09d}"


def write_calibration(folder: Path, camera: Camera, made_on: datetime) -> None:
    """The three calib_*.txt files."""
    head = f"calib_time: {made_on:%d-%b-%Y %H:%M:%S}\n"
    k, size = matrix_k(camera), (camera.width_px, camera.height_px)
    lines = [head, "corner_dist: 9.950000e-02\n"]
    for number, t in trajectory.T_RECT_M.items():
        # Calibration before rectification: without lens distortion, because the images are rendered rectified.
        matrices = {
            "S": np.array(size, dtype=float), "K": k, "D": np.zeros(5), "R": np.eye(3), "T": trajectory.RECT_R_CAM0.T @ t,
            "S_rect": np.array(size, dtype=float), "R_rect": trajectory.RECT_R_CAM0,
            "P_rect": k @ np.column_stack([np.eye(3), t]),
        }  # fmt: skip
        lines += [f"{name}_{number:02d}: {_numbers(value)}\n" for name, value in matrices.items()]
    (folder / "calib_cam_to_cam.txt").write_text("".join(lines))
    for name, pose in (("velo_to_cam", trajectory.CAM0_SE3_VELO), ("imu_to_velo", trajectory.VELO_SE3_IMU)):
        text = f"{head}R: {_numbers(pose[:3, :3])}\nT: {_numbers(pose[:3, 3])}\n"
        (folder / f"calib_{name}.txt").write_text(text)


def write_oxts(folder: Path, records: Iterable[list[float]], stamps: Iterable[str]) -> None:
    """oxts/data/*.txt and oxts/timestamps.txt."""
    (folder / "oxts" / "data").mkdir(parents=True)
    for n, record in enumerate(records):
        words = [f"{value:.12f}" if k < 2 else f"{value:.10g}" for k, value in enumerate(record)]
        (folder / "oxts" / "data" / f"{n:010d}.txt").write_text(" ".join(words) + "\n")
    (folder / "oxts" / "timestamps.txt").write_text("".join(f"{stamp}\n" for stamp in stamps))


def _numbers(values: Floats) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(values))


def simulate_drive(
    out_dir: Path,
    *,
    pass_number: int,
    seed: int,
    world: WorldName = "taper",
    width_px: int = 960,
    height_px: int = 320,
    samples_per_pixel: int = 16,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render pass 1, 2 or 3 into `out_dir` (new or empty) and return it.

    The true trajectory places the cameras; oxts/ contains the noisy one. `seed` determines the noise of cameras and GNSS/INS, and
    the scene of the mixed world, not that of the taper: equal arguments give equal files. progress: called with (images done,
    total images). Raises InputError without Mitsuba, for a folder that is not empty, and for invalid numbers.
    """
    if width_px < 16 or height_px < 16 or samples_per_pixel < 1 or seed < 0:
        raise InputError(
            f"cannot render {width_px} x {height_px} pixels with {samples_per_pixel} samples and seed {seed}: "
            "at least 16 pixels each way, one sample and a seed of 0 or more"
        )
    scenario = mixed_pass(seed, pass_number) if world == "mixed" else scenario_pass(pass_number)
    if out_dir.exists() and (not out_dir.is_dir() or any(out_dir.iterdir())):
        raise InputError(f"{out_dir}: exists and is not empty; choose a new folder")
    scene = build_scene(scenario.world)
    camera = simulated_camera(width_px, height_px)
    times_s: Floats = np.arange(scenario.frame_count) * np.float64(trajectory.FRAME_PERIOD_S)
    poses = trajectory.true_poses(scenario, times_s)
    places, rpy = trajectory.measured_poses(poses, times_s, np.random.default_rng([seed, pass_number, 0]))
    stamps = [timestamp(scenario.start_utc, t) for t in times_s]

    out_dir.mkdir(parents=True, exist_ok=True)
    write_calibration(out_dir, camera, scenario.start_utc)
    write_oxts(out_dir, trajectory.oxts_records(places, rpy, times_s), stamps)
    # OXTS records state one sigma of the position; these are the ones of the noise, in all axes.
    (out_dir / "drive.yaml").write_text(yaml.safe_dump({"sigmas": trajectory.stated_sigmas()}, sort_keys=False))
    write_truth(out_dir, scenario)
    for number in CAMERAS:
        (out_dir / f"image_{number:02d}" / "data").mkdir(parents=True)
        (out_dir / f"image_{number:02d}" / "timestamps.txt").write_text("".join(f"{stamp}\n" for stamp in stamps))

    road_SE3_map = np.linalg.inv(trajectory.map_SE3_road())
    gain = math.nan
    total = len(CAMERAS) * len(poses)
    for frame, pose in enumerate(poses):
        for number in CAMERAS:
            rng = np.random.default_rng([seed, pass_number, 1, frame, number])
            road_SE3_camera = road_SE3_map @ pose @ trajectory.body_SE3_camera(number)
            radiance = render(
                scene, camera, road_SE3_camera, samples_per_pixel=samples_per_pixel, seed=int(rng.integers(1 << 31))
            )
            if math.isnan(gain):  # one exposure for the whole drive, set on its first image
                gain = exposure_gain(radiance, scenario.exposure)
            image = develop(radiance, gain, rng)
            path = out_dir / f"image_{number:02d}" / "data" / f"{frame:010d}.jpg"
            path.write_bytes(jpeg(image, JPEG_QUALITY))
            if progress is not None:
                progress(len(CAMERAS) * frame + CAMERAS.index(number) + 1, total)
    return out_dir


def simulated_camera(width_px: int = DESIGN_SIZE[0], height_px: int = DESIGN_SIZE[1]) -> Camera:
    """Both cameras, with the field of view of the 960-pixel image at any width; other aspect ratios add or remove rows evenly."""
    scale = width_px / DESIGN_SIZE[0]
    cy_px = (CY_PX + 0.5 - DESIGN_SIZE[1] / 2) * scale + height_px / 2 - 0.5
    f_px, cx_px = F_PX * scale, (CX_PX + 0.5) * scale - 0.5
    return Camera(width_px=width_px, height_px=height_px, fx_px=f_px, fy_px=f_px, cx_px=cx_px, cy_px=cy_px)
