"""`conetl lidar-check`: stereo positions of cones against the drive's own LiDAR."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from conetl.cli.console import JsonOption, print_json, print_table, progress_bar, say
from conetl.evaluation.lidar_check import ResidualBand, summarise
from conetl.evaluation.lidar_drive import lidar_residuals
from conetl.pipeline.odometry import calibrate_drive
from conetl.pipeline.settings import read_settings

_COLUMNS = ("range m", "matches", "median m", "median |m|", "robust std m", "std of residual / sigma")


def lidar_check(
    drive: Annotated[Path, typer.Argument(help="Drive folder in the KITTI layout with velodyne_points.")],
    self_calibrate: Annotated[
        bool, typer.Option(help="First correct the calibration if the images of the drive contradict it.")
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Compare stereo ranges of cones with the drive's own LiDAR, with and without the calibration error that the scene shows."""
    with progress_bar("LiDAR check", "scans") as update:
        check = lidar_residuals(
            drive,
            model_path=read_settings().model_path,
            calibrate=calibrate_drive if self_calibrate else None,
            progress=update,
        )
    scene = check.scene
    bands, corrected = summarise(check.residuals), summarise(check.corrected)
    if as_json:
        bias = scene and {
            "coefficients_px": scene.coefficients.tolist(), "range_offset_m": scene.range_offset_m,
            "sample_count": scene.sample_count, "scatter_px": scene.scatter_px,
        }  # fmt: skip
        print_json(
            {
                "scan_count": check.scan_count,
                "calibration": check.calibration,
                "bands": [band._asdict() for band in bands],
                "bands_without_scene_bias": [band._asdict() for band in corrected] if scene else None,
                "scene": bias,
                "residuals": [residual._asdict() for residual in check.residuals],
                "problems": check.problems,
            }
        )
        return
    say(f"{check.scan_count} scans, {len(check.residuals)} refined matches with LiDAR points.")
    say(f"Calibration: {check.calibration}.")
    print_table("Stereo minus LiDAR", _COLUMNS, [_cells(band) for band in bands])
    if scene is not None:
        say(
            f"Scene without cones ({scene.sample_count} windows): {scene.range_offset_m:+.3f} m beyond LiDAR, disparities "
            f"{float(scene.coefficients[0]):+.2f} px off in the centre."
        )
        print_table("Without the calibration error of the scene", _COLUMNS, [_cells(band) for band in corrected])
    for problem in check.problems:
        say(f"not used: {problem}")


def _cells(band: ResidualBand) -> tuple[Any, ...]:
    figures = (band.median_m, band.median_abs_m, band.robust_std_m, band.ratio_std)
    return (f"{band.from_m:g}-{band.to_m:g}", band.pairs, *("-" if x is None else x for x in figures))
