"""What `conetl inspect` and `conetl calibrate` show: a drive's path and one image pair; a calibration, corners and residuals."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from conetl.files.atomic import atomic_text_file
from conetl.geometry.calibration import tables
from conetl.geometry.calibration.stereo_bundle import BoardView, Bundle, residuals_px
from conetl.geometry.calibration.stereo_calibration import StereoCalibration
from conetl.model.arrays import Image
from conetl.model.drive import Drive
from conetl.model.rejections import Rejection
from conetl.model.rig import SIDES, Rig
from conetl.perception.boards.images import ImagePair
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.perception.video import frame_of
from conetl.readers.drives.summary import DriveSummary
from conetl.reports.figures import ORANGE, add_grid, new_figure, png, save_figure

_ROWS = 12


def draw_drive(drive: Drive, summary: DriveSummary) -> bytes:
    """A drive as it was read (PNG): its path, coloured by the sigma of its poses, and one pair of images with rows across."""
    figure = new_figure(14, 7.5, dpi=110)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.25))
    _draw_drive_path(figure.add_subplot(grid[:, 0]), drive, summary)
    frame_index, images = _middle_pair(drive)
    for row, side in enumerate(SIDES):
        axes = figure.add_subplot(grid[row, 1])
        axes.set_axis_off()
        if not images:
            axes.text(0.5, 0.5, "no image pair is readable", ha="center")
            continue
        axes.imshow(cv2.cvtColor(images[row], cv2.COLOR_BGR2RGB), interpolation="antialiased")
        for v in np.linspace(0, len(images[row]) - 1, _ROWS + 2)[1:-1]:
            axes.axhline(v, color="#ffe000", linewidth=0.6, alpha=0.8)
        axes.set_title(f"{side}, frame pair {frame_index}: lines cross the same objects in both images", fontsize=9)
    return png(figure)


def draw_coverage(path: Path, bundle: Bundle, views: Sequence[BoardView], title: str) -> Path:
    """Write the corners of a calibration in both images with their residuals as enlarged arrows (PNG). Returns the path."""
    figure = new_figure(13, 7.2, dpi=110)
    panels = figure.subplots(1, 2)
    typical_px = float(np.median(np.concatenate([np.hypot(*residuals_px(bundle, v).T) for v in views])))
    for axes, side, camera in zip(panels, SIDES, (bundle.left, bundle.right), strict=True):
        own = [v for v in views if v.side == side]
        uv = np.concatenate([v.uv_px for v in own])
        residuals = np.concatenate([residuals_px(bundle, v) for v in own])
        # The median arrow is 1.5 % of the image's width.
        enlarge = 0.015 * camera.width_px / max(typical_px, 1e-9)
        arrows = axes.quiver(
            uv[:, 0], uv[:, 1], residuals[:, 0] * enlarge, residuals[:, 1] * enlarge, np.hypot(*residuals.T),
            angles="xy", scale_units="xy", scale=1.0, width=0.0016, cmap="viridis", clim=(0.0, 3.0 * typical_px),
        )  # fmt: skip
        axes.plot([camera.cx_px], [camera.cy_px], "+", color=ORANGE, markersize=14, label="principal point")
        axes.set_xlim(-0.5, camera.width_px - 0.5)
        axes.set_ylim(camera.height_px - 0.5, -0.5)
        axes.set_aspect("equal")
        add_grid(axes)
        axes.set_title(f"{side}: {len(own)} images, {len(uv)} corners, arrows x {enlarge:.0f}")
        axes.set_xlabel("u (px)")
        axes.set_ylabel("v (px)")
        axes.legend(loc="lower right", fontsize=8)
    figure.colorbar(arrows, ax=panels, shrink=0.8, label="length of the residual (px)")
    figure.suptitle(title)
    return save_figure(figure, path)


def _draw_drive_path(axes: Axes, drive: Drive, summary: DriveSummary) -> None:
    positions = np.array([pair.pose.map_t_body_m[:2] for pair in drive.frame_pairs])
    origin = positions[0]
    local = positions - origin
    number = {pair.frame_index: i for i, pair in enumerate(drive.frame_pairs)}
    sigma_m = np.array([max(pair.pose.sigma_enu_m[:2]) for pair in drive.frame_pairs])
    axes.plot(local[:, 0], local[:, 1], color="#bbbbbb", linewidth=1, zorder=1)
    for i, gap in enumerate(summary.gaps):
        ends = local[[number[gap.after_frame], number[gap.before_frame]]]
        label = "gap in time or space" if i == 0 else None
        axes.plot(ends[:, 0], ends[:, 1], color=ORANGE, linewidth=2.5, linestyle="--", zorder=2, label=label)
        axes.annotate(
            f"{gap.seconds:.1f} s, {gap.metres:.0f} m", ends.mean(axis=0), fontsize=7, color=ORANGE,
            xytext=(6, 6), textcoords="offset points",
        )  # fmt: skip
    points = axes.scatter(
        local[:, 0],
        local[:, 1],
        c=sigma_m,
        s=14,
        cmap="viridis",
        vmin=0.0,
        vmax=max(float(sigma_m.max()), 1e-3),
        zorder=3,
    )
    if summary.poses.jumps:
        jumps = local[[number[jump.frame] for jump in summary.poses.jumps]]
        axes.scatter(jumps[:, 0], jumps[:, 1], marker="x", s=60, color=ORANGE, zorder=4, label="jump")
    axes.plot(
        local[0, 0], local[0, 1], marker="^", color="black", markersize=9, linestyle="none", label="start", zorder=5
    )
    middle = (local.max(axis=0) + local.min(axis=0)) / 2
    half = max(0.55 * float(np.ptp(local, axis=0).max()), 2.0)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    add_grid(axes)
    axes.set_xlabel(f"easting - {origin[0]:.1f} (m)")
    axes.set_ylabel(f"northing - {origin[1]:.1f} (m)")
    axes.legend(loc="best", fontsize=8)
    axes.figure.colorbar(
        points, ax=axes, shrink=0.6, label="horizontal sigma of the pose (m)", location="bottom", ticks=MaxNLocator(4)
    )


def _middle_pair(drive: Drive) -> tuple[int, list[Image]]:
    """Frame index and images of the readable pair nearest to the middle (of a bag only the first is unpacked), [] without one."""
    pairs = drive.frame_pairs
    for i in sorted(range(len(pairs)), key=lambda i: abs(i - len(pairs) // 2)):
        files = [Path(pairs[i].left_path), Path(pairs[i].right_path)]
        try:
            if all((frame.path if (frame := frame_of(file)) else file).is_file() for file in files):
                return pairs[i].frame_index, [
                    read_rig_image(f, drive.rig, s) for f, s in zip(files, SIDES, strict=True)
                ]
        except ImageFileError:
            continue
    return 0, []


def calibration_as_dict(
    rig: Rig,
    result: StereoCalibration,
    pairs: list[ImagePair],
    rejections: list[Rejection],
    sensor_mm: tuple[float, float] | None,
) -> dict[str, Any]:
    """Everything that `conetl calibrate` reports. sensor_mm: width and height, for values in millimetres."""
    bundle, views = result.bundle, result.views
    errors = tables.epipolar_errors_px(rig, views)
    both = set(result.stereo_pairs)

    def rows(values: list[tables.Value]) -> list[dict[str, Any]]:
        return [value._asdict() for value in values]

    content: dict[str, Any] = {
        "rig_id": rig.rig_id,
        "pairs": len(pairs),
        "pairs_used": len(both),
        "constancy_checked": result.is_constancy_checked,
        "pictures_used": {side: sum(v.side == side for v in views) for side in SIDES},
        "lens": bundle.lens_model,
        "board_shape": result.board_shape,
        "board_deviation_mm": {
            axis: float(1e3 * np.abs(bundle.board_points_m() - bundle.points_m)[:, i].max())
            for i, axis in enumerate("xyz")
        },
        "rms_px": {
            "stereo": tables.rms_px(bundle, [v for v in views if v.pair_index in both]),
            **{side: tables.rms_px(bundle, [v for v in views if v.side == side]) for side in SIDES},
        },
        "sigma_px": result.variance_factor_px2**0.5,
        "degrees_of_freedom": result.degrees_of_freedom,
        "design_effect": result.covariance.design_effect,
        "epipolar_error_px": {
            "rms": float(np.sqrt((errors**2).mean())),
            "percentile_95": float(np.percentile(np.abs(errors), 95)),
        },
        "coverage": {side: tables.coverage(rig, views, side) for side in SIDES},
        "interior_px": {side: rows(tables.interior_in_pixels(rig, side)) for side in SIDES},
        "relative": rows(tables.relative_orientation(rig)),
        "candidates": [c._asdict() for c in result.candidates],
        "residuals": [
            {
                "pair": pairs[v.pair_index].name,
                "side": v.side,
                "corners": len(v.point_ids),
                "rms_px": tables.rms_px(bundle, [v]),
            }
            for v in views
        ],
        "rejected_corners": [
            {
                "pair": pairs[c.pair_index].name,
                "side": c.side,
                "point": c.point_id,
                "uv_px": c.uv_px,
                "residual_px": c.residual_px,
            }
            for c in result.rejected_corners
        ],
        "rejections": [r.model_dump(mode="json") for r in rejections],
    }
    if sensor_mm is not None:
        content["interior_mm"] = {side: rows(tables.interior_in_millimetres(rig, side, sensor_mm)) for side in SIDES}
    return content


def write_calibration_report(folder: Path, content: dict[str, Any], result: StereoCalibration) -> None:
    """Write coverage.png and report.json, and add both to content["written"]."""
    title = f"{content['rig_id']}: {len(result.stereo_pairs)} pairs, RMS {content['rms_px']['stereo']:.3f} px"
    image = draw_coverage(folder / "coverage.png", result.bundle, result.views, title)
    content["written"] += [str(image), str(folder / "report.json")]
    with atomic_text_file(folder / "report.json") as file:
        json.dump(content, file, indent=1)
