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
from conetl.model.base import Matrix3
from conetl.model.drive import Detection, Drive, FramePair, Position, StereoMatch, Track
from conetl.model.params import PositionParams
from conetl.model.rig import Rig, Side
from conetl.tracking.association import MotionError
from conetl.tracking.matching.covariance import shared_disparity_px
from conetl.tracking.positions import locate_positions
from tests.synthetic.world import ORIGIN_M, Cone, apparent_box, camera_pose, fuse_logged, make_path

SIGMA_U_PX, SIGMA_V_PX, SIGMA_POINTING_PX = 0.3, 0.8, 0.5
SIGMA_DISPARITY_PX = 2**0.5 * SIGMA_U_PX


@dataclass(frozen=True)
class PoseErrors:
    """How the log of a drive differs from the truth; each is one sigma, drawn once a drive or once a frame."""

    common_m: float = 0.03
    """East and north; up is 1.5 times that."""
    common_rad: float = 0.0005
    per_frame_m: float = 0.0
    per_frame_rad: float = 0.0


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
    errors: PoseErrors,
    *,
    frames: int = 32,
    noise: float = 1.0,
    stated_share: float = 1.0,
    outline_px: float = 0.0,
) -> NoisyDrive:
    """One drive up to its single positions; match_index is the number of the cone.

    noise: what the stated image sigmas are multiplied with to get the true ones. stated_share: of the pose errors.
    outline_px: sigma of what all sightings of a cone share, along and across the rows; with it they share a part of their
    disparities' errors too, as stated.
    """
    true_pairs = make_path(frames)
    logged = _logged(rng, true_pairs, errors, stated_share)
    shared_px = [outline_px, outline_px, shared_disparity_px(SIGMA_DISPARITY_PX)]
    outlines = rng.normal(0, noise * np.array(shared_px), (len(cones), 3)) if outline_px else np.zeros((len(cones), 3))
    matches = [
        match.model_copy(update={"sigma_outline_px": outline_px})
        for pair in true_pairs
        for number, cone in enumerate(cones)
        if (match := _match(rng, cone, number, pair, rig, noise, outlines[number])) is not None
    ]
    positions, _ = locate_positions(matches, {pair.frame_index: pair for pair in logged}, rig, PositionParams())
    drive = Drive(
        drive_id="drawn", source_path="drawn", rig=rig, map_srid=32632, content_sha256="0" * 64, frame_pairs=tuple(logged),
        expected_frame_count=frames,
    )  # fmt: skip
    return NoisyDrive(drive, [_truth(number, cone) for number, cone in enumerate(cones)], matches, positions, [])


def draw_drive(
    rng: np.random.Generator, rig: Rig, cones: Sequence[Cone], errors: PoseErrors, **options: Any
) -> NoisyDrive:
    """One drive through positions and tracks, which know that the log has no error from frame to frame but what is common."""
    drawn = draw_positions(rng, rig, cones, errors, **options)
    found = [detection for match in drawn.matches for detection in (match.left, match.right)]
    pairs = drawn.drive.frame_pairs
    tracks, _ = fuse_logged(pairs, rig, found, drawn.matches, drawn.positions, motion=EXACT_MOTION)
    return replace(drawn, tracks=tracks)


#: Of a trajectory whose errors are all common.
EXACT_MOTION = MotionError(lambda _start, _end, _point_m: np.zeros((3, 3)), most_m2=lambda _range_m: 0.0)


def _truth(number: int, cone: Cone) -> TruthCone:
    x, y, z = np.add(ORIGIN_M, cone.foot_m).tolist()
    return TruthCone(cone_id=f"C{number}", xyz_m=(x, y, z), cone_height_m=cone.height_m)


def _logged(
    rng: np.random.Generator, pairs: Sequence[FramePair], errors: PoseErrors, stated_share: float
) -> list[FramePair]:
    """The log: common and per-frame errors of place and attitude, with the sigmas of both stated as one."""
    up = np.array([1.0, 1.0, 1.5])
    shift, turn = rng.normal(0, errors.common_m * up), rng.normal(0, errors.common_rad, 3)
    sigma_m = stated_share * np.hypot(errors.common_m, errors.per_frame_m) * up
    sigma_rad = stated_share * float(np.hypot(errors.common_rad, errors.per_frame_rad))
    logged = []
    for pair in pairs:
        place = pair.pose.map_t_body_m + shift + rng.normal(0, errors.per_frame_m * up)
        angles = turn + rng.normal(0, errors.per_frame_rad, 3)
        true = Rotation.from_matrix(pair.pose.map_R_body).as_euler("ZYX")
        matrix = Rotation.from_euler("ZYX", true + angles[::-1]).as_matrix().tolist()
        rotation: Matrix3 = tuple(tuple(row) for row in matrix)
        x, y, z = place.tolist()
        a, b, c = sigma_m.tolist()
        pose = pair.pose.model_copy(
            update={
                "map_R_body": rotation, "map_t_body_m": (x, y, z), "sigma_enu_m": (a, b, c),
                "sigma_rpy_rad": (sigma_rad, sigma_rad, sigma_rad),
            }
        )  # fmt: skip
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
    x, y, w, h = box
    return Detection(
        frame_index=pair.frame_index, side=side, detection_index=number, x_px=x, y_px=y, w_px=w, h_px=h, score=0.9
    )
