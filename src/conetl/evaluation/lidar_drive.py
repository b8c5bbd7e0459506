"""Stereo positions of a drive's cones against its own LiDAR, pair by pair."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.evaluation import lidar_check as steps
from conetl.evaluation.lidar_check import SceneBias, fit_scene_bias, scene_samples
from conetl.geometry import pose as se3
from conetl.geometry.packing import cov_matrix
from conetl.model.arrays import Floats
from conetl.model.drive import FramePair, StereoMatch
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.model.rig import Rig
from conetl.perception.detector import Detector, load_detector
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_pair_image
from conetl.pipeline.odometry import calibrate_drive
from conetl.pipeline.one_pair import first_road_rows, images_of, map_up_in_left, match_searched, search_pair
from conetl.readers.drives import read_drive
from conetl.readers.drives.velodyne import (
    ScanFileError,
    left_SE3_velo,
    list_scans,
    points_at_exposure,
    read_scan,
    scan_period_s,
)
from conetl.tracking.matching.cone_outline import find_outline
from conetl.tracking.positions import locate_positions
from conetl.tracking.self_calibration import SWITCHED_OFF, self_calibrated_rig


class LidarCheck(NamedTuple):
    """Result of `lidar_residuals`."""

    residuals: list[steps.LidarResidual]
    """Residuals of every refined match with LiDAR points, with the calibration as it is."""
    corrected: list[steps.LidarResidual]
    """The same without the calibration error that the scene shows; empty without `scene`."""
    scene: SceneBias | None
    scan_count: int
    calibration: str
    """Result of the self-calibration, in one sentence."""
    problems: list[str]
    """Scans and images that could not be used, one sentence each."""


def lidar_residuals(
    drive_folder: Path,
    *,
    model_path: Path | None,
    self_calibrate: bool,
    progress: Callable[[int, int], None],
) -> LidarCheck:
    """Stereo minus LiDAR for the cones of a drive, one frame pair at a time.

    self_calibrate: from the images alone; without it the calibration is used as delivered. progress: called with (scans done,
    scans in total). Raises InputError if the drive has no LiDAR, no calibration of it, or cannot be read.
    """
    params = IngestParams()
    drive, _ = read_drive(drive_folder)
    scans = list_scans(drive_folder)
    if not scans:
        raise InputError(f"{drive_folder}: no LiDAR scans; expected velodyne_points/data/0000000000.bin and so on")
    calibration = calibrate_drive(drive, params.trajectory) if self_calibrate else SWITCHED_OFF
    rig = self_calibrated_rig(drive.rig, calibration, params.trajectory)
    velo, period_s = left_SE3_velo(rig, drive_folder), scan_period_s(drive_folder)
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    detector = load_detector(model_path)
    residuals: list[steps.LidarResidual] = []
    matches: list[StereoMatch] = []
    samples: list[Floats] = []
    problems: list[str] = []
    for done, (number, path) in enumerate(scans.items(), 1):
        pair = pairs.get(number)
        if pair is None:
            problems.append(f"scan {path.name}: there is no usable frame pair {number}")
        else:
            try:
                scan = points_at_exposure(read_scan(path)[:, :3].astype(np.float64), pair, pairs, rig, velo, period_s)
                found, used, seen = _check_pair(se3.apply(velo, scan), pair, rig, detector, params)
            except (ScanFileError, ImageFileError) as error:
                problems.append(str(error))
            else:
                residuals, matches, samples = [*residuals, *found], [*matches, *used], [*samples, seen]
        progress(done, len(scans))
    scene = fit_scene_bias(np.concatenate(samples), rig) if samples else None
    corrected = (
        [steps.without_scene_bias(r, m, rig, scene) for r, m in zip(residuals, matches, strict=True)] if scene else []
    )
    return LidarCheck(residuals, corrected, scene, len(scans), calibration.detail, problems)


def _check_pair(
    points_left: Floats, pair: FramePair, rig: Rig, detector: Detector, params: IngestParams
) -> tuple[list[steps.LidarResidual], list[StereoMatch], Floats]:
    """Residuals of one pair with their matches, and its samples of the scene; points_left (N, 3) in the left camera's frame."""
    rows, up = first_road_rows([pair], rig, params.detection), map_up_in_left(pair, rig)
    searched = search_pair(
        pair.frame_index, lambda side: read_pair_image(pair, side, rig), lambda _: detector, rig, params, rows
    )
    left, right = images_of(searched)
    matches, _ = match_searched(searched, rig, params.match, up)
    by_index = {match.match_index: match for match in matches if match.refined}
    positions, _ = locate_positions(matches, [pair], rig, params.position)
    residuals, used = [], []
    lowest_m, highest_m = params.track.min_cone_height_m, params.track.max_cone_height_m
    for position in positions:
        match = by_index.get(position.match_index)
        if match is None or match.left is None or not lowest_m <= position.object_height_m <= highest_m:
            continue
        lidar = steps.lidar_range(points_left, find_outline(left, match.left), rig.left, up)
        if lidar is not None:
            foot, cov = np.array(position.camera_xyz_m), cov_matrix(position.camera_cov_m2)
            residuals.append(steps.residual(match, foot, cov, rig, lidar, up))
            used.append(match)
    return (
        residuals,
        used,
        scene_samples(points_left, left, right, rig, searched["left"].detections, seed=pair.frame_index),
    )
