"""`conetl rig`: show the calibration of a rig, or convert it to the format of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from scipy.spatial.transform import Rotation

from conetl.cli.console import JsonOption, answer, parse_size, print_json, print_table, say
from conetl.files.documents import input_errors
from conetl.geometry import rig as rigs
from conetl.geometry.rectification import is_rectified, rectify
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Rig, Side
from conetl.readers.rigs import FORMAT_NAMES, RIG_YAML, WRITERS, read_rig_and_format

SizeOption = Annotated[
    str | None,
    typer.Option(
        "--image-size", help="Image size like 1242x375, if the file has none (OpenCV, KITTI odometry) or several (ZED)."
    ),
]
UnitOption = Annotated[
    str | None,
    typer.Option("--unit", help="Unit of the lengths in the file, if not that of its format: m, cm, mm, in, ft."),
]
PairOption = Annotated[
    str | None,
    typer.Option("--pair", help="Names of the left and right camera, if the file has more than two: LEFT,RIGHT."),
]
_DECIMALS = {"_px": 3, "_rad": 6, "_m": 5}


def show(
    file: Annotated[Path, typer.Argument(help="Calibration file of a supported format, or a folder with one.")],
    image_size: SizeOption = None,
    unit: UnitOption = None,
    pair: PairOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show interior and exterior orientation, with sigmas if the file contains them."""
    rig, found = read_rig_and_format(
        file, image_size=_size("--image-size", image_size), length_unit=unit, pair=_pair(pair)
    )
    if as_json:
        rectified = is_rectified(rig)
        print_json({"format": found, "rectified": rectified, "baseline_m": rig.baseline_m, "rig": rig})
        return
    say(f"{file}: {FORMAT_NAMES[found]}, rig {rig.rig_id}")
    covariance = rig.calibration_covariance
    sigmas = {} if covariance is None else covariance.sigmas
    interior: list[tuple[str, ...]] = [
        ("image size", f"{rig.left.width_px} x {rig.left.height_px}", f"{rig.right.width_px} x {rig.right.height_px}")
    ]
    interior += [
        (name, *(_cell(getattr(rigs.camera_of(rig, side), name), sigmas, f"{side}.{name}") for side in SIDES))
        for name in ("fx_px", "fy_px", "cx_px", "cy_px")
    ]
    interior.append(("lens", rig.left.lens.model, rig.right.lens.model))
    for i in range(max(len(rig.left.lens.coefficients), len(rig.right.lens.coefficients))):
        interior.append((f"lens.{i}", *(_coefficient(rig, side, i, sigmas) for side in SIDES)))
    print_table("Interior orientation", ("parameter", "left", "right"), interior)
    print_table("Exterior orientation", ("parameter", "value"), _exterior(rig, sigmas))
    say(_usage(rig))


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Calibration file, or a folder with one.")],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="File to write; for ROS the folder of left.yaml and right.yaml.")
    ],
    to: Annotated[
        str | None,
        typer.Option(help=f"opencv (.yml, .xml, .json), ros or rig; default for {RIG_YAML}: rig."),
    ] = None,
    image_size: SizeOption = None,
    unit: UnitOption = None,
    pair: PairOption = None,
    scale_to: Annotated[
        str | None,
        typer.Option(help="Size of your images like 640x400, if they were scaled down after the calibration."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Convert a calibration to the format of another tool."""
    if to is None:
        if target.name != RIG_YAML:
            raise InputError(f"{target}: choose the format with --to: {', '.join(WRITERS)}")
        to = "rig"
    if to not in WRITERS:
        raise InputError(f"--to {to}: known formats are {', '.join(WRITERS)}")
    size = _size("--scale-to", scale_to)
    rig, found = read_rig_and_format(
        source, image_size=_size("--image-size", image_size), length_unit=unit, pair=_pair(pair)
    )
    if size is not None:
        with input_errors(f"--scale-to {scale_to}: {source}"):
            rig = rigs.resized(rig, *size)
    WRITERS[to](rig, target)
    lost = _lost(rig, to)
    name = {str(kind): name for kind, name in FORMAT_NAMES.items()}[to]
    text = f"{source}: {FORMAT_NAMES[found]} -> {target}: {name}"
    if lost:
        text += f"\n{name} cannot store {' and '.join(lost)}"
    answer(as_json, {"read_as": found, "written": str(target), "format": to, "not_written": lost}, text)


def _lost(rig: Rig, to: str) -> list[str]:
    """What the other format cannot store."""
    if to == "rig":
        return []
    body = [] if rigs.body_is_left_camera(rig) else ["the position of the cameras on the body (body_SE3_left)"]
    covariance = [] if rig.calibration_covariance is None else ["the covariance of the calibration"]
    return [*body, *covariance]


def _cell(value: float, sigmas: dict[str, float], name: str) -> str:
    places = next((count for ending, count in _DECIMALS.items() if name.endswith(ending)), 6)
    sigma = sigmas.get(name)
    return f"{value:.{places}f}" + ("" if sigma is None else f" ± {sigma:.{places}f}")


def _coefficient(rig: Rig, side: Side, index: int, sigmas: dict[str, float]) -> str:
    known = rigs.camera_of(rig, side).lens.coefficients
    return _cell(known[index], sigmas, f"{side}.lens.{index}") if index < len(known) else ""


def _exterior(rig: Rig, sigmas: dict[str, float]) -> list[tuple[str, str]]:
    relative = rigs.left_SE3_right(rig)
    rotation = np.degrees(Rotation.from_matrix(relative[:3, :3]).as_rotvec())
    rows = [("baseline", f"{rig.baseline_m:.5f} m")]
    rows += [
        (f"right camera {axis}", f"{_cell(value, sigmas, f'relative.t{axis}_m')} m")
        for axis, value in zip("xyz", relative[:3, 3].tolist(), strict=True)
    ]
    for axis, value in zip("xyz", rotation.tolist(), strict=True):
        sigma = sigmas.get(f"relative.r{axis}_rad")
        shown = "" if sigma is None else f" ± {np.degrees(sigma):.4f}"
        rows.append((f"right camera rotation about {axis}", f"{value:.4f}{shown} deg"))
    if not rigs.body_is_left_camera(rig):
        body = rigs.body_SE3_camera(rig, "left")
        rows.append(("left camera on the body", ", ".join(f"{v:.4f}" for v in body[:3, 3]) + " m"))
    return rows


def _usage(rig: Rig) -> str:
    if is_rectified(rig):
        return "The images are rectified (no lens distortion, parallel cameras, equal rows) and used as they are."
    try:
        flat = rectify(rig)
    except ValueError as error:
        return f"The images are raw and cannot be rectified: {error}."
    sizes = [f"{camera.width_px} x {camera.height_px}" for camera in (flat.left, flat.right)]
    return f"The images are raw; they are rectified when read, to {sizes[0]} and {sizes[1]} pixels, f {flat.left.fx_px:.1f} px."


def _size(option: str, text: str | None) -> tuple[int, int] | None:
    return parse_size(option, text, "pixels", 1, 99_999, "1242x375", number=int)


def _pair(text: str | None) -> tuple[str, str] | None:
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise InputError(f"--pair {text}: expected the names of the left and the right camera like cam0,cam2")
    return names[0], names[1]
