"""Drives without images: image points with exactly the noise that they state, poses with stated errors, truth known.

Where `world.py` draws boxes and lets the matching make of them what it will, here every stated sigma is true by construction,
so that positions and tracks must come out with covariances that hold, to a few per cent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.evaluation.truth import TruthCone
from conetl.geometry import pose as se3
from conetl.geometry.packing import vec3
from conetl.model.drive import Detection, Drive, FramePair, Position, StereoMatch, Track
from conetl.model.params import PositionParams
from conetl.model.rig import Rig, Side
from conetl.tracking.association import MotionError
from conetl.tracking.matching.covariance import shared_disparity_px
from conetl.tracking.positions import locate_positions
from tests import records
from tests.synthetic.world import ORIGIN_M, Cone, apparent_box, camera_pose, drive_of, fuse_logged, make_path, shifted

SIGMA_U_PX, SIGMA_V_PX, SIGMA_POINTING_PX = 0.3, 0.8, 0.5
SIGMA_DISPARITY_PX = 2**0.5 * SIGMA_U_PX
#: Of the log, drawn once a drive, as large as those of RTK: east, north, up, and each angle.
LOG_SIGMA_M, LOG_SIGMA_RAD = np.array([0.03, 0.03, 0.045]), 0.0005


@dataclass(frozen=True)
class NoisyDrive:
    """One drawn drive: what the steps made of it, and the truth."""

    drive: Drive
    truth: list[TruthCone]
    matches: list[StereoMatch]
    positions: list[Position]
    tracks: list[Track]


def draw_positions(
    rng: np.random.Generator,
    rig: Rig,
    cones: Sequence[Cone],
    *,
    frames: int = 32,
    noise: float = 1.0,
    outline_px: float = 0.0,
) -> NoisyDrive:
    """One drive up to its single positions; match_index is the number of the cone.

    noise: what the stated image sigmas are multiplied with to get the true ones.
    outline_px: sigma of what all sightings of a cone share, along and across the rows; with it they share a part of their
    disparities' errors too, as stated.
    """
    true_pairs = make_path(frames)
    logged = _logged(rng, true_pairs)
    shared_px = [outline_px, outline_px, shared_disparity_px(SIGMA_DISPARITY_PX)]
    outlines = rng.normal(0, noise * np.array(shared_px), (len(cones), 3)) if outline_px else np.zeros((len(cones), 3))
    matches = [
        match.model_copy(update={"sigma_outline_px": outline_px})
        for pair in true_pairs
        for number, cone in enumerate(cones)
        if (match := _match(rng, cone, number, pair, rig, noise, outlines[number])) is not None
    ]
    positions, _ = locate_positions(matches, logged, rig, PositionParams())
    drive = drive_of(logged, rig)
    return NoisyDrive(drive, [_truth(number, cone) for number, cone in enumerate(cones)], matches, positions, [])


def draw_drive(rng: np.random.Generator, rig: Rig, cones: Sequence[Cone], **options: Any) -> NoisyDrive:
    """One drive through positions and tracks, which know that the log has no error from frame to frame but what is common."""
    drawn = draw_positions(rng, rig, cones, **options)
    found = [detection for match in drawn.matches for detection in (match.left, match.right)]
    pairs = drawn.drive.frame_pairs
    tracks, _ = fuse_logged(pairs, rig, found, drawn.matches, drawn.positions, motion=EXACT_MOTION)
    return replace(drawn, tracks=tracks)


#: Of a trajectory whose errors are all common.
EXACT_MOTION = MotionError(lambda _start, _end, _point_m: np.zeros((3, 3)), most_m2=lambda _range_m: 0.0)


def _truth(number: int, cone: Cone) -> TruthCone:
    x, y, z = np.add(ORIGIN_M, cone.foot_m).tolist()
    return records.truth_cone(f"C{number}", (x, y, z), cone.height_m)


def _logged(rng: np.random.Generator, pairs: Sequence[FramePair]) -> list[FramePair]:
    """The log, with errors of place and attitude as its sigmas say."""
    shift_m, turn = rng.normal(0, LOG_SIGMA_M), rng.normal(0, LOG_SIGMA_RAD, 3)
    logged = []
    for pair in pairs:
        true = Rotation.from_matrix(pair.pose.map_R_body).as_euler("ZYX")
        stated = {
            "map_R_body": se3.to_matrix3(Rotation.from_euler("ZYX", true + turn[::-1]).as_matrix()),
            "sigma_enu_m": vec3(LOG_SIGMA_M), "sigma_rpy_rad": (LOG_SIGMA_RAD,) * 3,
        }  # fmt: skip
        pose = shifted(pair, shift_m.tolist()).pose.model_copy(update=stated)
        logged.append(pair.model_copy(update={"pose": pose}))
    return logged


def _match(
    rng: np.random.Generator,
    cone: Cone,
    number: int,
    pair: FramePair,
    rig: Rig,
    noise: float,
    outline_px: NDArray[np.float64],
) -> StereoMatch | None:
    """Foot, centre and tip in both images, drawn; None where the cone is not wholly in view of both.

    outline_px (3,): what all sightings share, along and across the rows, and in the disparity.
    """
    boxes = {side: apparent_box(cone, pair, rig, side) for side in ("left", "right")}
    if boxes["left"] is None or boxes["right"] is None:
        return None
    points = np.outer([0.0, 0.5, 1.0], [0.0, 0.0, cone.height_m]) + np.add(cone.foot_m, ORIGIN_M)
    uv: dict[str, NDArray[np.float64]] = {}
    own: dict[str, float] = {}
    pointing = rng.normal(0, noise * SIGMA_POINTING_PX)
    for side in ("left", "right"):
        camera, pose = (rig.left if side == "left" else rig.right), camera_pose(pair, rig, side)
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        own[side] = rng.normal(0, noise * SIGMA_U_PX)
        u = outline_px[0] + camera.cx_px + camera.fx_px * local[:, 0] / local[:, 2] + pointing + own[side]
        v = (
            outline_px[1]
            + camera.cy_px
            + camera.fy_px * local[:, 1] / local[:, 2]
            + rng.normal(0, noise * SIGMA_V_PX, 3)
        )
        uv[side] = np.column_stack([u, v])
    if outline_px.any():
        # The stated sigma of a disparity is that of its own and the shared error together.
        share = (1 - (shared_disparity_px(SIGMA_DISPARITY_PX) / SIGMA_DISPARITY_PX) ** 2) ** 0.5
        apart = outline_px[2] - (1 - share) * (own["left"] - own["right"])
        uv["left"][:, 0] += apart / 2
        uv["right"][:, 0] -= apart / 2
    named = {
        f"{point}_{side}_uv_px": (float(uv[side][k, 0]), float(uv[side][k, 1]))
        for k, point in enumerate(("foot", "centre", "tip"))
        for side in ("left", "right")
    }
    return StereoMatch(
        frame_index=pair.frame_index, match_index=number, left=_detection(pair, "left", number, boxes["left"]),
        right=_detection(pair, "right", number, boxes["right"]), sigma_u_px=SIGMA_U_PX, sigma_v_px=SIGMA_V_PX,
        sigma_pointing_px=SIGMA_POINTING_PX, refined=True, cost=0.1, **named,
    )  # fmt: skip


def _detection(pair: FramePair, side: Side, number: int, box: tuple[float, float, float, float]) -> Detection:
    return records.box(*box, frame=pair.frame_index, side=side, index=number)
