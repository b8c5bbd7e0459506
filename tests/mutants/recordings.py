"""Recordings that are well-formed and wrong: changes of a drive in memory, each of which leaves valid records."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.geometry.packing import vec3
from conetl.model.drive import Drive, FramePair, Pose
from conetl.model.rig import SIDES
from conetl.readers.drives import read_drive
from tests.prepared import prepared

Mutant = Callable[[Drive], Drive]


def in_turn(*mutants: Mutant) -> Mutant:
    return lambda drive: reduce(lambda changed, change: change(changed), mutants, drive)


def with_pairs(drive: Drive, pairs: Iterable[FramePair]) -> Drive:
    return drive.model_copy(update={"frame_pairs": tuple(pairs)})


def with_poses(drive: Drive, change: Callable[[int, Pose], Any]) -> Drive:
    """change: other fields of pose k, or another pose."""
    poses = [pair.pose.model_copy(update=dict(change(k, pair.pose))) for k, pair in enumerate(drive.frame_pairs)]
    return with_pairs(
        drive, (pair.model_copy(update={"pose": p}) for pair, p in zip(drive.frame_pairs, poses, strict=True))
    )


@prepared
def displaced(drive: Drive, shift_m: Callable[[int, int], NDArray[np.float64] | tuple[float, float, float]]) -> Drive:
    """shift_m: of pose k of n."""
    count = len(drive.frame_pairs)
    return with_poses(drive, lambda k, pose: {"map_t_body_m": vec3(np.array(pose.map_t_body_m) + shift_m(k, count))})


@prepared
def farther_east(drive: Drive, degrees: float) -> Drive:
    """6 or -6 degrees: in the wrong UTM zone, with equal eastings and northings."""
    path_m = np.array([pair.pose.map_t_body_m for pair in drive.frame_pairs])
    lat, lon, height = to_geodetic(drive.map_srid, path_m).T
    shift_m = to_map(drive.map_srid, lat, lon + degrees, height) - path_m
    return displaced(lambda k, _: shift_m[k])(drive)


def jump(metres: float, first: int = 20, last: int = 10**6) -> Mutant:
    return displaced(lambda k, _: (metres * (first <= k < last), 0.0, 0.0))


@prepared
def without(drive: Drive, first: int, last: int) -> Drive:
    """Frame pairs first..last - 1 are lost."""
    return with_pairs(drive, drive.frame_pairs[:first] + drive.frame_pairs[last:])


@prepared
def paused(drive: Drive, first: int, seconds: float) -> Drive:
    """The vehicle waits so long before frame pair number `first` of those that are left."""
    later = (
        pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + round(seconds * 1e9)})
        for pair in drive.frame_pairs[first:]
    )
    return with_pairs(drive, (*drive.frame_pairs[:first], *later))


@prepared
def passed_again(drive: Drive, north_m: float, up_m: float = 0.0) -> Drive:
    """The vehicle passes the same cones again a minute later, with another error of GNSS."""
    count = len(drive.frame_pairs)
    pairs = [
        pair.model_copy(update={"frame_index": frame})
        for frame, pair in enumerate((*drive.frame_pairs, *drive.frame_pairs))
    ]
    twice = with_pairs(drive, pairs).model_copy(update={"expected_frame_count": 2 * count})
    last_ns, first_ns = (drive.frame_pairs[k].captured_at_ns for k in (-1, 0))
    return in_turn(
        displaced(lambda k, _: (0.0, north_m * (k >= count), up_m * (k >= count))),
        paused(count, 60.0 + (last_ns - first_ns) * 1e-9),
    )(twice)


def raised(metres: float, first: int = 0) -> Mutant:
    return displaced(lambda k, _: (0.0, 0.0, metres * (k >= first)))


def drift(metres: float) -> Mutant:
    return displaced(lambda k, count: (metres * k / count, 0.0, 0.0))


def climbing(metres: float) -> Mutant:
    return displaced(lambda k, count: (0.0, 0.0, metres * k / count))


def spread_jump(metres: float, first: int = 15, last: int = 25) -> Mutant:
    """A jump east that a filter spreads over these poses."""
    return displaced(lambda k, _: (metres * float(np.clip((k - first) / (last - first), 0, 1)), 0.0, 0.0))


def noise(metres: float, smoothed: float = 0.0) -> Mutant:
    """smoothed: over so many poses, as the errors of a GNSS without a fix are."""
    shifts = np.random.default_rng(1).normal(0.0, 1.0, (1000, 3))
    if smoothed:
        shifts = gaussian_filter1d(shifts, smoothed, axis=0)
    shifts *= metres / shifts.std()
    return displaced(lambda k, _: shifts[k])


@prepared
def aside(drive: Drive, metres: float) -> Drive:
    """The whole drive, to the left of its path."""
    ends = [np.array(drive.frame_pairs[k].pose.map_t_body_m) for k in (0, -1)]
    along = (ends[1] - ends[0])[:2] / np.linalg.norm((ends[1] - ends[0])[:2])
    return displaced(lambda _, __: (-metres * along[1], metres * along[0], 0.0))(drive)


@prepared
def turned_about_start(drive: Drive, degrees: float) -> Drive:
    """The whole drive about the vertical through its first pose."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    start = np.array(drive.frame_pairs[0].pose.map_t_body_m)

    def moved(_: int, pose: Pose) -> dict[str, Any]:
        position = start + turn @ (np.array(pose.map_t_body_m) - start)
        return {"map_t_body_m": vec3(position), "map_R_body": se3.to_matrix3(turn @ np.array(pose.map_R_body))}

    return with_poses(drive, moved)


@prepared
def lever_arm(drive: Drive, x_m: float, y_m: float, z_m: float) -> Drive:
    """Cameras that are mounted so far from where the calibration has them."""
    sides = {}
    for name in ("body_SE3_left", "body_SE3_right"):
        matrix = np.array(getattr(drive.rig, name))
        matrix[:3, 3] += (x_m, y_m, z_m)
        sides[name] = se3.to_matrix4(matrix)
    return drive.model_copy(update={"rig": drive.rig.model_copy(update=sides)})


@prepared
def stating(drive: Drive, sigma_m: float) -> Drive:
    """Poses with this stated sigma of each coordinate."""
    return with_poses(drive, lambda _, __: {"sigma_enu_m": (sigma_m,) * 3})


@prepared
def late(drive: Drive, records: int) -> Drive:
    """Poses that come so many records late."""
    return with_poses(drive, lambda k, _: drive.frame_pairs[max(k - records, 0)].pose)


@prepared
def repeated(drive: Drive, times: int) -> Drive:
    """Every pose so many times, as where a slower log was joined to the images."""
    return with_poses(drive, lambda k, _: drive.frame_pairs[k // times * times].pose)


@prepared
def climbing_times(drive: Drive, factor: float) -> Drive:
    """Heights in another unit, or of the other sign, about that of the first pose."""
    start_m = drive.frame_pairs[0].pose.map_t_body_m[2]

    def changed(_: int, pose: Pose) -> dict[str, Any]:
        east_m, north_m, up_m = pose.map_t_body_m
        return {"map_t_body_m": (east_m, north_m, start_m + factor * (up_m - start_m))}

    return with_poses(drive, changed)


@prepared
def clock(drive: Drive, milliseconds: float) -> Drive:
    """Poses of another instant than the images."""
    return with_poses(drive, lambda k, _: pose_at(drive, drive.frame_pairs[k].captured_at_ns + milliseconds * 1e6))


@prepared
def clock_known_to(drive: Drive, seconds: float) -> Drive:
    """A recording whose reader estimated the beginning of its images, with this sigma."""
    return drive.model_copy(update={"clock_sigma_s": seconds})


def pose_at(drive: Drive, at_ns: float) -> Pose:
    """The pose between, or beyond, the logged ones."""
    times = np.array([pair.captured_at_ns for pair in drive.frame_pairs], dtype=np.float64)
    k = int(np.clip(np.searchsorted(times, at_ns) - 1, 0, len(times) - 2))
    share = (at_ns - times[k]) / (times[k + 1] - times[k])
    first, second = (se3.map_SE3_body(drive.frame_pairs[i].pose) for i in (k, k + 1))
    turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).as_rotvec()
    rotation = first[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    place = (1 - share) * first[:3, 3] + share * second[:3, 3]
    return drive.frame_pairs[k].pose.model_copy(
        update={"map_R_body": se3.to_matrix3(rotation), "map_t_body_m": vec3(place)}
    )


def reversed_poses(drive: Drive) -> Drive:
    return with_poses(drive, lambda k, _: drive.frame_pairs[len(drive.frame_pairs) - 1 - k].pose)


@prepared
def frozen_place(drive: Drive, first: float = 0.0) -> Drive:
    """Positions, but not attitudes, stay what they are at this share of the drive."""
    places = [pair.pose.map_t_body_m for pair in drive.frame_pairs]
    return with_poses(drive, lambda k, _: {"map_t_body_m": places[min(k, int(first * len(places)))]})


@prepared
def turned(drive: Drive, roll_deg: float, pitch_deg: float, yaw_deg: float, first: int = 0) -> Drive:
    """From pose `first` on."""
    turn = Rotation.from_euler("xyz", (roll_deg, pitch_deg, yaw_deg), degrees=True).as_matrix()
    return with_poses(
        drive, lambda k, pose: {"map_R_body": se3.to_matrix3(np.array(pose.map_R_body) @ turn)} if k >= first else {}
    )


@prepared
def right_late(drive: Drive, frames: int, first: int = 0, last: int = 10**6) -> Drive:
    """Right images of so many frames before, from this pair on, up to `last`: the left camera lost frames, or the right one
    repeated some."""
    pairs = drive.frame_pairs
    moved = (
        pair.model_copy(update=images_in(old, "right"))
        for pair, old in zip(pairs[first + frames : last], pairs[first:], strict=False)
    )
    return with_pairs(drive, (*pairs[:first], *moved, *pairs[last:]))


@prepared
def images_shifted(drive: Drive, frames: int, first: int) -> Drive:
    """Both images are those of so many frames later from this pair on (earlier, if negative): cameras lost or repeated some."""
    pairs = drive.frame_pairs
    moved = (
        pairs[k].model_copy(update=images_in(pairs[k + frames])) for k in range(first, len(pairs) - max(frames, 0))
    )
    return with_pairs(drive, (*pairs[: first + min(frames, 0)], *moved))


@prepared
def images_of(drive: Drive, folder: Path, first: int, last: int) -> Drive:
    """Both images of these pairs are those of another recording, whose vehicle moved alike."""
    other = read_drive(folder)[0].frame_pairs
    moved = (
        pair.model_copy(update=images_in(other[k])) for k, pair in enumerate(drive.frame_pairs[:last]) if k >= first
    )
    return with_pairs(drive, (*drive.frame_pairs[:first], *moved, *drive.frame_pairs[last:]))


def images_in(pair: FramePair, *sides: str) -> dict[str, Any]:
    """Paths and hashes of both images, or of one side."""
    return {name: getattr(pair, name) for side in sides or SIDES for name in (f"{side}_path", f"{side}_sha256")}


@prepared
def baseline(drive: Drive, factor: float) -> Drive:
    """A calibration whose baseline is so many times the true one."""
    left, right = np.array(drive.rig.body_SE3_left), np.array(drive.rig.body_SE3_right)
    right[:3, 3] = left[:3, 3] + factor * (right[:3, 3] - left[:3, 3])
    return drive.model_copy(update={"rig": drive.rig.model_copy(update={"body_SE3_right": se3.to_matrix4(right)})})


@prepared
def right_ahead(drive: Drive, metres: float) -> Drive:
    """Images of a right camera that stands so much farther forward than the calibration has it, as one that exposes late does."""
    right = np.array(drive.rig.body_SE3_right)
    right[:3, 3] -= metres * right[:3, 2]
    return drive.model_copy(update={"rig": drive.rig.model_copy(update={"body_SE3_right": se3.to_matrix4(right)})})


@prepared
def lenses(
    drive: Drive, focal: float = 1.0, right_column_px: float = 0.0, columns_px: float = 0.0, rows_px: float = 0.0
) -> Drive:
    """A calibration with so many times the focal length and other principal points: of the right camera, and of both."""
    sides = {}
    for name, own_px in (("left", 0.0), ("right", right_column_px)):
        camera = getattr(drive.rig, name)
        sides[name] = camera.model_copy(update={
            "fx_px": focal * camera.fx_px, "fy_px": focal * camera.fy_px,
            "cx_px": camera.cx_px + columns_px + own_px, "cy_px": camera.cy_px + rows_px,
        })  # fmt: skip
    return drive.model_copy(update={"rig": drive.rig.model_copy(update=sides)})
