"""One stereo pair of images: detection, matching and, without a trajectory, positions in the camera's frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from conetl.geometry.camera import first_road_row
from conetl.geometry.rig import camera_of, map_SE3_camera, map_SE3_left, up_in_left_camera
from conetl.model.arrays import Image
from conetl.model.drive import Detection, FramePair, StereoMatch
from conetl.model.feature_classes import CONE
from conetl.model.params import DetectionParams, IngestParams
from conetl.model.rejections import Rejection
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.detections import to_detections
from conetl.perception.detector import Detector, detect_image
from conetl.perception.rectified_image import read_rig_image
from conetl.tracking.matching.matches import match_pair
from conetl.tracking.positions import CameraPosition, locate_in_camera


def search_image(
    path: Path,
    rig: Rig,
    side: Side,
    detector: Detector,
    params: DetectionParams,
    pair: FramePair | None,
) -> tuple[Image, list[Detection]]:
    """One image and the objects in it. pair: with its pose, the area above the horizon is skipped. Raises ImageFileError."""
    image = read_rig_image(path, rig, side)
    first_row = 0
    if pair is not None:
        map_R_cam = map_SE3_camera(pair.pose, rig, side)[:3, :3]
        first_row = first_road_row(camera_of(rig, side), [map_R_cam], params.searched_margin_rad)
    boxes = detect_image(
        detector, image, score_threshold=params.score_threshold, nms_iou=params.nms_iou, first_row=first_row,
        single_image=pair is None, categories=params.categories,
    )  # fmt: skip
    frame_index, names = 0 if pair is None else pair.frame_index, detector.card.class_names
    return image, to_detections(boxes, frame_index=frame_index, side=side, params=params, categories=names)[0]


class LocatedPair(NamedTuple):
    """Cones and other objects of one pair without a trajectory."""

    detections: list[list[Detection]]
    matches: list[StereoMatch]
    cones: list[CameraPosition]
    """By distance."""
    objects: list[CameraPosition]
    """What is not a cone, by distance."""
    misfits: list[CameraPosition]
    """Objects whose height is not that of their category."""
    unmatched: dict[Side, int]
    rejections: list[Rejection]


def match_images(
    paths: tuple[Path, Path], rig: Rig, detector: Detector, params: IngestParams, pair: FramePair | None = None
) -> tuple[list[tuple[Image, list[Detection]]], list[StereoMatch], list[Rejection]]:
    """Detect cones in both images and match them: each image with its detections, the matches, and rejections of matching.

    pair: with its pose, the area above the horizon is skipped. Raises ImageFileError.
    """
    sides = zip(SIDES, paths, strict=True)
    found = [search_image(path, rig, side, detector, params.detection, pair) for side, path in sides]
    return found, *match_searched(found, rig, params, pair)


def match_searched(
    found: Sequence[tuple[Image, list[Detection]]], rig: Rig, params: IngestParams, pair: FramePair | None
) -> tuple[list[StereoMatch], list[Rejection]]:
    """Match what `search_image` found in the left and the right image of a pair."""
    (left_image, left), (right_image, right) = found
    up = up_in_left_camera(rig) if pair is None else map_SE3_left(pair.pose, rig)[2, :3]
    return match_pair(left, right, rig, params.match, up_left=up, images=(left_image, right_image))


def locate_pair(paths: tuple[Path, Path], rig: Rig, detector: Detector, params: IngestParams) -> LocatedPair:
    """Objects of one stereo pair in the frame of the left camera. Raises ImageFileError."""
    searched, matches, rejected = match_images(paths, rig, detector, params)
    detections = [found for _, found in searched]
    located, more = locate_in_camera(matches, rig, params.position)
    located.sort(key=lambda one: one.ground_distance_m)
    # No second pair distinguishes a cone from a sign, but its height must be that of a cone, as in a drive.
    limits_m = [params.track.heights_m(one.category) for one in located]
    fits = [one for one, (least, most) in zip(located, limits_m, strict=True) if least <= one.object_height_m <= most]
    unmatched = {
        side: len(found) - len(matches) - sum(r.payload.get("side") == side for r in rejected)
        for side, found in zip(SIDES, detections, strict=True)
    }
    cones, objects = ([one for one in fits if (one.category == CONE) == is_cone] for is_cone in (True, False))
    misfits = [one for one in located if one not in fits]
    return LocatedPair(detections, matches, cones, objects, misfits, unmatched, [*rejected, *more])
