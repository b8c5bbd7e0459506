"""`conetl locate`: cones of one stereo pair, without a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from conetl.cli.console import Columns, JsonOption, print_json, print_records, say
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.perception.detector import load_detector
from conetl.perception.images import ImageFileError
from conetl.pipeline.one_pair import locate_pair
from conetl.pipeline.settings import read_settings
from conetl.readers.drives.pairs import first_size
from conetl.readers.rigs import read_rig_for_images

_FIELDS = (
    "ground_distance_m", "cone_height_m", "ground_distance_sigma_m", "xyz_m", "centre_xyz_m", "centre_height_m",
    "residual_rms_px", "score",
)  # fmt: skip
_COLUMNS: Columns = {
    "cone": lambda item: item[0],
    "ground distance m": lambda item: item[1].ground_distance_m,
    "sigma m": lambda item: item[1].ground_distance_sigma_m,
    "height m": lambda item: item[1].cone_height_m,
    "right m": lambda item: item[1].xyz_m[0],
    "down m": lambda item: item[1].xyz_m[1],
    "ahead m": lambda item: item[1].xyz_m[2],
    "score": lambda item: f"{item[1].score:.2f}",
}


def locate(
    left: Annotated[Path, typer.Argument(help="Left image.")],
    right: Annotated[Path, typer.Argument(help="Right image.")],
    calibration: Annotated[
        Path,
        typer.Option(help="rig.yaml, or a calibration of KITTI, OpenCV, Kalibr, ROS or MATLAB, or a folder with one."),
    ],
    as_json: JsonOption = False,
) -> None:
    """Compute ground distance and height of each cone in one stereo pair, without trajectory and map."""
    rig = read_rig_for_images(calibration, first_size([left]))
    params, settings = IngestParams(), read_settings()
    detector = load_detector(settings.model_path, providers=settings.onnx_providers)
    try:
        found = locate_pair((left, right), rig, detector, params)
    except ImageFileError as error:
        raise InputError(str(error)) from error
    if as_json:
        rows = [{name.removeprefix("cone_"): getattr(cone, name) for name in _FIELDS} for cone in found.cones]
        misfits = [{"ground_distance_m": c.ground_distance_m, "height_m": c.cone_height_m} for c in found.misfits]
        print_json(
            {
                "cones": rows,
                "without_partner": found.unmatched,
                "no_cones_by_height": misfits,
                "rejections": found.rejections,
            }
        )
        return
    count_left, count_right = map(len, found.detections)
    say(f"{count_left} cones detected left, {count_right} right, {len(found.cones)} located.")
    if any(found.unmatched.values()):
        say(
            f"Boxes without a match in the other image: {found.unmatched['left']} left, {found.unmatched['right']} right."
        )
        if not found.matches:
            say("Are the images swapped, or rectified already, or does the calibration belong to another rig?")
    print_records("", _COLUMNS, enumerate(found.cones, 1))
    for misfit in found.misfits:
        say(
            f"not used: object {misfit.cone_height_m:.2f} m high at {misfit.ground_distance_m:.1f} m: cones are "
            f"{params.track.min_cone_height_m} to {params.track.max_cone_height_m} m high"
        )
    for rejection in found.rejections:
        say(f"not used: {rejection.record.removesuffix(' of frame pair 0')}: {rejection.detail}")
