"""`conetl lidar-check`: what stereo says about cones, less what the drive's own LiDAR says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray

from conetl.cli.console import JsonOption, out, print_json, print_table, progress_bar
from conetl.evaluation import lidar_check as steps
from conetl.evaluation.lidar_scene import SceneBias, fit_scene_bias, scene_samples
from conetl.geometry import pose as se3
from conetl.geometry.camera import first_road_row
from conetl.geometry.packing import cov_matrix
from conetl.geometry.rig import camera_of, map_SE3_camera, map_SE3_left
from conetl.model.errors import InputError
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.model.records import Drive, FramePair, Rig, Side, StereoMatch
from conetl.perception.detections import check_boxes
from conetl.perception.detector import Detector, detect_image, load_detector
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.pipeline.settings import read_settings
from conetl.readers.drives import read_drive
from conetl.readers.drives.velodyne import (
    ScanFileError,
    left_SE3_velo,
    list_scans,
    points_at_exposure,
    read_scan,
    scan_period_s,
)
from conetl.readers.rigs import IMU_TO_VELO
from conetl.tracking.matching.cone_outline import find_outline
from conetl.tracking.matching.matches import match_pair
from conetl.tracking.positions import locate_positions
from conetl.tracking.self_calibration import SWITCHED_OFF, SelfCalibration, self_calibrated_rig

Array = NDArray[np.float64]


class LidarCheck(NamedTuple):
    """Result of `lidar_residuals`."""

    residuals: list[steps.LidarResidual]
    """Of every refined match that LiDAR says something about, with the calibration as it is."""
    corrected: list[steps.LidarResidual]
    """The same without what the scene says about calibration; empty where the scene says nothing."""
    scene: SceneBias | None
    scan_count: int
    calibration: str
    """What the drive itself says of the rig's calibration, in one sentence."""
    problems: list[str]
    """Scans and pictures that could not be used, one sentence each."""


def lidar_residuals(
    drive_folder: Path,
    *,
    model_path: Path | None = None,
    params: IngestParams | None = None,
    calibrate: Callable[[Drive, TrajectoryParams], SelfCalibration] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> LidarCheck:
    """Stereo less LiDAR for the cones of a drive, one frame pair at a time.

    calibrate: asked what the drive says of its own rig; without it the calibration is taken as delivered. LiDAR has no part in
    it. progress: called with (scans done, scans in all). Raises InputError where the drive has no LiDAR, no calibration of it, or
    cannot be read.
    """
    params = params or IngestParams()
    drive, _ = read_drive(drive_folder)
    scans = list_scans(drive_folder)
    if not scans:
        raise InputError(f"{drive_folder}: no LiDAR scans; expected velodyne_points/data/0000000000.bin and so on")
    folders = [f for f in (drive_folder, drive_folder.resolve().parent) if (f / IMU_TO_VELO).is_file()]
    if not folders:
        raise InputError(f"{drive_folder}: {IMU_TO_VELO} is neither in the drive folder nor in its parent")
    calibration = calibrate(drive, params.trajectory) if calibrate else SWITCHED_OFF
    drive = drive.model_copy(update={"rig": self_calibrated_rig(drive.rig, calibration, params.trajectory)})
    velo = left_SE3_velo(drive.rig, folders[0])
    period_s = scan_period_s(drive_folder)
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    detector = load_detector(model_path)
    residuals: list[steps.LidarResidual] = []
    matches: list[StereoMatch] = []
    samples: list[Array] = []
    problems: list[str] = []
    for done, (number, path) in enumerate(scans.items(), 1):
        pair = pairs.get(number)
        if pair is None:
            problems.append(f"scan {path.name}: there is no usable frame pair {number}")
        else:
            try:
                points = se3.apply(velo, _points(path, pair, pairs, drive.rig, velo, period_s))
                found, used, seen = _check_pair(points, pair, drive.rig, detector, params)
            except (ScanFileError, ImageFileError) as error:
                problems.append(str(error))
            else:
                residuals, matches, samples = [*residuals, *found], [*matches, *used], [*samples, seen]
        if progress is not None:
            progress(done, len(scans))
    scene = fit_scene_bias(np.concatenate(samples), drive.rig) if samples else None
    corrected = (
        [steps.without_scene_bias(r, m, drive.rig, scene) for r, m in zip(residuals, matches, strict=True)]
        if scene
        else []
    )
    return LidarCheck(residuals, corrected, scene, len(scans), calibration.detail, problems)


def _points(
    path: Path, pair: FramePair, pairs: Mapping[int, FramePair], rig: Rig, velo: Array, period_s: float
) -> Array:
    """Points (N, 3) of one scan as at the instant of the picture, in the scanner's frame."""
    return points_at_exposure(read_scan(path)[:, :3].astype(np.float64), pair, pairs, rig, velo, period_s)


def _check_pair(
    points_left: Array, pair: FramePair, rig: Rig, detector: Detector, params: IngestParams
) -> tuple[list[steps.LidarResidual], list[StereoMatch], Array]:
    """Residuals of one pair with their matches, and its samples of the scene."""
    images, detections = [], []
    sides: tuple[Side, Side] = ("left", "right")
    for side in sides:
        image = read_rig_image(Path(pair.left_path if side == "left" else pair.right_path), rig, side)
        boxes = detect_image(
            detector, image, score_threshold=params.detection.score_threshold, nms_iou=params.detection.nms_iou,
            first_row=first_road_row(
                camera_of(rig, side), [map_SE3_camera(pair.pose, rig, side)[:3, :3]], params.detection.horizon_margin_rad
            ),
        )  # fmt: skip
        found, _ = check_boxes(boxes, frame_index=pair.frame_index, side=side, params=params.detection)
        images.append(image)
        detections.append(found)
    up = map_SE3_left(pair.pose, rig)[2, :3]
    matches, _ = match_pair(detections[0], detections[1], rig, params.match, up_left=up, images=(images[0], images[1]))
    by_index = {match.match_index: match for match in matches if match.refined}
    positions, _ = locate_positions(matches, {pair.frame_index: pair}, rig, params.position)
    residuals, used = [], []
    lowest_m, highest_m = params.track.min_cone_height_m, params.track.max_cone_height_m
    for position in positions:
        match = by_index.get(position.match_index)
        if match is None or not lowest_m <= position.cone_height_m <= highest_m:
            continue
        lidar = steps.lidar_range(points_left, find_outline(images[0], match.left), rig.left, up)
        if lidar is not None:
            foot, cov = np.array(position.camera_xyz_m), cov_matrix(position.camera_cov_m2)
            residuals.append(steps.residual(match, foot, cov, lidar, up))
            used.append(match)
    return residuals, used, scene_samples(points_left, images[0], images[1], rig, detections[0], seed=pair.frame_index)


def lidar_check(
    drive: Annotated[Path, typer.Argument(help="Drive folder in KITTI's layout with velodyne_points.")],
    self_calibrate: Annotated[
        bool, typer.Option(help="Correct the rig's calibration first where the drive's own pictures contradict it.")
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Stereo ranges of cones against the drive's own LiDAR, by range, with and without what the scene says of calibration."""
    from conetl.pipeline.odometry import calibrate_drive

    with progress_bar() as bar:
        task = bar.add_task("LiDAR check", total=None)
        check = lidar_residuals(
            drive, model_path=read_settings().model_path, calibrate=calibrate_drive if self_calibrate else None,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    bands, corrected = steps.summarise(check.residuals), steps.summarise(check.corrected)
    if as_json:
        scene = check.scene
        print_json(
            {
                "scan_count": check.scan_count,
                "calibration": check.calibration,
                "bands": [band._asdict() for band in bands],
                "bands_without_scene_bias": [band._asdict() for band in corrected] if scene else None,
                "scene": None
                if scene is None
                else {
                    "coefficients_px": scene.coefficients.tolist(), "range_offset_m": scene.range_offset_m,
                    "sample_count": scene.sample_count, "scatter_px": scene.scatter_px,
                },
                "residuals": [residual._asdict() for residual in check.residuals],
                "problems": check.problems,
            }
        )  # fmt: skip
        return
    out.print(f"{check.scan_count} scans, {len(check.residuals)} refined matches that LiDAR says something about.")
    out.print(f"Calibration: {check.calibration}.")
    columns = ("range m", "matches", "median m", "median |m|", "robust std m", "std of residual / sigma")
    print_table("Stereo less LiDAR", columns, [_cells(band) for band in bands])
    if check.scene is not None:
        out.print(
            f"The scene without cones ({check.scene.sample_count} windows): things lie {check.scene.range_offset_m:+.3f} m "
            f"farther than LiDAR says, and disparities are {float(check.scene.coefficients[0]):+.2f} px off in the centre."
        )
        print_table("Without what the scene says of calibration", columns, [_cells(band) for band in corrected])
    for problem in check.problems:
        out.print(f"not used: {problem}", markup=False)


def _cells(band: steps.RangeBand) -> tuple[Any, ...]:
    figures = (band.median_m, band.median_abs_m, band.robust_std_m, band.ratio_std)
    return (f"{band.from_m:g}-{band.to_m:g}", band.pairs, *("-" if x is None else f"{x:.3f}" for x in figures))
