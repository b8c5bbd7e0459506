"""`conetl locate`: cones and other road objects of one stereo pair, without a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from conetl.cli.console import Columns, JsonOption, counted, print_json, print_records, say
from conetl.model.errors import InputError
from conetl.model.feature_classes import known_of
from conetl.model.params import DetectionParams, IngestParams
from conetl.perception.detector import load_detector
from conetl.perception.images import ImageFileError
from conetl.pipeline.one_pair import locate_pair
from conetl.pipeline.settings import read_settings
from conetl.readers.drives.pairs import first_size
from conetl.readers.rigs import read_rig_for_images
from conetl.tracking.positions import CameraPosition

_FIELDS = (
    "ground_distance_m", "cone_height_m", "ground_distance_sigma_m", "xyz_m", "centre_xyz_m", "centre_height_m",
    "residual_rms_px", "score",
)  # fmt: skip
_COLUMNS: Columns = {
    "object": lambda item: item[0],
    "category": lambda item: item[1].category,
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
    """Compute ground distance and height of each cone, and of what else the model knows, in one stereo pair.

    It needs neither trajectory nor map. Of signs and boards, distance and height are those of the plate.
    """
    rig = read_rig_for_images(calibration, first_size([left]))
    settings = read_settings()
    detector = load_detector(settings.model_path, providers=settings.onnx_providers)
    params = IngestParams(detection=DetectionParams(categories=known_of(detector.card.class_names)))
    try:
        found = locate_pair((left, right), rig, detector, params)
    except ImageFileError as error:
        raise InputError(str(error)) from error
    if as_json:
        misfits = [
            {"category": c.category, "ground_distance_m": c.ground_distance_m, "height_m": c.cone_height_m}
            for c in found.misfits
        ]
        print_json(
            {
                "cones": [_row(cone) for cone in found.cones],
                "objects": [{"category": one.category, **_row(one)} for one in found.objects],
                "without_partner": found.unmatched,
                "no_cones_by_height": misfits,
                "rejections": found.rejections,
            }
        )
        return
    count_left, count_right = map(len, found.detections)
    located = [*found.cones, *found.objects]
    cones = f", {counted(len(found.cones), 'cone')} among them" if found.objects else ""
    say(f"{counted(count_left, 'object')} detected left, {count_right} right, {len(located)} located{cones}.")
    if any(found.unmatched.values()):
        say(
            f"Boxes without a match in the other image: {found.unmatched['left']} left, {found.unmatched['right']} right."
        )
        if not found.matches:
            say("Are the images swapped, or rectified already, or does the calibration belong to another rig?")
    print_records("", _COLUMNS, enumerate(located, 1))
    for misfit in found.misfits:
        name = misfit.category.replace("_", " ")
        say(
            f"not used: {name} {misfit.cone_height_m:.2f} m high at {misfit.ground_distance_m:.1f} m: implausible height"
        )
    for rejection in found.rejections:
        say(f"not used: {rejection.record.removesuffix(' of frame pair 0')}: {rejection.detail}")


def _row(one: CameraPosition) -> dict[str, Any]:
    return {name.removeprefix("cone_"): getattr(one, name) for name in _FIELDS}
