"""One recording must not count as two surveys, whatever its settings, files or name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from conetl.db.connection import transaction
from conetl.db.map.commit import path_wkt
from conetl.db.map.drive_store import ConcurrentDrive, drives_at_the_same_time, drives_with_boxes, read_frame_pairs
from conetl.db.map.replay_store import other_deliveries
from conetl.geometry import pose as se3
from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.rig import body_SE3_camera
from conetl.mapping.association import near_pairs
from conetl.model.arrays import Floats
from conetl.model.drive import Drive, DriveRecords, FramePair
from conetl.model.errors import MapMismatchError
from conetl.model.rig import Rig
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.settings import Settings

#: Larger than what another lever arm, GNSS solution or clock start changes.
_SAME_CAMERA_M, _SAME_CAMERA_RAD = 2.0, 0.5
#: Two recordings never have the same intervals between all their images; texts of time stamps may be rounded.
_SAME_STAMP_NS = 2_000_000
#: The adjusted poses of a drive are within this, plus their stated sigmas, of its log. No vehicle repeats a drive this exactly,
#: frame by frame, nor to `_MOST_LOG_M`; too few frames, or frames of a waiting vehicle, prove nothing.
_SAME_LOG_M, _SAME_LOG_RAD, _LEAST_PAIRS, _LEAST_PATH_M = 0.1, np.radians(0.1), 8, 5.0
_MOST_LOG_M, _MOST_LOG_RAD = 0.5, np.radians(0.5)
#: On paths shorter than this many tolerances, two drives in one lane at similar speeds with a regular trigger may agree as well.
_TOLERANCES = 45.0
#: Minimum shares of the shorter recording's frames, and of the frames in the time common to both, that must be in the other one.
#: A vehicle that moves less than `_MOVING_M` between two frames is waiting.
_LEAST_SHARE, _LEAST_COMMON_SHARE, _MOVING_M = 0.5, 0.9, 0.05

#: Boxes of one object in an image and its copy agree within `_SAME_PX`, although another log may be off by `_MOVED_LOG_M`;
#: `_PROBES` evenly spaced images of a drive are compared.
_SAME_PX, _MOVED_LOG_M, _PROBES = 2.0, 5.0, 16
_OTHERWISE = (
    "other settings, files or time stamps: the left camera was at the same positions at the same times, or in these frames (or "
    "some of them) with time stamps shifted by a constant"
)


def refuse_other_delivery(drive: Drive, settings: Settings, database: MapDatabase) -> None:
    """Raise MapMismatchError where the recording is on the map with other content: one drive would count as two surveys."""
    with database.connection() as conn, transaction(conn, "The map cannot be read"):
        numbers = other_deliveries(
            conn, drive.drive_id, drive.captured_ns, drive.content_sha256, map_name=settings.map_name
        )
        then = drives_at_the_same_time(conn, drive, path_wkt(drive), _SAME_STAMP_NS, map_name=settings.map_name)
        same = [one for one in then if _is_same_recording(drive, one, read_frame_pairs(conn, one.drive_uuid))]
    if numbers:
        raise _on_the_map(drive, drive.drive_id, numbers[-1], "other content", settings.map_name)
    if same:
        other = same[-1]
        how = "other time stamps" if other.drive_id == drive.drive_id else _OTHERWISE
        raise _on_the_map(drive, other.drive_id, other.changeset_no, how, settings.map_name)


def refuse_same_images(records: DriveRecords, settings: Settings, database: MapDatabase) -> None:
    """Raise MapMismatchError if the images of a drive are already on the map, with any log, time stamps and compression.

    No vehicle sees objects again in the same pixels, image by image; recompressing an image moves boxes only slightly.
    """
    drive = records.drive
    if len(drive.frame_pairs) < _LEAST_PAIRS:
        return
    moving = set(_moving(drive.frame_pairs, drive.rig)[0].tolist())
    at = {pair.frame_index: pair for pair in drive.frame_pairs if pair.captured_at_ns in moving}
    seen = sorted({box.frame_index for box in records.detections if box.side == "left"} & at.keys())
    if len(seen) < _LEAST_PAIRS:
        return
    chosen = set(evenly_spaced(seen, _PROBES))
    boxes = [
        (at[box.frame_index].captured_at_ns, *at[box.frame_index].pose.map_t_body_m[:2], box.x_px, box.y_px, box.w_px, box.h_px)
        for box in records.detections
        if box.side == "left" and box.frame_index in chosen
    ]  # fmt: skip
    with database.connection() as conn, transaction(conn, "The map cannot be read"):
        same = drives_with_boxes(
            conn, drive, boxes, map_name=settings.map_name, within_m=_MOVED_LOG_M, same_px=_SAME_PX, same_ns=_SAME_STAMP_NS,
            least_images=_LEAST_PAIRS, least_share=_LEAST_SHARE,
        )  # fmt: skip
    if same:
        how = "another log: its images show the same objects in the same pixels"
        raise _on_the_map(drive, same[-1].drive_id, same[-1].changeset_no, how, settings.map_name)


def _on_the_map(drive: Drive, drive_id: str, changeset_no: int, how: str, map_name: str) -> MapMismatchError:
    what, remedy = f"this is the recording of drive {drive_id} again (changeset {changeset_no}), with {how}", ""
    if drive_id == drive.drive_id:
        what = f"drive {drive_id} is already on the map, with {how} (changeset {changeset_no})"
        remedy = ". If it is another drive, give it a different drive_id in drive.yaml"
    return MapMismatchError(
        f"{drive.source_path}: {what}. They would count as two surveys. To replace it, revert that changeset with "
        f"`conetl map revert {changeset_no} --map {map_name}` and ingest the drive again{remedy}. Nothing was written."
    )


def _is_same_recording(drive: Drive, other: ConcurrentDrive, pairs: Sequence[FramePair]) -> bool:
    if other.is_alike:
        return is_redated(drive, other.rig, pairs, within_m=_SAME_CAMERA_M, within_rad=_SAME_CAMERA_RAD)
    return is_same_camera(drive, other.rig, pairs) or has_same_log(drive, other.rig, pairs)


def has_same_log(drive: Drive, rig: Rig, pairs: Sequence[FramePair]) -> bool:
    """Whether frame pairs, or a part of them, have the poses of a drive, and time stamps with one constant shift."""
    sigma_m = float(np.median([np.hypot(*pair.pose.sigma_enu_m[:2]) for pair in pairs]))
    sigma_rad = float(np.median([np.hypot(*pair.pose.sigma_rpy_rad[1:]) for pair in pairs]))
    within_m, within_rad = min(_SAME_LOG_M + sigma_m, _MOST_LOG_M), min(_SAME_LOG_RAD + sigma_rad, _MOST_LOG_RAD)
    return is_redated(
        drive, rig, pairs, within_m=within_m, within_rad=within_rad, uneven_m=_SAME_LOG_M,
        least_path_m=max(_LEAST_PATH_M, _TOLERANCES * within_m),
    )  # fmt: skip


def is_redated(
    drive: Drive,
    rig: Rig,
    pairs: Sequence[FramePair],
    *,
    within_m: float,
    within_rad: float,
    uneven_m: float = _SAME_CAMERA_M,
    least_path_m: float = _LEAST_PATH_M,
) -> bool:
    """Whether other frame pairs show the left camera of a drive at the same poses, with one constant time shift: another time
    zone, other leap seconds, or re-dated files; the numbers of the frames do not matter.

    `_LEAST_SHARE` of the frames of the shorter recording, at least `_LEAST_PAIRS` over `least_path_m`, must be frames of the
    other, displaced equally: to `uneven_m` (RMS).
    """
    if min(len(drive.frame_pairs), len(pairs)) < _LEAST_PAIRS:
        return False
    at_ns, here = _moving(drive.frame_pairs, drive.rig)
    times_ns, there = _moving(pairs, rig)
    i, j = near_pairs(here[:, :2, 3], there[:, :2, 3], within_m)
    alike = (here[i, :3, 2] * there[j, :3, 2]).sum(axis=1) > np.cos(within_rad)
    i, j = i[alike], j[alike]
    if not len(i):
        return False
    off_ns = at_ns[i] - times_ns[j]
    order = np.argsort(off_ns, kind="stable")
    counts = np.searchsorted(off_ns[order], off_ns[order] + _SAME_STAMP_NS, "right") - np.arange(len(order))
    first = int(np.argmax(counts))
    chosen = order[first : first + counts[first]]
    same, apart_m = i[chosen], here[i[chosen], :2, 3] - there[j[chosen], :2, 3]
    redated_ns = times_ns + off_ns[order[first]]
    common = min(_count_within(at_ns, redated_ns), _count_within(redated_ns, at_ns))
    least = max(_LEAST_PAIRS, _LEAST_SHARE * min(len(here), len(there)), _LEAST_COMMON_SHARE * common)
    path_m, scatter_m = np.hypot(*np.ptp(here[same, :2, 3], axis=0)), np.hypot(*apart_m.std(axis=0))
    return len(same) >= least and bool(path_m >= least_path_m and scatter_m <= uneven_m)


def _count_within(times_ns: NDArray[np.int64], others_ns: NDArray[np.int64]) -> int:
    """Number of times within the span of others."""
    return int(((times_ns >= others_ns[0] - _SAME_STAMP_NS) & (times_ns <= others_ns[-1] + _SAME_STAMP_NS)).sum())


def _moving(pairs: Sequence[FramePair], rig: Rig) -> tuple[NDArray[np.int64], Floats]:
    """Time stamps (N,) and poses of the left camera (N, 4, 4) of the frame pairs while the vehicle moves."""
    at_ns = np.array([pair.captured_at_ns for pair in pairs])
    poses = _left_poses(pairs, rig)
    moves = np.hypot(*np.diff(poses[:, :2, 3], axis=0, append=poses[-2:-1, :2, 3]).T) >= _MOVING_M
    return at_ns[moves], poses[moves]


def _left_poses(pairs: Sequence[FramePair], rig: Rig) -> Floats:
    """(N, 4, 4) exterior orientation of the left camera at frame pairs."""
    rotations, positions_m = zip(*((pair.pose.map_R_body, pair.pose.map_t_body_m) for pair in pairs), strict=True)
    return se3.compose(se3.se3(rotations, positions_m), body_SE3_camera(rig, "left"))


def is_same_camera(drive: Drive, rig: Rig, pairs: Sequence[FramePair]) -> bool:
    """Whether the left camera of a drive and that of other frame pairs have the same poses in most frames of their common time.

    The tolerances allow for another lever arm, GNSS solution or start of the clock. Two vehicles are farther apart; two rigs of
    one vehicle look in different directions.
    """
    if len(pairs) < 2:
        return False
    pairs = sorted(pairs, key=lambda pair: pair.captured_at_ns)
    times_ns, at_ns = (np.array([p.captured_at_ns for p in some]) for some in (pairs, drive.frame_pairs))
    both = (at_ns >= times_ns[0]) & (at_ns <= times_ns[-1])
    if not both.any():
        return False
    there, here = _left_poses(pairs, rig), _left_poses(drive.frame_pairs, drive.rig)[both]
    at_ns = at_ns[both]
    apart_m = here[:, :2, 3] - np.column_stack([np.interp(at_ns, times_ns, there[:, axis, 3]) for axis in (0, 1)])
    cosines = (here[:, :3, 2] * there[np.searchsorted(times_ns, at_ns), :3, 2]).sum(axis=1)
    near = np.median(np.linalg.norm(apart_m, axis=1)) < _SAME_CAMERA_M
    return bool(near and np.median(cosines) > np.cos(_SAME_CAMERA_RAD))
