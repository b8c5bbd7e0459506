"""One frame pair, from its images to stereo matches: of a chunk, of a drive that is being recorded, or without a trajectory."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from conetl.geometry.camera import first_road_row
from conetl.geometry.rig import camera_of, map_SE3_camera, map_SE3_left, up_in_left_camera
from conetl.model.arrays import Floats, Image
from conetl.model.drive import Detection, FramePair, StereoMatch
from conetl.model.feature_classes import CONE
from conetl.model.params import DetectionParams, IngestParams, MatchParams
from conetl.model.rejections import Rejection
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.detections import to_detections
from conetl.perception.detector import Detector, detect_image
from conetl.perception.images import ImageFileError
from conetl.perception.pair_points import pair_points
from conetl.perception.rectified_image import read_rig_image
from conetl.tracking.matching.epipolar_search import Region, right_region
from conetl.tracking.matching.matches import match_pair
from conetl.tracking.pair_calibration import PairCalibration, calibrate_pair
from conetl.tracking.positions import CameraPosition, locate_in_camera


class SearchedImage(NamedTuple):
    """One image of a pair, and the objects in it; without image and problem it was not searched."""

    image: Image | None = None
    detections: Sequence[Detection] = ()
    rejections: Sequence[Rejection] = ()
    problem: ImageFileError | None = None
    """Why it cannot be decoded."""
    processor_s: float = 0.0


SearchedPair = Mapping[Side, SearchedImage]


def search_pair(
    frame_index: int,
    read: Callable[[Side], Image],
    detector: Callable[[Side], Detector],
    rig: Rig,
    params: IngestParams,
    first_rows: Mapping[Side, int],
    *,
    everywhere: bool = True,
    is_single: bool = False,
    pool: Executor | None = None,
) -> SearchedPair:
    """Search both images of a pair. read: raises ImageFileError, which becomes the image's problem.

    detector: for the image of a side, in the thread that searches it. first_rows: rows above them are not searched. everywhere:
    also the right image, which else is searched around possible partners of left boxes. is_single: not one of many pairs of a
    drive. pool: another thread searches the right image at the same time, everywhere.
    """
    limits = params.detection

    def search(side: Side, region: Region | None = None) -> SearchedImage:
        begun_s = time.thread_time()
        try:
            image = read(side)
        except ImageFileError as error:
            return SearchedImage(problem=error)
        own = detector(side)
        boxes = detect_image(
            own, image, score_threshold=limits.score_threshold, nms_iou=limits.nms_iou, categories=limits.categories,
            first_row=first_rows.get(side, 0), within=None if region is None else region[:4],
            reach_px=0.0 if region is None else region.reach_px, single_image=is_single,
        )  # fmt: skip
        names = own.card.class_names
        found = to_detections(boxes, frame_index=frame_index, side=side, params=limits, categories=names)
        return SearchedImage(image, *found, processor_s=time.thread_time() - begun_s)

    if pool is not None:
        right = pool.submit(search, "right")
        return {"left": search("left"), "right": right.result()}
    left = search("left")
    region = None if everywhere else right_region(left.detections, rig, params)
    return {"left": left, "right": search("right", region) if everywhere or region else SearchedImage()}


def match_searched(
    searched: SearchedPair, rig: Rig, params: MatchParams, up_left: Floats
) -> tuple[list[StereoMatch], list[Rejection]]:
    """Stereo matches of a searched pair. rig: may be corrected since the search; up_left: as for `match_pair`."""
    left, right = (searched[side] for side in SIDES)
    images = None if left.image is None or right.image is None else (left.image, right.image)
    return match_pair(left.detections, right.detections, rig, params, up_left=up_left, images=images)


def images_of(searched: SearchedPair) -> tuple[Image, Image]:
    """Both images of a pair that was searched everywhere. Raises ImageFileError if one cannot be decoded."""
    images = []
    for one in (searched[side] for side in SIDES):
        if one.image is None:
            raise one.problem or ValueError("the right image was not searched")
        images.append(one.image)
    return images[0], images[1]


def first_road_rows(pairs: Iterable[FramePair], rig: Rig, params: DetectionParams) -> dict[Side, int]:
    """First row of the images of each side that can show the road, by the poses of these pairs."""
    poses = [pair.pose for pair in pairs]
    return {
        side: first_road_row(
            camera_of(rig, side),
            [map_SE3_camera(pose, rig, side)[:3, :3] for pose in poses],
            params.searched_margin_rad,
        )
        for side in SIDES
    }


def map_up_in_left(pair: FramePair, rig: Rig) -> Floats:
    """Up direction (3,) of the map in the left camera's frame."""
    return map_SE3_left(pair.pose, rig)[2, :3]


class LocatedPair(NamedTuple):
    """Cones and other objects of one pair without a trajectory."""

    calibration: PairCalibration
    detections: list[Sequence[Detection]]
    matches: list[StereoMatch]
    cones: list[CameraPosition]
    """By distance."""
    objects: list[CameraPosition]
    """What is not a cone, by distance."""
    misfits: list[CameraPosition]
    """Objects whose height is not that of their category."""
    unmatched: dict[Side, int]
    rejections: list[Rejection]


def locate_pair(paths: tuple[Path, Path], rig: Rig, detector: Detector, params: IngestParams) -> LocatedPair:
    """Objects of one stereo pair in the frame of the left camera.

    Raises ImageFileError, and InputError if the images contradict the calibration.
    """
    path_of = dict(zip(SIDES, paths, strict=True))
    searched = search_pair(
        0, lambda side: read_rig_image(path_of[side], rig, side), lambda _: detector, rig, params, {}, is_single=True
    )  # fmt: skip
    left, right = (np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) for image in images_of(searched))
    calibration = calibrate_pair(pair_points(left, right, params.trajectory), rig, params.pair, params.trajectory)
    rig = calibration.rig
    matches, rejected = match_searched(searched, rig, params.match, up_in_left_camera(rig))
    detections = [searched[side].detections for side in SIDES]
    located, more = locate_in_camera(matches, rig, params.position)
    located.sort(key=lambda one: one.ground_distance_m)
    # No second pair distinguishes a cone from a sign, but its height must be that of a cone, as in a drive.
    limits_m = [params.track.heights_m(one.category) for one in located]
    fits = [one for one, (least, most) in zip(located, limits_m, strict=True) if least <= one.object_height_m <= most]
    unmatched = {
        side: len(found)
        - sum(getattr(one, side) is not None for one in matches)
        - sum(r.payload.get("side") == side for r in rejected)
        for side, found in zip(SIDES, detections, strict=True)
    }
    cones, objects = ([one for one in fits if (one.category == CONE) == is_cone] for is_cone in (True, False))
    misfits = [one for one in located if one not in fits]
    return LocatedPair(calibration, detections, matches, cones, objects, misfits, unmatched, [*rejected, *more])
