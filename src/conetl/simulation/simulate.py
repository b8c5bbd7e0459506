"""`simulate_drive`: one pass of the sample scenario as a drive in KITTI's layout."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.model.errors import InputError
from conetl.simulation import kitti_writer, trajectory
from conetl.simulation.rig import simulated_rig
from conetl.simulation.scenario import scenario_pass
from conetl.simulation.scene import build_scene, develop, encode_jpeg, exposure_gain, load_mitsuba, render

JPEG_QUALITY = 74
CAMERAS = (2, 3)


def simulate_drive(
    out_dir: Path,
    *,
    pass_number: int,
    seed: int,
    width_px: int = 960,
    height_px: int = 320,
    samples_per_pixel: int = 16,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render pass 1, 2 or 3 into `out_dir` (new or empty) and return it.

    The true trajectory places the cameras; oxts/ contains the noisy one. `seed` determines the noise of cameras and GNSS/INS,
    not the scene: equal arguments give equal files. progress: called with (images done, total images). Raises InputError
    without Mitsuba, for a folder that is not empty, and for invalid numbers.
    """
    scenario = scenario_pass(pass_number)
    if width_px < 16 or height_px < 16 or samples_per_pixel < 1 or seed < 0:
        raise InputError(
            f"cannot render {width_px} x {height_px} pixels with {samples_per_pixel} samples and seed {seed}: "
            "at least 16 pixels each way, one sample and a seed of 0 or more"
        )
    load_mitsuba()
    if out_dir.exists() and (not out_dir.is_dir() or any(out_dir.iterdir())):
        raise InputError(f"{out_dir}: exists and is not empty; choose a new folder")
    rig = simulated_rig(width_px, height_px)
    times_s: NDArray[np.float64] = np.arange(scenario.frame_count) * np.float64(trajectory.FRAME_PERIOD_S)
    ahead_m = float(rig.body_SE3_camera(2)[0, 3])
    poses = trajectory.true_poses(scenario, times_s, ahead_m, rig.imu_height_m)
    places, rpy = trajectory.measured_poses(poses, times_s, np.random.default_rng([seed, pass_number, 0]))
    stamps = [kitti_writer.timestamp(scenario.start_utc, t) for t in times_s]

    out_dir.mkdir(parents=True, exist_ok=True)
    kitti_writer.write_calibration(out_dir, rig, scenario.start_utc)
    kitti_writer.write_oxts(out_dir, trajectory.oxts_records(places, rpy, times_s), stamps)
    kitti_writer.write_truth(out_dir / "truth.csv", scenario)
    for number in CAMERAS:
        (out_dir / f"image_{number:02d}" / "data").mkdir(parents=True)
        (out_dir / f"image_{number:02d}" / "timestamps.txt").write_text("".join(f"{stamp}\n" for stamp in stamps))

    scene = build_scene(scenario.world)
    road_SE3_map = np.linalg.inv(trajectory.map_SE3_road())
    gain = math.nan
    total = len(CAMERAS) * len(poses)
    for frame, pose in enumerate(poses):
        for number in CAMERAS:
            rng = np.random.default_rng([seed, pass_number, 1, frame, number])
            road_SE3_camera = road_SE3_map @ pose @ rig.body_SE3_camera(number)
            radiance = render(
                scene, rig.camera, road_SE3_camera, samples_per_pixel=samples_per_pixel, seed=int(rng.integers(1 << 31))
            )
            if math.isnan(gain):  # one exposure for the whole drive, set on its first image
                gain = exposure_gain(radiance, scenario.exposure)
            image = develop(radiance, gain, rng)
            path = out_dir / f"image_{number:02d}" / "data" / f"{frame:010d}.jpg"
            path.write_bytes(encode_jpeg(image, JPEG_QUALITY))
            if progress is not None:
                progress(len(CAMERAS) * frame + CAMERAS.index(number) + 1, total)
    return out_dir
