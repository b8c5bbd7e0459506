"""The result of a camera calibration as JSON values, and its report folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.atomic import atomic_text_file
from conetl.geometry.calibration import tables
from conetl.geometry.calibration.stereo_calibration import StereoCalibration
from conetl.model.records import SIDES, Rig
from conetl.model.rejections import Rejection
from conetl.perception.boards.images import ImagePair


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
        return [{"name": v.name, "value": v.value, "sigma": v.sigma, "unit": v.unit} for v in values]

    content: dict[str, Any] = {
        "rig_id": rig.rig_id,
        "pairs": len(pairs),
        "pairs_used": len(both),
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
        "candidates": [vars(c) for c in result.candidates],
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
    from conetl.reports.inspection_images import draw_coverage  # matplotlib takes half a second to load

    title = f"{content['rig_id']}: {len(result.stereo_pairs)} pairs, RMS {content['rms_px']['stereo']:.3f} px"
    image = draw_coverage(folder / "coverage.png", result.bundle, result.views, title)
    content["written"] += [str(image), str(folder / "report.json")]
    with atomic_text_file(folder / "report.json") as file:
        json.dump(content, file, indent=1)
