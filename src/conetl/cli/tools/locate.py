"""`conetl locate`: one stereo pair without a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from conetl.cli.console import JsonOption, out, print_json, print_table
from conetl.geometry.rig import up_in_left_camera
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.model.records import Side
from conetl.perception.detections import check_boxes
from conetl.perception.detector import detect_image, load_detector
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.pipeline.settings import read_settings
from conetl.readers.drives.pairs import first_size
from conetl.readers.rigs import read_rig_for_images
from conetl.tracking.matching.matches import match_pair
from conetl.tracking.positions import locate_in_camera


def locate(
    left: Annotated[Path, typer.Argument(help="Left image, as the calibration describes it.")],
    right: Annotated[Path, typer.Argument(help="Right image.")],
    calibration: Annotated[
        Path,
        typer.Option(help="rig.yaml, or a calibration of KITTI, OpenCV, Kalibr, ROS or MATLAB, or a folder with one."),
    ],
    as_json: JsonOption = False,
) -> None:
    """Ground distance and height of each cone in one stereo pair: no trajectory, no map."""
    rig = read_rig_for_images(calibration, first_size([left]))
    params = IngestParams()
    detector = load_detector(read_settings().model_path)
    images, detections = [], []
    sides: tuple[tuple[Path, Side], ...] = ((left, "left"), (right, "right"))
    for path, side in sides:
        try:
            image = read_rig_image(path, rig, side)
        except ImageFileError as error:
            raise InputError(str(error)) from error
        boxes = detect_image(
            detector, image, score_threshold=params.detection.score_threshold, nms_iou=params.detection.nms_iou
        )
        found, _ = check_boxes(boxes, frame_index=0, side=side, params=params.detection)
        images.append(image)
        detections.append(found)
    matches, refused = match_pair(
        detections[0], detections[1], rig, params.match, up_left=up_in_left_camera(rig), images=(images[0], images[1])
    )
    located, more = locate_in_camera(matches, rig, params.position)
    # One pair has no second look to tell a cone from a sign; its height at least must be a cone's, as in a drive.
    lowest_m, highest_m = params.track.min_cone_height_m, params.track.max_cone_height_m
    cones = [cone for cone in located if lowest_m <= cone.cone_height_m <= highest_m]
    misfits = [cone for cone in located if cone not in cones]
    rows: list[dict[str, Any]] = [
        {
            "ground_distance_m": cone.ground_distance_m,
            "height_m": cone.cone_height_m,
            "ground_distance_sigma_m": cone.ground_distance_sigma_m,
            "xyz_m": list(cone.xyz_m),
            "centre_xyz_m": list(cone.centre_xyz_m),
            "centre_height_m": cone.centre_height_m,
            "residual_rms_px": cone.residual_rms_px,
            "score": cone.score,
        }
        for cone in cones
    ]
    rows.sort(key=lambda row: row["ground_distance_m"])
    alone = [
        len(found) - len(matches) - sum(r.payload.get("side") == side for r in refused)
        for found, side in zip(detections, ("left", "right"), strict=True)
    ]
    if as_json:
        print_json(
            {
                "cones": rows,
                "without_partner": dict(zip(("left", "right"), alone, strict=True)),
                "no_cones_by_height": [
                    {"ground_distance_m": cone.ground_distance_m, "height_m": cone.cone_height_m} for cone in misfits
                ],
                "rejections": [r.model_dump(mode="json") for r in (*refused, *more)],
            }
        )
        return
    out.print(f"{len(detections[0])} cones detected left, {len(detections[1])} right, {len(rows)} located.")
    if any(alone):
        out.print(f"Boxes without a partner in the other image: {alone[0]} left, {alone[1]} right.")
        if not matches:
            out.print("Are the two images swapped, or rectified already, or is the calibration another rig's?")
    columns = ("cone", "ground distance m", "sigma m", "height m", "right m", "down m", "ahead m", "score")
    print_table("", columns, [_cells(number, row) for number, row in enumerate(rows, 1)])
    for cone in misfits:
        out.print(
            f"not used: something {cone.cone_height_m:.2f} m high at {cone.ground_distance_m:.1f} m: "
            f"cones are {lowest_m} to {highest_m} m high",
            markup=False,
        )
    for rejection in (*refused, *more):
        out.print(f"not used: {rejection.record.removesuffix(' of frame pair 0')}: {rejection.detail}", markup=False)


def _cells(number: int, row: dict[str, Any]) -> tuple[object, ...]:
    x, y, z = row["xyz_m"]
    numbers = (row["ground_distance_m"], row["ground_distance_sigma_m"], row["height_m"], x, y, z)
    return (number, *(f"{value:.3f}" for value in numbers), f"{row['score']:.2f}")
