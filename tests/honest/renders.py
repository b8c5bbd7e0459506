"""Rendered drives for `recordings.py`, outside of the repository: bends, a stop and reversing, bumps, turns; other rigs.

    python -m tests.honest.renders FOLDER [NAME ...]     (needs Mitsuba: pip install 'conetl[simulate]'; 5 to 20 minutes each)

Each is a plain drive folder with truth.csv, whose poses are true.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.camera import matrix_k
from conetl.geometry.geodesy import CAMERA_R_BODY, grid_convergence_rad, to_geodetic
from conetl.model.rig import Camera
from conetl.readers.drives.plain import Row
from conetl.reports.camera_images import jpeg
from conetl.simulation.mixed_world import mixed_pass
from conetl.simulation.scenario import ScenarioPass, scenario_pass
from conetl.simulation.scene import build_scene, develop, exposure_gain, render
from conetl.simulation.simulate import timestamp
from conetl.simulation.trajectory import MAP_SRID, map_SE3_road
from conetl.simulation.truth_files import write_truth

Floats = NDArray[np.float64]
Column = Callable[[Floats], Floats]
STEP_S, _FINE_S = 0.1, 0.001
#: Paths go on at the speed of their ends so long before and after the images, for logs of 1 Hz.
_AROUND_S = 16.0
_BODY_HEIGHT_M = 1.0
_QUALITY = 85
#: Written last.
DONE = "truth.csv"


def none(times_s: Floats) -> Floats:
    return np.zeros_like(times_s)


@dataclass(frozen=True)
class Eye:
    """One camera of a rig."""

    camera: Camera
    body_t_m: tuple[float, float, float]
    turned_deg: float = 0.0
    """To the left."""
    fisheye: tuple[float, float, float, float] | None = None
    """Coefficients of an equidistant lens."""

    @property
    def body_SE3_camera(self) -> Floats:
        return se3.se3(
            Rotation.from_euler("z", self.turned_deg, degrees=True).as_matrix() @ CAMERA_R_BODY.T, self.body_t_m
        )


@dataclass(frozen=True)
class Render:
    """A drive to render: a street, a rig, and a path by functions of time."""

    scenario: ScenarioPass
    left: Eye
    right: Eye
    pairs: int
    start_m: tuple[float, float]
    """On the road."""
    speed_m_s: Column
    yaw_rad: Column
    pitch_rad: Column = field(default=none)
    heave_m: Column = field(default=none)

    def poses_at(self, times_s: Floats) -> Floats:
        """(K, 4, 4) true poses body -> map."""
        fine_s = np.arange(-_AROUND_S, self.pairs * STEP_S + _AROUND_S, _FINE_S)
        inside_s = np.clip(fine_s, 0.0, (self.pairs - 1) * STEP_S)
        speed, yaw = self.speed_m_s(inside_s), self.yaw_rad(inside_s)
        path = np.cumsum(np.stack([np.cos(yaw), np.sin(yaw)], axis=1) * speed[:, None] * _FINE_S, axis=0)
        path += np.array(self.start_m) - path[np.searchsorted(fine_s, 0.0)]
        height = _BODY_HEIGHT_M + self.heave_m(inside_s)
        x, y, z, turn, pitch = (
            np.interp(times_s, fine_s, column) for column in (*path.T, height, yaw, self.pitch_rad(inside_s))
        )
        roll = 0.004 * np.sin(3.1 * times_s)
        return np.asarray(
            map_SE3_road() @ se3.se3(se3.rotation_from_rpy(roll, pitch, turn), np.stack([x, y, z], axis=1))
        )


def _eyes(camera: Camera, baseline_m: float, *, verged_deg: float = 0.0, fisheye: bool = False) -> tuple[Eye, Eye]:
    lens = (-0.02, 0.004, 0.0, 0.0) if fisheye else None
    left = Eye(camera, (0.9, baseline_m / 2, 0.62), -verged_deg, lens)
    return left, replace(left, body_t_m=(0.9, -baseline_m / 2, 0.62), turned_deg=verged_deg)


def _camera(width: int, height: int, focal: float) -> Camera:
    return Camera(
        width_px=width, height_px=height, fx_px=focal, fy_px=focal, cx_px=width / 2 - 3.3, cy_px=0.44 * height
    )


def _bumps(times_s: Floats) -> Floats:
    """Damped oscillations after each of some bumps, of amplitude one."""
    since = times_s[:, None] - np.array([0.6, 1.7, 3.1])
    return np.asarray((np.where(since > 0, np.exp(-3 * since) * np.sin(2 * np.pi * 1.6 * since), 0.0)).sum(axis=1))


def _stops(times_s: Floats) -> Floats:
    """6 m/s, a stop, 2 m/s backwards, 4 m/s."""
    return np.interp(times_s, [0, 0.8, 2.4, 3.0, 3.6, 4.6, 5.2, 6.2], [6, 6, 0, 0, -2, -2, 0, 4])


def _turn(times_s: Floats) -> Floats:
    """A second straight on, then 40 degrees to the left in 3 s."""
    share = np.clip((times_s - 1.0) / 3.0, 0, 1)
    return np.radians(40.0) * share**2 * (3 - 2 * share)


@cache
def renders() -> dict[str, Render]:
    """By name."""
    wide, narrow = _camera(960, 320, 640.0), _camera(1056, 352, 704.0)
    left, right = _eyes(wide, 1.5)
    fish = _camera(640, 384, 400.0)
    return {
        "bends": Render(
            scenario_pass(1), *_eyes(wide, 0.54), 40, (-14.0, -1.5), lambda t: 8.0 + none(t),
            lambda t: 0.2 * np.sin(2 * np.pi * t / 5),
        ),
        "stop and reverse": Render(
            mixed_pass(11, 1), *_eyes(_camera(800, 288, 640.0), 0.12, verged_deg=1.5), 66, (-12.0, -1.2), _stops,
            lambda t: 0.02 * np.sin(t),
        ),
        "bumps": Render(
            mixed_pass(12, 1), left, replace(right, camera=narrow), 34, (-16.0, -1.0), lambda t: 12.0 + 1.5 * np.sin(t),
            lambda t: 0.01 * np.sin(1.3 * t), lambda t: np.radians(1.5) * _bumps(t), lambda t: 0.04 * _bumps(t + 0.1),
        ),
        "fisheye": Render(
            scenario_pass(2), *_eyes(fish, 0.3, fisheye=True), 36, (2.0, -1.6), lambda t: 3.5 + 0.3 * np.sin(t), _turn,
        ),
    }  # fmt: skip


def write_render(folder: Path, name: str, samples: int = 8) -> None:
    """The drive folder. Equal names give equal files."""
    drive = renders()[name]
    times_s = np.arange(drive.pairs) * STEP_S
    poses = drive.poses_at(times_s)
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    (folder / "rig.yaml").write_text(yaml.safe_dump(_rig(name, drive), sort_keys=False))
    with (folder / "trajectory.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Row.model_fields)
        lat, lon, height = to_geodetic(MAP_SRID, poses[:, :3, 3]).T
        angles = Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX")[:, ::-1]
        angles[:, 2] -= grid_convergence_rad(MAP_SRID, lat, lon)
        for k, time_s in enumerate(times_s.tolist()):
            stamp = timestamp(drive.scenario.start_utc, time_s)
            values = [
                f"{lon[k]:.11f}",
                f"{lat[k]:.11f}",
                f"{height[k]:.5f}",
                *(f"{a:.8f}" for a in np.degrees(angles[k])),
            ]
            writer.writerow([f"{k:06d}", stamp, *values, *[0.02, 0.02, 0.03], *[0.02, 0.02, 0.06]])
    scene, gain = build_scene(drive.scenario.world), float("nan")
    road_SE3_map = np.linalg.inv(map_SE3_road())
    for k, pose in enumerate(poses):
        for number, (side, eye) in enumerate((("left", drive.left), ("right", drive.right))):
            rng = np.random.default_rng([len(name), k, number])
            place = road_SE3_map @ pose @ eye.body_SE3_camera
            shown = _seen_through(eye)
            radiance = render(
                scene, shown, place, samples_per_pixel=samples, seed=int(rng.integers(1 << 31)), fast=True
            )
            gain = exposure_gain(radiance) if np.isnan(gain) else gain
            path = folder / side / f"{k:06d}.jpg"
            path.write_bytes(jpeg(develop(_by_lens(radiance, shown, eye), gain, rng), _QUALITY))
        print(f"{name}: pair {k + 1} of {drive.pairs}", flush=True)
    write_truth(folder, drive.scenario)


def _rig(name: str, drive: Render) -> dict[str, object]:
    def placed(pose: Floats) -> dict[str, object]:
        return {"R": pose[:3, :3].tolist(), "t_m": pose[:3, 3].tolist()}

    def seen(eye: Eye) -> dict[str, object]:
        found: dict[str, object] = {
            k: getattr(eye.camera, k) for k in ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
        }
        return found | ({"lens": {"model": "fisheye", "coefficients": list(eye.fisheye)}} if eye.fisheye else {})

    left, right = drive.left.body_SE3_camera, drive.right.body_SE3_camera
    return {
        "rig_id": name.replace(" ", "-"), "left": seen(drive.left), "right": seen(drive.right),
        "left_SE3_right": placed(se3.compose(se3.invert(left), right)), "body_SE3_left": placed(left),
    }  # fmt: skip


def _rays(eye: Eye) -> Floats:
    """(H, W, 2) direction of each pixel behind a fisheye lens, at depth 1."""
    camera = eye.camera
    pixels = np.stack(np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), axis=-1).reshape(-1, 1, 2)
    rays = cv2.fisheye.undistortPoints(pixels.astype(np.float64), matrix_k(camera), np.array(eye.fisheye))
    return np.asarray(rays.reshape(camera.height_px, camera.width_px, 2))


def _seen_through(eye: Eye) -> Camera:
    """The camera without a lens whose image shows all that the lens does."""
    if eye.fisheye is None:
        return eye.camera
    focal = 1.1 * eye.camera.fx_px
    lowest, highest = ((focal * end(_rays(eye), axis=(0, 1))) for end in (np.min, np.max))
    width, height = (np.ceil(highest - lowest).astype(int) + 4).tolist()
    cx, cy = (2 - lowest).tolist()
    return Camera(width_px=width, height_px=height, fx_px=focal, fy_px=focal, cx_px=cx, cy_px=cy)


def _by_lens(radiance: NDArray[np.float32], shown: Camera, eye: Eye) -> NDArray[np.float32]:
    """The image as the lens has it."""
    if eye.fisheye is None:
        return radiance
    at = (_rays(eye) * shown.fx_px + [shown.cx_px, shown.cy_px]).astype(np.float32)
    return np.asarray(cv2.remap(radiance, at[..., 0], at[..., 1], cv2.INTER_CUBIC), np.float32)


if __name__ == "__main__":
    root, *names = sys.argv[1:]
    for one in names or renders():
        if not (Path(root) / one).exists():
            write_render(Path(root) / one, one)
