"""`conetl detect` and `conetl locate`: cones and other road objects in images, and in one stereo pair without a trajectory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from conetl.cli import console as ui
from conetl.files.atomic import atomic_text_file
from conetl.model.detector_evidence import calibrated_probability
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.model.feature_classes import known_classes
from conetl.model.params import DetectionParams, IngestParams
from conetl.perception.detector import detect_image, load_detector
from conetl.perception.images import ImageFileError, read_upright_image
from conetl.perception.model_card import ModelCard
from conetl.pipeline.settings import read_settings
from conetl.reports.camera_images import write_annotated_image

if TYPE_CHECKING:
    from conetl.tracking.pair_calibration import PairCalibration
    from conetl.tracking.positions import CameraPosition

#: Boxes of this score and more are used for the map.
USED_SCORE = DetectionParams().score_threshold
_SUFFIXES = {".jpg", ".jpeg", ".png"}
_FIELDS = (
    "ground_distance_m", "object_height_m", "ground_distance_sigma_m", "xyz_m", "centre_xyz_m", "centre_height_m",
    "residual_rms_px", "score",
)  # fmt: skip
_COLUMNS: ui.Columns = {
    "object": lambda item: item[0],
    "category": lambda item: item[1].category,
    "ground distance m": lambda item: item[1].ground_distance_m,
    "sigma m": lambda item: item[1].ground_distance_sigma_m,
    "height m": lambda item: item[1].object_height_m,
    "right m": lambda item: item[1].xyz_m[0],
    "down m": lambda item: item[1].xyz_m[1],
    "ahead m": lambda item: item[1].xyz_m[2],
    "score": lambda item: f"{item[1].score:.2f}",
}


def detect(
    images: Annotated[list[Path], typer.Argument(help="Images, or folders of images (.jpg, .jpeg, .png).")],
    output: Annotated[Path, typer.Option("--out", help="File to write.")] = Path("detections.json"),
    score: Annotated[float, typer.Option(min=0.0, max=1.0, help="Lowest score to write.")] = 0.05,
    draw: Annotated[
        Path | None,
        typer.Option(help=f"Folder for annotated copies of the images: boxes from score {USED_SCORE}, feet, tips."),
    ] = None,
    category: ui.ClassesOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Detect cones and all other classes of the model in images, and write the boxes as JSON.

    Each box has file_name, category, bbox (x, y, w, h), score of the network, probability (of cones, if the model is
    calibrated), foot and tip (x, y), in pixels of the displayed image (after its orientation tag). Exit code 1: some images could
    not be read (the boxes of the others are written anyway).
    """
    paths = _image_files(images)
    drawn_names = _drawn_names(paths) if draw is not None else []
    settings = read_settings()
    detector = load_detector(settings.model_path, providers=settings.onnx_providers)
    detector.card.require_categories(category or ())
    found: list[dict[str, Any]] = []
    usable = 0
    refused: list[str] = []
    # Opened first, so that a path that cannot be written fails before the detection.
    with atomic_text_file(output) as file, ui.progress_bar("detect", "images") as update:
        for number, path in enumerate(paths):
            update(number, len(paths))
            try:
                image = read_upright_image(path)
            except ImageFileError as error:
                refused.append(str(path))
                ui.complain(InputError(str(error)))
                continue
            boxes = detect_image(detector, image, score_threshold=score, single_image=True, categories=category or None)
            found += [_entry(path, box, detector.card) for box in boxes]
            usable += int((boxes[:, 4] >= USED_SCORE).sum())
            if draw is not None:
                shown = boxes[boxes[:, 4] >= max(score, USED_SCORE)]
                write_annotated_image(draw / drawn_names[number], image, shown, detector.card.class_names)
        if len(refused) == len(paths):
            raise InputError("none of the images could be read; nothing was written")
        file.write(json.dumps(found, indent=1) + "\n")
    facts = {
        "images": len(paths),
        "refused": refused,
        "detections": len(found),
        "of_map_score": usable,
        "written": str(output),
    }
    read = ui.counted(len(paths) - len(refused), "image")
    text = (
        f"{ui.counted(len(found), 'detection')} in {read}, {usable} with a score of at least {USED_SCORE} -> {output}"
    )
    ui.answer(as_json, facts, text)
    if draw is not None and not as_json:
        ui.say(f"annotated images -> {draw}")
    if refused:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def _entry(path: Path, box: NDArray[np.float64], card: ModelCard) -> dict[str, Any]:
    category = card.class_names[int(box[9])]
    entry: dict[str, Any] = {
        "file_name": str(path),
        "category": category,
        "bbox": [round(value, 2) for value in box[:4].tolist()],
        "score": round(float(box[4]), 4),
    }
    if card.evidence is not None and category == "traffic_cone":  # measured of cones
        entry["probability"] = round(calibrated_probability(card.evidence.calibration, float(box[4])), 4)
    if np.isfinite(box[5:9]).all():  # NaN if the network has no such outputs
        entry["foot"] = [round(value, 2) for value in box[5:7].tolist()]
        entry["tip"] = [round(value, 2) for value in box[7:9].tolist()]
    return entry


def _drawn_names(paths: list[Path]) -> list[str]:
    """A file name for each annotated copy; a number distinguishes images of the same name."""
    names: dict[str, None] = {}
    for path in paths:
        name, count = f"{path.stem}.jpg", 2
        while name in names:
            name, count = f"{path.stem}_{count}.jpg", count + 1
        names[name] = None
    return list(names)


def _image_files(arguments: list[Path]) -> list[Path]:
    paths: list[Path] = []
    for argument in arguments:
        if argument.is_dir():
            paths += sorted(p for p in argument.rglob("*") if p.suffix.lower() in _SUFFIXES)
        elif argument.is_file():
            paths.append(argument)
        else:
            raise InputError(f"{argument}: no such file or folder")
    if not paths:
        raise InputError(f"no images (.jpg, .jpeg, .png) in {', '.join(str(a) for a in arguments)}")
    return paths


def locate(
    left: Annotated[Path, typer.Argument(help="Left image.")],
    right: Annotated[Path, typer.Argument(help="Right image.")],
    calibration: Annotated[
        Path,
        typer.Option(help="rig.yaml, or a calibration of KITTI, OpenCV, Kalibr, ROS or MATLAB, or a folder with one."),
    ],
    as_json: ui.JsonOption = False,
) -> None:
    """Compute the ground distance and height of each cone and other object in one stereo pair.

    Requires neither a trajectory nor a map. For signs and boards, distance and height are those of the plate.
    """
    from conetl.pipeline.one_pair import locate_pair  # here: `detect` needs none of it, and it takes a while to load
    from conetl.readers.drives.pairs import first_size
    from conetl.readers.rigs import read_rig_for_images

    rig = read_rig_for_images(calibration, first_size([left]))
    settings = read_settings()
    detector = load_detector(settings.model_path, providers=settings.onnx_providers)
    params = IngestParams(detection=DetectionParams(categories=known_classes(detector.card.class_names)))
    try:
        found = locate_pair((left, right), rig, detector, params)
    except ImageFileError as error:
        raise InputError(str(error)) from error
    if as_json:
        misfits = [
            {"category": c.category, "ground_distance_m": c.ground_distance_m, "object_height_m": c.object_height_m}
            for c in found.misfits
        ]
        ui.print_json(
            {
                "cones": [_row(cone) for cone in found.cones],
                "objects": [{"category": one.category, **_row(one)} for one in found.objects],
                "without_partner": found.unmatched,
                "no_cones_by_height": misfits,
                "rejections": found.rejections,
                "calibration": _calibration(found.calibration),
            }
        )
        return
    ui.say(f"Calibration: {found.calibration.detail}.")
    count_left, count_right = map(len, found.detections)
    located = [*found.cones, *found.objects]
    cones = f", {ui.counted(len(found.cones), 'cone')} among them" if found.objects else ""
    ui.say(f"{ui.counted(count_left, 'object')} detected left, {count_right} right, {len(located)} located{cones}.")
    if any(found.unmatched.values()):
        ui.say(f"Boxes without a stereo match: {found.unmatched['left']} left, {found.unmatched['right']} right.")
        if not found.matches:
            ui.say("Possible causes: swapped images, images already rectified, or the calibration of another rig.")
    ui.print_records("", _COLUMNS, enumerate(located, 1))
    for misfit in found.misfits:
        size = f"{misfit.object_height_m:.2f} m high at {misfit.ground_distance_m:.1f} m"
        ui.say(f"not used: {misfit.category.replace('_', ' ')} {size}: implausible height")
    for rejection in found.rejections:
        ui.say(f"not used: {rejection.record.partition(' of ')[0].rstrip(' 0123456789')}: {rejection.detail}")


def _row(one: CameraPosition) -> dict[str, Any]:
    return {name: getattr(one, name) for name in _FIELDS}


def _calibration(found: PairCalibration) -> dict[str, Any]:
    """What the pair shows of its calibration: row offsets of the right image (px) in the middle and at its right side."""
    seen = found.offsets
    return {
        "detail": found.detail,
        "has_stated_errors": found.stated,
        "points": 0 if seen is None else seen.points,
        "rows_px": None if seen is None else [seen.rows_px[0], seen.rows_px.sum()],
        "least_disparity_px": None if seen is None else seen.farthest_px,
    }
