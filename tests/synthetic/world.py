"""A road with cones, a rig that drives along it, and perfect or noisy observations: truth for the tests of the steps."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np
from numpy.typing import NDArray

from conetl.checks.verdict import judge
from conetl.geometry.calibration.covariance import with_covariance
from conetl.geometry.packing import as_rows
from conetl.mapping.history import DriveEvidence
from conetl.model.drive import Detection, Drive, FramePair, Pose, Position, StereoMatch, Track
from conetl.model.params import IngestParams, MatchParams, PositionParams, ReconcileParams
from conetl.model.rejections import Rejection
from conetl.model.rig import CalibrationCovariance, Camera, Rig, Side
from conetl.tracking.matching.matches import match_pair
from conetl.tracking.positions import locate_positions
from conetl.tracking.tracks import drive_data, fuse_tracks
from tests import records

Floats = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 1242, 375, 721.5
BASELINE_M, CAMERA_HEIGHT_M = 0.54, 1.65
ORIGIN_M = np.array([456_000.0, 5_428_000.0, 115.0])
START_NS = 1_772_445_600_000_000_000


@dataclass(frozen=True)
class Cone:
    """Foot relative to ORIGIN_M (m, east north up) and size."""

    foot_m: tuple[float, float, float]
    height_m: float = 0.7
    base_m: float = 0.38


def make_rig() -> Rig:
    camera = Camera(width_px=WIDTH_PX, height_px=HEIGHT_PX, fx_px=FOCAL_PX, fy_px=FOCAL_PX, cx_px=609.6, cy_px=172.9)

    def mount(y_m: float) -> tuple[tuple[float, float, float, float], ...]:
        # Camera x right, y down, z forward on a body with x forward, y left, z up.
        return ((0.0, 0.0, 1.0, 0.8), (-1.0, 0.0, 0.0, y_m), (0.0, -1.0, 0.0, CAMERA_HEIGHT_M), (0.0, 0.0, 0.0, 1.0))

    poses = {"body_SE3_left": mount(BASELINE_M / 2), "body_SE3_right": mount(-BASELINE_M / 2)}
    return Rig(rig_id="synthetic", left=camera, right=camera, **poses)


def calibrated(rig: Rig, sigmas: Mapping[str, float]) -> Rig:
    """The rig with a calibration of these independent sigmas."""
    matrix = as_rows(np.diag(np.square(list(sigmas.values()))))
    return with_covariance(rig, CalibrationCovariance(names=tuple(sigmas), matrix=matrix))


def drive_of(pairs: Sequence[FramePair], rig: Rig, name: str = "made") -> Drive:
    return Drive(
        drive_id=name, source_path=name, rig=rig, map_srid=32632, content_sha256="0" * 64, frame_pairs=tuple(pairs),
        expected_frame_count=len(pairs),
    )  # fmt: skip


def evidence_of(name: str, start_ns: int, tracks: Sequence[Track], path_m: Floats, **more: Any) -> DriveEvidence:
    """What a drive contributes to the map; `more`: at least what it had in view of cones."""
    content = hashlib.sha256(name.encode()).hexdigest()
    values = {"influence_m": 80.0, "params": ReconcileParams(), "judge": judge} | more
    return DriveEvidence(
        key=(start_ns, content, content), changeset_id=uuid5(NAMESPACE_URL, content), founding_key=f"default/{content}",
        tracks=tracks, path_m=path_m, **values,
    )  # fmt: skip


def make_path(
    frames: int,
    step_m: float = 1.0,
    *,
    east: bool = True,
    start_m: float = 0.0,
    sigma_m: float = 0.03,
    first_ns: int = START_NS,
) -> list[FramePair]:
    """A straight drive along the east axis (or back, `east=False`), 10 Hz."""
    sign = 1.0 if east else -1.0
    rotation = ((sign, 0.0, 0.0), (0.0, sign, 0.0), (0.0, 0.0, 1.0))
    return [
        FramePair(
            frame_index=k,
            left_path=f"{k}.jpg",
            right_path=f"{k}.jpg",
            captured_at_ns=first_ns + k * 100_000_000,
            pose=Pose(
                map_R_body=rotation,
                map_t_body_m=(ORIGIN_M[0] + start_m + sign * step_m * k, ORIGIN_M[1], ORIGIN_M[2]),
                sigma_enu_m=(sigma_m, sigma_m, 1.5 * sigma_m),
                sigma_rpy_rad=(0.0005, 0.0005, 0.0005),
            ),
        )
        for k in range(frames)
    ]


def shifted(pair: FramePair, shift_m: Sequence[float]) -> FramePair:
    """The pair with another logged position (GNSS error)."""
    x, y, z = (float(a + b) for a, b in zip(pair.pose.map_t_body_m, shift_m, strict=True))
    return pair.model_copy(update={"pose": pair.pose.model_copy(update={"map_t_body_m": (x, y, z)})})


def camera_pose(pair: FramePair, rig: Rig, side: Side) -> Floats:
    map_SE3_body = np.eye(4)
    map_SE3_body[:3, :3] = pair.pose.map_R_body
    map_SE3_body[:3, 3] = pair.pose.map_t_body_m
    return np.asarray(map_SE3_body @ np.array(rig.body_SE3_left if side == "left" else rig.body_SE3_right))


def camera_poses(pairs: Sequence[FramePair], rig: Rig, side: Side) -> dict[int, Floats]:
    return {pair.frame_index: camera_pose(pair, rig, side) for pair in pairs}


def apparent_box(cone: Cone, pair: FramePair, rig: Rig, side: Side) -> tuple[float, float, float, float] | None:
    """x, y, w, h (box edges, px) of the cone's outline: round base of `base_m`, pointed tip. None where not wholly in view."""
    camera = rig.left if side == "left" else rig.right
    pose = camera_pose(pair, rig, side)
    foot_m = np.array(cone.foot_m) + ORIGIN_M
    if not -1.0 < (foot_m - pose[:3, 3]) @ pose[:3, 2] < 33.0:  # far out of view, as most cones of a long road
        return None
    angles = np.linspace(0, 2 * np.pi, 73)
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1) * cone.base_m / 2
    points = np.vstack([rim, [[0.0, 0.0, cone.height_m]]]) + np.array(cone.foot_m) + ORIGIN_M
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    if local[:, 2].min() < 2.0 or local[:, 2].max() > 30.0:
        return None
    u = camera.cx_px + camera.fx_px * local[:, 0] / local[:, 2] + 0.5
    v = camera.cy_px + camera.fy_px * local[:, 1] / local[:, 2] + 0.5
    if u.min() < 3 or v.min() < 3 or u.max() > camera.width_px - 3 or v.max() > camera.height_px - 3:
        return None
    return float(u.min()), float(v.min()), float(np.ptp(u)), float(np.ptp(v))


def detect(
    cones: Sequence[Cone],
    pairs: Sequence[FramePair],
    rig: Rig,
    *,
    noise_px: float = 0.0,
    score: float = 0.9,
    rng: np.random.Generator | None = None,
) -> dict[tuple[int, Side], list[Detection]]:
    """Detections by frame index and side; `noise_px` is the sigma of each box edge."""
    rng = rng or np.random.default_rng(0)
    found: dict[tuple[int, Side], list[Detection]] = {}
    for pair in pairs:
        for side in ("left", "right"):
            boxes = [box for cone in cones if (box := apparent_box(cone, pair, rig, side)) is not None]
            detections = []
            for index, (x, y, w, h) in enumerate(boxes):
                left, top, right, bottom = np.array([x, y, x + w, y + h]) + rng.normal(0, noise_px, 4)
                size = right - left, bottom - top
                detections.append(
                    records.box(left, top, *size, frame=pair.frame_index, side=side, index=index, score=score)
                )
            found[pair.frame_index, side] = detections
    return found


def observe(
    cones: Sequence[Cone],
    pairs: Sequence[FramePair],
    rig: Rig,
    **noise: object,
) -> tuple[list[Detection], list[StereoMatch], list[Position]]:
    """The whole chain from boxes to positions, through the real steps; the pairs' poses are taken as true."""
    return locate(detect(cones, pairs, rig, **noise), pairs, rig)  # type: ignore[arg-type]


def locate(
    detections: dict[tuple[int, Side], list[Detection]], pairs: Sequence[FramePair], rig: Rig
) -> tuple[list[Detection], list[StereoMatch], list[Position]]:
    """Match and intersect given detections with the poses of `pairs` (which may be wrong on purpose)."""
    matches: list[StereoMatch] = []
    for pair in pairs:
        left, right = detections[pair.frame_index, "left"], detections[pair.frame_index, "right"]
        up = camera_pose(pair, rig, "left")[2, :3]
        matches += match_pair(left, right, rig, MatchParams(), up_left=up)[0]
    positions, _ = locate_positions(matches, pairs, rig, PositionParams())
    return [d for ds in detections.values() for d in ds], matches, positions


def fuse_logged(
    logged: Sequence[FramePair],
    rig: Rig,
    found: Iterable[Detection],
    matches: Iterable[StereoMatch],
    positions: Sequence[Position],
    **more: Any,
) -> tuple[list[Track], list[Rejection]]:
    """Tracks by the poses of `logged`; `more` goes to `drive_data` (params, evidence, motion)."""
    return fuse_tracks(positions, drive_data(logged, rig, found, matches, **{"params": IngestParams(), **more}))
