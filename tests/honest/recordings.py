"""Recordings with images whose true poses are known, for honest logs: sample drives, rendered ones, KITTI; whole and in parts.

Poses of KITTI are those that images and its own log give together: no truth, but a path that its images show. Its short excerpts
without a log get poses by their own odometry. All images are those of an honest camera: some darker, noisier or compressed.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from conetl.evaluation.accuracy import drive_consistency
from conetl.evaluation.drive_evaluation import evaluate_drive
from conetl.evaluation.truth import TruthCone, read_truth_cones
from conetl.geometry import pose as se3
from conetl.geometry.motion.stereo_tracks import motions_of
from conetl.model.drive import Drive, FramePair
from conetl.model.errors import ConetlError
from conetl.model.params import IngestParams
from conetl.perception.visual_odometry import follow_drive
from conetl.pipeline import detect, one_pair
from conetl.pipeline.analysis import analyse
from conetl.pipeline.odometry import calibrate_drive, grey_reader
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.simulation.scenario import scenario_pass
from conetl.simulation.simulate import timestamp, write_oxts
from conetl.simulation.trajectory import SITE_MAP_M, oxts_records, true_poses
from conetl.tracking.self_calibration import self_calibrated_rig
from tests.folders import KITTI, SAMPLES, SHARED
from tests.honest.drives import rng_of
from tests.honest.logs import PARAMS, Floats, LogShape, TruePoses, logged
from tests.honest.outcomes import Outcome
from tests.honest.renders import DONE, renders
from tests.mutants.images import ImageMutant, both, changed, compressed, copy_drive

Image = NDArray[np.uint8]
_WITHIN_M = 20.0
_STEP_S = 0.1


@dataclass(frozen=True)
class Base:
    """A recording on which logs are put."""

    name: str
    drive: Drive
    poses_at: TruePoses
    """By the seconds from the first frame pair of the drive."""
    truth: tuple[TruthCone, ...] = ()
    """Empty: not known."""

    def part(self, first: int, last: int) -> Base:
        """Of frame pairs first to last - 1."""
        pairs = self.drive.frame_pairs[first:last]
        since_s = (pairs[0].captured_at_ns - self.drive.frame_pairs[0].captured_at_ns) * 1e-9
        drive = self.drive.model_copy(update={"frame_pairs": pairs, "expected_frame_count": len(pairs)})
        return Base(f"{self.name} {first}-{last}", drive, lambda seconds: self.poses_at(seconds + since_s), self.truth)


def outcome_of(seed: int, shape: LogShape, sigma_m: float, made: Callable[[], Base], settings: Settings) -> Outcome:
    """Puts a log on the recording and analyses it. made: one of `bases`. settings: with a folder in which
    results of the same images are found."""
    base = made()
    rng = rng_of(seed, shape.name, sigma_m, base.name)
    log = logged(base.drive.frame_pairs, base.poses_at, rng, shape, sigma_m)
    clock_s = log.clock_sigma_s or base.drive.clock_sigma_s
    drive = base.drive.model_copy(update={"frame_pairs": log.frame_pairs, "clock_sigma_s": clock_s})
    outcome = Outcome(shape.name, base.name, sigma_m, seed)
    try:
        with same_detections(base):
            found = analyse(drive, settings=settings)
    except ConetlError as error:
        return replace(outcome, held=f"refused: {error}")
    outcome = outcome.with_checks(found.health)
    if not base.truth or not found.tracks:
        return outcome
    tracks = evaluate_drive(base.truth, found, within_m=_WITHIN_M).tracks
    nees = drive_consistency(tracks)
    return outcome if nees is None else outcome.with_cones(tracks.difference_m, tracks.joint_cov_m2(), nees)


@contextmanager
def same_detections(base: Base) -> Iterator[None]:
    """Images are searched below the horizon of the true poses, whatever the log has: detection then runs once for all logs."""
    pairs = base.drive.frame_pairs
    true = base.poses_at(np.array([pair.captured_at_ns - pairs[0].captured_at_ns for pair in pairs]) * 1e-9)
    turned = [pair.with_pose(map_R_body=se3.to_matrix3(pose[:3, :3])) for pair, pose in zip(pairs, true, strict=True)]
    rows = one_pair.first_road_rows(turned, base.drive.rig, IngestParams().detection)
    with patch.object(detect, "first_road_rows", lambda *_: rows):
        yield


# ------------------------------------------------------------------ images of honest cameras


def vignetted(image: Image) -> Image:
    """Half as bright in the corners."""
    rows, columns = np.ogrid[-1 : 1 : image.shape[0] * 1j, -1 : 1 : image.shape[1] * 1j]
    return (image * (1.0 - 0.25 * (rows**2 + columns**2))[..., None]).astype(np.uint8)


def noisy(sigma: float, gain: float = 1.0) -> ImageMutant:
    """Noise of a sensor (grey levels) after a gain, another one in every image."""
    random = np.random.default_rng(2)
    return lambda image: np.clip(image * gain + random.normal(0, sigma, image.shape), 0, 255).astype(np.uint8)


def rained(count: int) -> ImageMutant:
    """Bright streaks, other ones in every image."""
    random = np.random.default_rng(3)

    def change(image: Image) -> Image:
        streaks = np.zeros(image.shape[:2], np.uint8)
        for x, y, long in (
            random.uniform((0, 0, 10), (image.shape[1], image.shape[0], 35), (count, 3)).astype(int).tolist()
        ):
            cv2.line(streaks, (x, y), (x + long // 6, y + long), 255, 1, cv2.LINE_AA)
        return np.clip(image + 0.25 * cv2.GaussianBlur(streaks, (0, 0), 0.7)[..., None], 0, 255).astype(np.uint8)

    return change


CAMERAS: dict[str, ImageMutant] = {
    "vignetted": vignetted, "with noise": noisy(5.0), "JPEG of 60": compressed(60), "in rain": rained(150),
    "in the dark": noisy(2.5, 0.3),
}  # fmt: skip


# ------------------------------------------------------------------ the recordings


def bases(folder: Path, settings: Settings, rendered: Path | None) -> list[Callable[[], Base]]:
    """All recordings of which there are files, each made once, when it is asked for.

    folder: an empty one, for changed images; rendered: of `renders.py`.
    """
    samples = [cache(partial(sample, number, SAMPLES[number - 1])) for number in (1, 2, 3)]
    found: list[Callable[[], Base]] = [
        *samples,
        partial(part_of, samples[0], 0, 24),
        partial(part_of, samples[2], 14, 39),
    ]
    found += [partial(with_camera, number % 3 + 1, folder, name) for number, name in enumerate(CAMERAS)]
    if rendered is not None:
        done = (name for name in renders() if (rendered / name / DONE).is_file())
        found += [partial(of_render, rendered / name, name) for name in done]
    if KITTI.is_dir():
        street = cache(partial(kitti, settings))
        found += [street, *(partial(part_of, street, first, first + 51) for first in (0, 52, 103))]
        excerpts = (("kitti_odometry_20", "image_2"), ("kitti_raw_guideposts", "image_02"))
        found += [
            partial(excerpt, SHARED / name, left, folder / name) for name, left in excerpts if (SHARED / name).is_dir()
        ]
    return [cache(one) for one in found]


def part_of(whole: Callable[[], Base], first: int, last: int) -> Base:
    return whole().part(first, last)


def with_camera(number: int, folder: Path, name: str) -> Base:
    """A sample drive with images of a worse camera."""
    path = copy_drive(SAMPLES[number - 1], folder / name)
    changed(both(CAMERAS[name]))(path)
    return sample(number, path, name)


def sample(number: int, folder: Path, change: str = "") -> Base:
    """One of the sample drives, or a copy with other images."""
    scenario, truth = scenario_pass(number), read_truth_cones(SAMPLES[number - 1] / "truth.csv")[0]
    drive = read_drive(folder)[0]
    return Base(f"drive {number} {change}".rstrip(), drive, lambda seconds: true_poses(scenario, seconds), tuple(truth))


def of_render(folder: Path, name: str) -> Base:
    return Base(name, read_drive(folder)[0], renders()[name].poses_at, tuple(read_truth_cones(folder / "truth.csv")[0]))


def kitti(settings: Settings) -> Base:
    """With the poses that its images and its log give."""
    drive = read_drive(KITTI)[0]
    refined = analyse(drive, settings=settings).drive.frame_pairs
    kept = tuple(pair for pair in drive.frame_pairs if pair.frame_index in {one.frame_index for one in refined})
    return Base("KITTI 0005", drive.model_copy(update={"frame_pairs": kept}), poses_between(refined))


def excerpt(source: Path, left: str, folder: Path) -> Base:
    """Pairs without a log: on a road by its own odometry."""
    right = f"{left[:-1]}3"
    for name, own in (("image_02", left), ("image_03", right)):
        images = source / own / "data" if (source / own / "data").is_dir() else source / own
        shutil.copytree(images, folder / name / "data")
    for name in ("cam_to_cam", "velo_to_cam", "imu_to_velo"):
        file = f"calib_{name}.txt"
        shutil.copy(source / file if (source / file).is_file() else KITTI / file, folder / file)
    times_s = np.arange(len(list((folder / "image_02" / "data").iterdir()))) * _STEP_S
    start = scenario_pass(1).start_utc
    stamps = [timestamp(start, t) for t in times_s]
    for name in ("image_02", "image_03"):
        (folder / name / "timestamps.txt").write_text("".join(f"{stamp}\n" for stamp in stamps))
    standing = np.array(SITE_MAP_M) + times_s[:, None] * [1e-3, 0, 0]
    write_oxts(folder, oxts_records(standing, np.zeros((len(times_s), 3)), times_s), stamps)
    drive = read_drive(folder)[0]
    pairs = max((driven(drive, speed) for speed in (0.0, 4.0, 8.0, 12.0)), key=lambda one: one[1])[0]
    return Base(source.name, drive.model_copy(update={"frame_pairs": pairs}), poses_between(pairs))


def driven(drive: Drive, speed_m_s: float) -> tuple[tuple[FramePair, ...], tuple[int, float]]:
    """The frame pairs with poses by odometry; how many of its motions were measured, and minus the largest change of a motion's
    length (m): from a wrong guess a motion may be wrong. speed_m_s: a guess for the first run.

    With the calibration as the images correct it: another one would make all distances longer.
    """
    first = se3.map_SE3_body(drive.frame_pairs[0].pose)
    ahead_m = first[:3, :3] @ np.array([speed_m_s * _STEP_S, 0, 0])
    poses = [first + np.pad((k * ahead_m)[:, None], ((0, 1), (3, 0))) for k in range(len(drive.frame_pairs))]
    number = 0
    for _ in range(3):
        drive = with_poses(drive, poses)
        rig = self_calibrated_rig(drive.rig, calibrate_drive(drive, PARAMS), PARAMS)
        followed = follow_drive(drive.frame_pairs, drive.rig, grey_reader(drive.rig), PARAMS)
        steps = [one.second_SE3_first for one in motions_of(followed, drive.frame_pairs, rig, PARAMS)]
        number = sum(step is not None for step in steps)
        if not number:
            break
        poses, own, last = poses[:1], np.array(rig.body_SE3_left), next(step for step in steps if step is not None)
        for step in steps:
            last = last if step is None else step
            poses.append(poses[-1] @ own @ se3.invert(np.array(last)) @ se3.invert(own))
    lengths_m = np.linalg.norm(np.diff([pose[:3, 3] for pose in poses], axis=0), axis=1)
    return with_poses(drive, poses).frame_pairs, (number, -float(np.abs(np.diff(lengths_m)).max()))


def with_poses(drive: Drive, poses: list[Floats]) -> Drive:
    pairs = (
        p.model_copy(update={"pose": se3.to_pose(x, np.ones(6))}) for p, x in zip(drive.frame_pairs, poses, strict=True)
    )
    return drive.model_copy(update={"frame_pairs": tuple(pairs)})


def poses_between(pairs: tuple[FramePair, ...]) -> TruePoses:
    """A smooth path through poses; straight on before the first and after the last one."""
    seconds = np.array([pair.captured_at_ns - pairs[0].captured_at_ns for pair in pairs]) * 1e-9
    assert all(b > a for a, b in pairwise(seconds))
    poses = np.stack([se3.map_SE3_body(pair.pose) for pair in pairs])
    places, turns = (
        CubicSpline(seconds, poses[:, :3, 3]),
        RotationSpline(seconds, Rotation.from_matrix(poses[:, :3, :3])),
    )

    def poses_at(times_s: Floats) -> Floats:
        inside = np.clip(times_s, seconds[0], seconds[-1])
        beyond = (times_s - inside)[:, None] * places(inside, 1)
        return se3.se3(turns(inside).as_matrix(), places(inside) + beyond)

    return poses_at
