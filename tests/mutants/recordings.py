"""Recordings that are well-formed and wrong: changes of a drive in memory, each of which leaves valid records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.packing import vec3
from conetl.model.records import Drive, Pose
from conetl.readers.drives import read_drive

Mutant = Callable[[Drive], Drive]


def in_turn(*mutants: Mutant) -> Mutant:
    def mutant(drive: Drive) -> Drive:
        for change in mutants:
            drive = change(drive)
        return drive

    return mutant


def with_poses(drive: Drive, pose_of: Callable[[int], Pose]) -> Drive:
    pairs = tuple(pair.model_copy(update={"pose": pose_of(k)}) for k, pair in enumerate(drive.frame_pairs))
    return drive.model_copy(update={"frame_pairs": pairs})


def displaced(shift_m: Callable[[int, int], NDArray[np.float64] | tuple[float, float, float]]) -> Mutant:
    """shift_m: of pose k of n."""

    def mutant(drive: Drive) -> Drive:
        count = len(drive.frame_pairs)

        def pose_of(k: int) -> Pose:
            pose = drive.frame_pairs[k].pose
            return pose.model_copy(update={"map_t_body_m": vec3(np.array(pose.map_t_body_m) + shift_m(k, count))})

        return with_poses(drive, pose_of)

    return mutant


def jump(metres: float, first: int = 20, last: int = 10**6) -> Mutant:
    return displaced(lambda k, _: (metres * (first <= k < last), 0.0, 0.0))


def without(first: int, last: int) -> Mutant:
    """Frame pairs first..last - 1 are lost."""
    return lambda drive: drive.model_copy(
        update={"frame_pairs": (*drive.frame_pairs[:first], *drive.frame_pairs[last:])}
    )


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


def aside(metres: float) -> Mutant:
    """The whole drive, to the left of its path."""

    def mutant(drive: Drive) -> Drive:
        ends = [np.array(drive.frame_pairs[k].pose.map_t_body_m) for k in (0, -1)]
        along = (ends[1] - ends[0])[:2] / np.linalg.norm((ends[1] - ends[0])[:2])
        return displaced(lambda _, __: (-metres * along[1], metres * along[0], 0.0))(drive)

    return mutant


def turned_about_start(degrees: float) -> Mutant:
    """The whole drive about the vertical through its first pose."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()

    def mutant(drive: Drive) -> Drive:
        start = np.array(drive.frame_pairs[0].pose.map_t_body_m)

        def pose_of(k: int) -> Pose:
            pose = drive.frame_pairs[k].pose
            position = start + turn @ (np.array(pose.map_t_body_m) - start)
            rotation = se3.to_matrix3(turn @ np.array(pose.map_R_body))
            return pose.model_copy(update={"map_t_body_m": vec3(position), "map_R_body": rotation})

        return with_poses(drive, pose_of)

    return mutant


def lever_arm(x_m: float, y_m: float, z_m: float) -> Mutant:
    """Cameras that are mounted so far from where the calibration has them."""

    def mutant(drive: Drive) -> Drive:
        sides = {}
        for name in ("body_SE3_left", "body_SE3_right"):
            matrix = np.array(getattr(drive.rig, name))
            matrix[:3, 3] += (x_m, y_m, z_m)
            sides[name] = se3.to_matrix4(matrix)
        return drive.model_copy(update={"rig": drive.rig.model_copy(update=sides)})

    return mutant


def stating(sigma_m: float) -> Mutant:
    """Poses with this stated sigma of each coordinate."""

    def mutant(drive: Drive) -> Drive:
        sigma = {"sigma_enu_m": (sigma_m,) * 3}
        return with_poses(drive, lambda k: drive.frame_pairs[k].pose.model_copy(update=sigma))

    return mutant


def late(records: int) -> Mutant:
    """Poses that come so many records late."""
    return lambda drive: with_poses(drive, lambda k: drive.frame_pairs[max(k - records, 0)].pose)


def clock(milliseconds: float) -> Mutant:
    """Poses of another instant than the images."""
    return lambda drive: with_poses(
        drive, lambda k: pose_at(drive, drive.frame_pairs[k].captured_at_ns + milliseconds * 1e6)
    )


def clock_known_to(seconds: float) -> Mutant:
    """A recording whose reader estimated the beginning of its images, with this sigma."""
    return lambda drive: drive.model_copy(update={"clock_sigma_s": seconds})


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
    return with_poses(drive, lambda k: drive.frame_pairs[len(drive.frame_pairs) - 1 - k].pose)


def frozen_place(first: float = 0.0) -> Mutant:
    """Positions, but not attitudes, stay what they are at this share of the drive."""

    def mutant(drive: Drive) -> Drive:
        poses = [pair.pose for pair in drive.frame_pairs]
        start = int(first * len(poses))

        def pose_of(k: int) -> Pose:
            return poses[k].model_copy(update={"map_t_body_m": poses[min(k, start)].map_t_body_m})

        return with_poses(drive, pose_of)

    return mutant


def turned(roll_deg: float, pitch_deg: float, yaw_deg: float, first: int = 0) -> Mutant:
    """From pose `first` on."""
    turn = Rotation.from_euler("xyz", (roll_deg, pitch_deg, yaw_deg), degrees=True).as_matrix()

    def pose_of(pose: Pose) -> Pose:
        return pose.model_copy(update={"map_R_body": se3.to_matrix3(np.array(pose.map_R_body) @ turn)})

    return lambda drive: with_poses(
        drive, lambda k: pose_of(drive.frame_pairs[k].pose) if k >= first else drive.frame_pairs[k].pose
    )


def right_late(frames: int, first: int = 0) -> Mutant:
    """Right images of so many frames before, from this pair on: the left camera lost frames, or the right one repeated some."""

    def mutant(drive: Drive) -> Drive:
        pairs = drive.frame_pairs
        moved = tuple(
            pair.model_copy(update={"right_path": old.right_path, "right_sha256": old.right_sha256})
            for pair, old in zip(pairs[first + frames :], pairs[first:], strict=False)
        )
        return drive.model_copy(update={"frame_pairs": pairs[:first] + moved})

    return mutant


def images_shifted(frames: int, first: int) -> Mutant:
    """Both images are those of so many frames later from this pair on (earlier, if negative): cameras lost or repeated some."""

    def mutant(drive: Drive) -> Drive:
        pairs = drive.frame_pairs
        names = ("left_path", "right_path", "left_sha256", "right_sha256")
        moved = tuple(
            pairs[k].model_copy(update={name: getattr(pairs[k + frames], name) for name in names})
            for k in range(first, len(pairs) - max(frames, 0))
        )
        return drive.model_copy(update={"frame_pairs": pairs[: first + min(frames, 0)] + moved})

    return mutant


def images_of(folder: Path, first: int, last: int) -> Mutant:
    """Both images of these pairs are those of another recording, whose vehicle moved alike."""

    def mutant(drive: Drive) -> Drive:
        names = ("left_path", "right_path", "left_sha256", "right_sha256")
        other = read_drive(folder)[0].frame_pairs
        pairs = tuple(
            pair.model_copy(update={name: getattr(other[k], name) for name in names}) if first <= k < last else pair
            for k, pair in enumerate(drive.frame_pairs)
        )
        return drive.model_copy(update={"frame_pairs": pairs})

    return mutant


def baseline(factor: float) -> Mutant:
    """A calibration whose baseline is so many times the true one."""

    def mutant(drive: Drive) -> Drive:
        left, right = np.array(drive.rig.body_SE3_left), np.array(drive.rig.body_SE3_right)
        right[:3, 3] = left[:3, 3] + factor * (right[:3, 3] - left[:3, 3])
        rig = drive.rig.model_copy(update={"body_SE3_right": se3.to_matrix4(right)})
        return drive.model_copy(update={"rig": rig})

    return mutant


def lenses(focal: float = 1.0, right_column_px: float = 0.0, columns_px: float = 0.0, rows_px: float = 0.0) -> Mutant:
    """A calibration with so many times the focal length and other principal points: of the right camera, and of both."""

    def mutant(drive: Drive) -> Drive:
        sides = {}
        for name, own_px in (("left", 0.0), ("right", right_column_px)):
            camera = getattr(drive.rig, name)
            sides[name] = camera.model_copy(
                update={
                    "fx_px": focal * camera.fx_px, "fy_px": focal * camera.fy_px,
                    "cx_px": camera.cx_px + columns_px + own_px, "cy_px": camera.cy_px + rows_px,
                }
            )  # fmt: skip
        return drive.model_copy(update={"rig": drive.rig.model_copy(update=sides)})

    return mutant
