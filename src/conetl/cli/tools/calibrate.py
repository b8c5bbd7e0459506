"""`conetl calibrate`: pictures of a board -> rig.yaml with the covariance of everything in it."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from conetl.cli.console import JsonOption, err, out, print_json, print_table, progress_bar
from conetl.files.atomic import atomic_text_file
from conetl.geometry.calibration import tables
from conetl.geometry.calibration.board_views import BoardView
from conetl.geometry.calibration.stereo_calibration import (
    MODELS,
    BoardShape,
    CornerRejection,
    StereoCalibration,
    calibrate_stereo,
    rig_of,
)
from conetl.geometry.rectification import check_stereo_baseline
from conetl.model.errors import EXIT_TOO_MANY_REJECTIONS, CalibrationError, InputError
from conetl.model.records import LensModel, Rig
from conetl.model.rejections import Rejection, RejectionReason
from conetl.perception.boards.boards import Board, parse_board
from conetl.perception.boards.images import (
    SIDES,
    BoardImages,
    ImagePair,
    find_boards,
    pairs_by_pattern,
    pairs_even_odd,
    pairs_in_folders,
    rejection,
)  # fmt: skip
from conetl.perception.boards.start_values import start_values
from conetl.readers.rigs.rig_yaml import write_rig_yaml

#: More refused pictures than this share, and the exit code is 1.
MAX_REJECTED_SHARE = 0.25


class Pairing(StrEnum):
    FOLDERS = "folders"
    EVEN_ODD = "even-odd"


class LensChoice(StrEnum):
    AUTO = "auto"
    NONE = "none"
    RADIAL = "radial"
    BROWN = "brown"
    RATIONAL = "rational"
    FISHEYE = "fisheye"


class ShapeChoice(StrEnum):
    AUTO = "auto"
    FLAT = "flat"
    FREE = "free"


def calibrate(
    folder: Annotated[Path, typer.Argument(help="Folder of the pictures: left/ and right/ in it, or see --pairing.")],
    board: Annotated[
        str,
        typer.Option(
            help="chessboard:9x6:37.8mm (inner corners), charuco:11x8:30mm:22mm:5X5_100, aprilgrid:6x6:88mm:0.3."
        ),
    ],
    pairing: Annotated[
        Pairing, typer.Option(help="folders: left/ and right/; even-odd: even numbers are left, the next ones right.")
    ] = Pairing.FOLDERS,
    left_pattern: Annotated[str | None, typer.Option(help="Names of the left pictures, e.g. 'left_*.png'.")] = None,
    right_pattern: Annotated[str | None, typer.Option(help="Names of the right pictures, e.g. 'right_*.png'.")] = None,
    lens: Annotated[
        LensChoice, typer.Option(help="Lens model; auto takes the one of the lowest BIC.")
    ] = LensChoice.AUTO,
    board_shape: Annotated[
        ShapeChoice, typer.Option(help="flat: as drawn; free: buckles are determined as well; auto: by BIC.")
    ] = ShapeChoice.AUTO,
    square_sigma_mm: Annotated[
        float, typer.Option(min=0.0, help="Sigma of the square's (tag's) size: it scales the baseline.")
    ] = 0.0,
    sensor_mm: Annotated[
        str | None, typer.Option(help="Sensor size, e.g. 23.5x15.6, for values in millimetres.")
    ] = None,
    rig_id: Annotated[str | None, typer.Option(help="Name of the rig; default: a hash of the result.")] = None,
    output: Annotated[Path, typer.Option("--out", help="Where to write the rig.")] = Path("rig.yaml"),
    report: Annotated[Path | None, typer.Option(help="Folder for report.json and coverage.png.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate a two-camera rig from pictures of a chessboard, a ChArUco board or an AprilGrid.

    Lens model and board shape are chosen by information criterion. The standard deviations hold also where the errors of one pair
    belong together. Exit code 1 where more than a quarter of the pictures were refused; rig.yaml is written all the same.
    """
    drawn = parse_board(board)
    sensor = None if sensor_mm is None else _sensor(sensor_mm)
    pairs = _pairs(folder, pairing, left_pattern, right_pattern)
    count = sum(pair.path(side) is not None for pair in pairs for side in SIDES)
    with progress_bar() as bars:
        task = bars.add_task("find corners", total=count)
        pictures = find_boards(pairs, drawn, on_image=lambda: bars.advance(task))
    _check_found(pictures, drawn)
    try:
        result = calibrate_stereo(
            drawn.points_m(), pictures.views, start_values(drawn.points_m(), pictures.views, pictures.sizes),
            models=_models(lens),
            board_shapes=_shapes(board_shape),
        )  # fmt: skip
        check_stereo_baseline(result.bundle.left_SE3_right)
    except ValueError as error:
        raise CalibrationError(f"{folder}: {error}") from error
    name = rig_id or f"rig-{hashlib.sha256(repr(result.bundle).encode()).hexdigest()[:8]}"
    rig = rig_of(result, name, scale_sigma_relative=1e-3 * square_sigma_mm / drawn.size_m)
    misfits = [
        rejection(pairs[r.pair_index], r.side, RejectionReason.BOARD_MISFIT, r.detail) for r in result.rejected_views
    ]
    refused = [*pictures.rejections, *misfits]
    content = _report(rig, result, pairs, refused, sensor)
    write_rig_yaml(rig, output)
    content["written"] = [str(output)]
    if report is not None:
        title = f"{name}: {len(result.stereo_pairs)} pairs, RMS {content['rms_px']['stereo']:.3f} px"
        from conetl.reports.coverage_image import draw_coverage  # here: matplotlib takes half a second to load

        picture = draw_coverage(report / "coverage.png", result.bundle, result.views, title)
        content["written"] += [str(picture), str(report / "report.json")]
        with atomic_text_file(report / "report.json") as file:
            json.dump(content, file, indent=1)
    if as_json:
        print_json(content)
    else:
        _print(content, sensor is not None)
    if len(refused) > MAX_REJECTED_SHARE * 2 * len(pairs):
        raise typer.Exit(EXIT_TOO_MANY_REJECTIONS)


# --------------------------------------------------------------------------- input


def _pairs(folder: Path, pairing: Pairing, left: str | None, right: str | None) -> list[ImagePair]:
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if (left is None) != (right is None):
        raise InputError("--left-pattern and --right-pattern belong together: give both or none")
    if left is not None and right is not None:
        return pairs_by_pattern(folder, left, right)
    return pairs_even_odd(folder) if pairing == Pairing.EVEN_ODD else pairs_in_folders(folder)


def _sensor(text: str) -> tuple[float, float]:
    try:
        width, height = (float(word) for word in text.lower().split("x"))
    except ValueError:
        width = height = 0.0
    if not (0.1 < width < 200 and 0.1 < height < 200):
        raise InputError(f"--sensor-mm '{text}': expected width x height in millimetres, for example 23.5x15.6")
    return width, height


def _models(choice: LensChoice) -> tuple[LensModel, ...]:
    return MODELS if choice == LensChoice.AUTO else tuple(model for model in MODELS if model == choice.value)


def _shapes(choice: ShapeChoice) -> tuple[BoardShape, ...]:
    shapes: dict[ShapeChoice, tuple[BoardShape, ...]] = {
        ShapeChoice.AUTO: ("flat", "free"), ShapeChoice.FLAT: ("flat",), ShapeChoice.FREE: ("free",)
    }  # fmt: skip
    return shapes[choice]


def _check_found(pictures: BoardImages, board: Board) -> None:
    """Raise CalibrationError where no picture shows the board, with what most of them show instead."""
    if pictures.views:
        return
    details = Counter(r.detail for r in pictures.rejections).most_common(1)
    most = f"; most often: {details[0][0]} ({details[0][1]} pictures)" if details else ""
    raise CalibrationError(
        f"the {board.kind} of {board.cols} x {board.rows} was found in none of the pictures{most}. Check --board"
    )


# --------------------------------------------------------------------------- output


def _report(
    rig: Rig,
    result: StereoCalibration,
    pairs: list[ImagePair],
    refused: list[Rejection],
    sensor: tuple[float, float] | None,
) -> dict[str, Any]:
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
        "residuals": [_residuals(pairs[v.pair_index], v, tables.rms_px(bundle, [v])) for v in views],
        "rejected_corners": [_corner(pairs[c.pair_index], c) for c in result.rejected_corners],
        "rejections": [r.model_dump(mode="json") for r in refused],
    }
    if sensor is not None:
        content["interior_mm"] = {side: rows(tables.interior_in_millimetres(rig, side, sensor)) for side in SIDES}
    return content


def _residuals(pair: ImagePair, view: BoardView, rms: float) -> dict[str, Any]:
    return {"pair": pair.name, "side": view.side, "corners": len(view.point_ids), "rms_px": rms}


def _corner(pair: ImagePair, corner: CornerRejection) -> dict[str, Any]:
    place = {"pair": pair.name, "side": corner.side, "point": corner.point_id}
    return {**place, "uv_px": corner.uv_px, "residual_px": corner.residual_px}


def _print(content: dict[str, Any], in_millimetres: bool) -> None:
    used, rms = content["pictures_used"], content["rms_px"]
    out.print(
        f"{content['pairs_used']} of {content['pairs']} pairs ({used['left']} left and {used['right']} right pictures), lens "
        f"{content['lens']}, board {content['board_shape']}."
    )
    out.print(f"RMS left {rms['left']:.3f} px, right {rms['right']:.3f} px, stereo {rms['stereo']:.3f} px")
    epipolar = content["epipolar_error_px"]
    out.print(f"rows after rectification: RMS {epipolar['rms']:.3f} px, 95 % within {epipolar['percentile_95']:.3f} px")
    forms = [("interior_px", "Interior orientation, pixels")]
    forms = [("interior_mm", "Interior orientation, millimetres"), *forms] if in_millimetres else forms
    for key, title in forms:
        left, right = content[key]["left"], content[key]["right"]
        cells = [_two(a, b) for a, b in zip(left, right, strict=True)]
        print_table(title, ("", "unit", "left", "sigma", "right", "sigma"), cells, numbers_from=2)
    cells = [(r["name"], r["unit"], f"{r['value']:.4f}", f"{r['sigma']:.4f}") for r in content["relative"]]
    print_table("Relative orientation of the right camera", ("", "unit", "value", "sigma"), cells, numbers_from=2)
    models = [_model(c) for c in content["candidates"]]
    print_table("Models tried", ("lens", "board", "unknowns", "RMS px", "BIC"), models, numbers_from=2)
    for side, share in content["coverage"].items():
        if share < 0.5:
            err.print(f"only {100 * share:.0f} % of the {side} picture was covered: bring the board into its corners")
    for refused in content["rejections"]:
        out.print(f"not used: {refused['record']}: {refused['detail']}", markup=False)
    if content["rejected_corners"]:
        out.print(f"not used: {len(content['rejected_corners'])} single corners (report.json lists them)")
    for written in content["written"]:
        out.print(f"-> {written}", markup=False)


def _two(left: dict[str, Any], right: dict[str, Any]) -> tuple[str, ...]:
    digits = 4 if left["unit"] else 6
    numbers = (left["value"], left["sigma"], right["value"], right["sigma"])
    return (left["name"], left["unit"], *(f"{value:.{digits}f}" for value in numbers))


def _model(tried: dict[str, Any]) -> tuple[object, ...]:
    judged = ("-", tried["problem"]) if tried["bic"] is None else (f"{tried['rms_px']:.3f}", f"{tried['bic']:.1f}")
    return (tried["model"], tried["board"], tried["parameters"], *judged)
