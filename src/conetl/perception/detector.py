"""The cone detector: loads an ONNX network and finds cones in one image. The only importer of onnxruntime.

A model is two files: `NAME.onnx` and its sidecar `NAME.onnx.json` (`model_card.py`). Networks of the YOLO family are supported
(`heads.py`); the shipped one has its own head (`decoding.py`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from conetl.model.errors import InputError, ModelFileError
from conetl.perception import decoding
from conetl.perception.heads import EndToEndHead, SideDistributionHead, check_outputs, decode_head
from conetl.perception.model_card import ModelCard, read_model_card, shipped_model_path
from conetl.perception.second_passes import MIN_SCORE, detect_small_objects, rescore

MAX_SIDE_PX = 1600
MIN_SIDE_PX = 8
#: At least this many rows are searched, wherever the road begins.
MIN_ROWS_PX = 120
#: Images of this shorter side and more are searched at half and a quarter of their size, too: cones taller than about 250 px
#: are too large for the network. That takes time, so of small images only single ones are searched that way.
COARSE_PASSES_FROM_PX, COARSE_PASSES_OF_SINGLE_FROM_PX = 480, 160
LARGE_CONE_PX = 48.0
#: Small candidates of at least this score start the small-object pass of a single image, whatever the sidecar asks for drives. On
#: three US streets left out of training it finds 5 more of 281 cones at score 0.3, with 3 more false boxes in 96 images.
SMALL_OBJECTS_OF_SINGLE_FROM_SCORE = 0.1
#: Margin around a searched part, in pixels of the network's input: boxes then differ from those of the whole image by 0.08 px in
#: the median (benchmarks/RESULTS.md).
CONTEXT_PX = 64.0
#: Images in one run of the network. It returns its best cells of all of them together: with about twenty images the weaker ones
#: begin to lose theirs.
MAX_BATCH = 8
#: Candidates that overlap more after a second pass are one. Adjacent cones overlap less.
SAME_BOX_IOU = 0.7


@dataclass(frozen=True)
class Detector:
    """A loaded network. One per Python thread: sessions run with the number of threads they were loaded with."""

    session: onnxruntime.InferenceSession
    path: Path
    card: ModelCard
    input_name: str
    fixed_size: tuple[int, int] | None = None
    """Height and width in pixels if the network accepts only one size; images are scaled to fit."""
    any_size: bool = True
    """Whether the network accepts images of any size; False if one side is fixed."""
    several: bool = False
    """Whether the network accepts several images of one size at once."""


def load_detector(model_path: Path | None = None, *, threads: int = 1, providers: str = "CPU") -> Detector:
    """Load a model after checking its SHA-256 against the sidecar.

    providers: execution providers of onnxruntime, separated by commas, with or without `ExecutionProvider` at the end. Raises
    ModelFileError or, for providers that cannot be used, InputError, before any image is read.
    """
    ordered = _available_providers(providers)
    path = shipped_model_path() if model_path is None else model_path
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelFileError(f"{path}: cannot read the model file ({error.strerror}); expected an ONNX file") from error
    card = read_model_card(path)
    found = hashlib.sha256(content).hexdigest()
    if found != card.sha256:
        raise ModelFileError(
            f"{path}: SHA-256 is {found}, the sidecar expects {card.sha256}; the file is damaged or of another version: "
            "fetch it again"
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(content, options, providers=ordered)
    except Exception as error:  # onnxruntime raises a dozen unrelated kinds for a file that is not a network
        raise ModelFileError(f"{path}: onnxruntime cannot load it as a network: {error}") from error
    if unusable := [name for name in ordered if name not in session.get_providers()]:
        raise InputError(
            f"CONETL_ONNX_PROVIDERS: {unusable[0]} is installed, but does not start on this machine (its driver or libraries are "
            f"missing): leave it out, or see what `{unusable[0]}` of onnxruntime requires"
        )
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1 or len(inputs[0].shape) != 4:
        raise ModelFileError(
            f"{path}: expected a network with one input of four dimensions, found {len(inputs)} inputs"
        )
    wanted = "tensor(uint8)" if "uint8" in card.input_layout else "tensor(float)"
    if inputs[0].type != wanted:
        raise ModelFileError(
            f"{path}: the network takes a {inputs[0].type}, but the sidecar's input_layout is {card.input_layout!r}: "
            "correct that key"
        )
    channels_last = "NHWC" in card.input_layout
    shape = inputs[0].shape
    stated, other = (shape[3], shape[1]) if channels_last else (shape[1], shape[3])
    if stated != 3 and (isinstance(stated, int) or other == 3):
        found = f"the input is {'NCHW' if channels_last else 'NHWC'}: correct that key"
        hint = found if other == 3 else "a network for images of 3 channels is required"
        raise ModelFileError(
            f"{path}: the network's input is {' x '.join(map(str, shape))}, the sidecar's input_layout {card.input_layout!r}: "
            f"{hint}"
        )
    shapes = [output.shape for output in outputs]
    try:
        check_outputs(card.head, shapes)
        card.require_metadata(session.get_modelmeta().custom_metadata_map)
    except ModelFileError as error:
        raise ModelFileError(f"{path}: {error}") from error
    size = shape[1:3] if channels_last else shape[2:4]
    fixed = (size[0], size[1]) if all(isinstance(side, int) for side in size) else None
    any_size = not any(isinstance(side, int) for side in size)
    for key in ("closer_look", "enlarged_look"):
        if getattr(card, key) is not None and not any_size:
            raise ModelFileError(
                f"{path}: the network takes images of {size[1]}x{size[0]} only: "
                f"{key} in its sidecar requires one that takes any size; leave that key out"
            )
    several = isinstance(card.head, SideDistributionHead) and not isinstance(inputs[0].shape[0], int)
    return Detector(session, path, card, inputs[0].name, fixed, any_size, several)


def _available_providers(names: str) -> list[str]:
    found = {name.removesuffix("ExecutionProvider").lower(): name for name in onnxruntime.get_available_providers()}
    wanted = [name.strip().removesuffix("ExecutionProvider") for name in names.split(",")]
    if missing := [name for name in wanted if name.lower() not in found]:
        installed = ", ".join(name.removesuffix("ExecutionProvider") for name in found.values())
        raise InputError(
            f"CONETL_ONNX_PROVIDERS: the installed onnxruntime has no {missing[0] or 'provider without a name'}, "
            f"it has {installed}: choose among these, or install the onnxruntime package for that accelerator"
        )
    return [found[name.lower()] for name in wanted]


def network_input(
    image_bgr: NDArray[np.uint8],
    pad_multiple_px: int,
    max_side_px: int,
    *,
    layout: str = "RGB float32 NCHW 0..1",
    fixed_size: tuple[int, int] | None = None,
) -> tuple[NDArray[np.float32] | NDArray[np.uint8], float, float]:
    """Image (H, W, 3) -> network input (1, 3, H', W'), or (1, H', W', 3), and the scales (x, y) that were applied to the image.

    Native resolution unless a side exceeds `max_side_px` or the network takes one size only. The padding is at the right and
    bottom and repeats the edge, so that no false edge appears.
    """
    height, width = image_bgr.shape[:2]
    if fixed_size is None:
        scale = min(1.0, max_side_px / max(height, width))
    else:
        scale = min(fixed_size[0] / height, fixed_size[1] / width)
    if scale == 1.0:
        scaled = image_bgr
    else:
        size = (max(round(width * scale), 1), max(round(height * scale), 1))
        method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        scaled = np.asarray(cv2.resize(image_bgr, size, interpolation=method), dtype=np.uint8)
    rows, columns = scaled.shape[:2]
    below, beside = (
        (-rows % pad_multiple_px, -columns % pad_multiple_px)
        if fixed_size is None
        else (fixed_size[0] - rows, fixed_size[1] - columns)
    )
    if below or beside:
        scaled = np.asarray(cv2.copyMakeBorder(scaled, 0, below, 0, beside, cv2.BORDER_REPLICATE), np.uint8)
    return as_tensor(scaled, layout), columns / width, rows / height


def as_tensor(image_bgr: NDArray[np.uint8], layout: str) -> NDArray[np.float32] | NDArray[np.uint8]:
    """Image (H, W, 3) -> (1, 3, H, W) or (1, H, W, 3), in the colours, numbers and range of a sidecar's `input_layout`."""
    rgb = layout.startswith("RGB")
    if "uint8" in layout:
        ordered = np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2RGB), np.uint8) if rgb else image_bgr
        return ordered[None] if "NHWC" in layout else np.ascontiguousarray(ordered.transpose(2, 0, 1)[None])
    factor = 1.0 / 255.0 if layout.endswith("0..1") else 1.0
    blob = np.asarray(cv2.dnn.blobFromImage(image_bgr, factor, swapRB=rgb), np.float32)
    return np.ascontiguousarray(blob.transpose(0, 2, 3, 1)) if "NHWC" in layout else blob


def detect_image(
    detector: Detector,
    image_bgr: NDArray[np.uint8],
    *,
    score_threshold: float,
    nms_iou: float = 0.5,
    first_row: int = 0,
    within: tuple[float, float, float, float] | None = None,
    reach_px: float = 0.0,
    single_image: bool = False,
    categories: Sequence[str] | None = ("traffic_cone",),
) -> NDArray[np.float64]:
    """Detect the objects of these categories (None: all of the model) in one image (H, W, 3) uint8 BGR.

    Returns (N, 10) [x, y, w, h, score, foot x, foot y, tip x, tip y, index in `card.class_names`] by descending score: x, y is
    the top-left corner in pixels of the image, with x = 0 and y = 0 at its edges (0.5 at the centre of the first pixel). Foot and
    tip are NaN if the network does not output them. The sidecar can enable the small-object pass and, after it, the re-scoring
    pass (`second_passes.py`). first_row: rows above it are not searched (`geometry.camera.first_road_row`). within: x0, y0, x1,
    y1 in which boxes must have their centre (None: anywhere); reach_px: how far they may extend beyond it; the network then sees
    only a margin of `CONTEXT_PX`. single_image: not one of many of a drive, so large and very small cones matter more than time.
    """
    if image_bgr.dtype != np.uint8 or image_bgr.ndim != 3 or image_bgr.shape[2] != 3:
        raise ValueError(f"expected a BGR image (H, W, 3) of uint8, got {image_bgr.shape} of {image_bgr.dtype}")
    whole = image_bgr
    first_row = min(max(first_row, 0), max(whole.shape[0] - MIN_ROWS_PX, 0))
    road = whole[first_row:]
    if min(road.shape[:2]) < MIN_SIDE_PX:
        return np.zeros((0, decoding.COLUMNS))
    if within is not None:
        within = (within[0], within[1] - first_row, within[2], within[3] - first_row)
    card = detector.card
    wanted_classes = None if categories is None else [k for k, c in enumerate(card.class_names) if c in categories]
    if wanted_classes == []:
        return np.zeros((0, decoding.COLUMNS))

    def run(images: Sequence[NDArray[np.uint8]], longest_px: int, min_score: float) -> list[decoding.NetworkBoxes]:
        return run_network(detector, images, longest_px, min_score, nms_iou, wanted_classes)

    rescoring, small_objects = card.closer_look, card.enlarged_look
    # Candidates of a second pass must be found first, whatever the caller's threshold.
    candidate_score = score_threshold if rescoring is None else min(score_threshold, rescoring.scores[0])
    candidate_score = candidate_score if small_objects is None else min(candidate_score, MIN_SCORE)
    scale = max(road.shape[:2]) / min(max(road.shape[:2]), MAX_SIDE_PX)
    window = slice(0, road.shape[0]), slice(0, road.shape[1])
    if within is not None and detector.any_size:
        window = _search_window(detector, road.shape, within, reach_px, scale)
    coarse_from_px = COARSE_PASSES_OF_SINGLE_FROM_PX if single_image else COARSE_PASSES_FROM_PX
    coarse = detector.fixed_size is None and min(road.shape[:2]) / scale >= coarse_from_px
    boxes = _search(run, road, window, candidate_score, nms_iou if coarse else None)
    if small_objects is not None:
        if single_image:
            from_score = min(small_objects.from_score, SMALL_OBJECTS_OF_SINGLE_FROM_SCORE)
            small_objects = small_objects.model_copy(update={"from_score": from_score})
        # Candidates outside `within` do not start the pass, but take its results.
        wanted = None if within is None else _has_centre_in(boxes, within)
        found = detect_small_objects(
            lambda image: run([image], max(image.shape[:2]), MIN_SCORE)[0], road, boxes, small_objects, scale, wanted
        )
        boxes = decoding.suppress_overlaps(found, SAME_BOX_IOU)
    if within is not None:
        boxes = boxes[_has_centre_in(boxes, within)]
    boxes[:, [1, 3, 6, 8]] += first_row
    if rescoring is not None:
        rescored = rescore(
            lambda windows, min_score: [found for found, _ in run(windows, rescoring.window_px, min_score)],
            whole,
            boxes,
            rescoring,
        )
        boxes = decoding.suppress_overlaps(rescored, SAME_BOX_IOU)
    boxes = boxes[boxes[:, 4] >= score_threshold]  # second passes need candidates below it
    return decoding.boxes_in_image(boxes, whole.shape[1], whole.shape[0])


def _search(
    run: Callable[[Sequence[NDArray[np.uint8]], int, float], list[decoding.NetworkBoxes]],
    road: NDArray[np.uint8],
    window: tuple[slice, slice],
    min_score: float,
    coarse_nms_iou: float | None,
) -> NDArray[np.float64]:
    """Candidates (N, 10) of the first pass over a window of the road's image, in pixels of the road's image.

    run: network on images of one size, whose longer side is scaled to so many pixels, from a score on. coarse_nms_iou: overlap
    from which boxes of searches at half and a quarter of the size, for large cones, are the same; None: no such searches.
    """
    part, longest = road[window], max(road.shape[:2])

    def run_on_part(longest_px: int) -> NDArray[np.float64]:
        """As if the longer side of the road were scaled to this many pixels."""
        return run([part], max(round(longest_px * max(part.shape[:2]) / longest), 1), min_score)[0][0]

    side_px = min(longest, MAX_SIDE_PX)
    boxes = run_on_part(side_px)
    if coarse_nms_iou is not None:
        for smaller_px in (side_px // 2, side_px // 4):
            again = run_on_part(smaller_px)
            large = again[(again[:, 3] - again[:, 1]) * smaller_px / longest > LARGE_CONE_PX]
            both = np.concatenate((decoding.suppress_parts(boxes, large), large))
            boxes = decoding.suppress_overlaps(both, coarse_nms_iou)
    rows, columns = window
    boxes[:, [0, 2, 5, 7]] += columns.start
    boxes[:, [1, 3, 6, 8]] += rows.start
    return boxes


def _search_window(
    detector: Detector,
    shape: tuple[int, ...],
    within: tuple[float, float, float, float],
    reach_px: float,
    scale: float,
) -> tuple[slice, slice]:
    """Rows and columns of the road's image (H, W, 3) in which boxes with their centre within x0, y0, x1, y1 (px) can be found.

    They begin at multiples of the network's largest stride, so that its cells are those of the whole image. scale: image pixels
    per pixel of the network's input.
    """
    x0, y0, x1, y1 = within
    cell, context = detector.card.pad_multiple_px * scale, CONTEXT_PX * scale + reach_px

    def span(low: float, high: float, length: int) -> slice:
        begin = round(int(max(low - context, 0.0) / cell) * cell)
        end = round(int(np.ceil((high + context) / cell)) * cell)
        return slice(min(begin, length - MIN_SIDE_PX), min(max(end, begin + MIN_SIDE_PX), length))

    return span(y0, y1, shape[0]), span(x0, x1, shape[1])


def _has_centre_in(boxes: NDArray[np.float64], within: tuple[float, float, float, float]) -> NDArray[np.bool_]:
    """(N,) whether candidates (N, 4 or more) [x0, y0, x1, y1, ...] have their centre in x0, y0, x1, y1."""
    centres = (boxes[:, :2] + boxes[:, 2:4]) / 2
    return np.asarray(((centres >= within[:2]) & (centres <= within[2:])).all(axis=1))


def run_network(
    detector: Detector,
    images_bgr: Sequence[NDArray[np.uint8]],
    max_side_px: int,
    score_threshold: float,
    nms_iou: float,
    classes: Sequence[int] | None = None,
) -> list[decoding.NetworkBoxes]:
    """Candidates (N, 10) of each of several images of one size, in pixels of the image and not clipped to it.

    At most MAX_BATCH images per run, one where the network takes single images. classes: indices of those to return (None: all);
    the others suppress overlaps all the same, so that a drum is not a cone.
    """
    at_once = MAX_BATCH if detector.several else 1
    if len(images_bgr) > at_once:
        parts = [images_bgr[first : first + at_once] for first in range(0, len(images_bgr), at_once)]
        return [
            found
            for part in parts
            for found in run_network(detector, part, max_side_px, score_threshold, nms_iou, classes)
        ]
    card = detector.card
    inputs = [
        network_input(
            image, card.pad_multiple_px, max_side_px, layout=card.input_layout, fixed_size=detector.fixed_size
        )
        for image in images_bgr
    ]
    blob = np.concatenate([each for each, *_ in inputs]) if len(inputs) > 1 else inputs[0][0]
    _, scale_x, scale_y = inputs[0]
    outputs = [np.asarray(output) for output in detector.session.run(None, {detector.input_name: blob})]
    rows, columns = blob.shape[1:3] if "NHWC" in card.input_layout else blob.shape[2:4]
    head, omitted = card.head, 0.0
    if isinstance(head, SideDistributionHead):
        boxes, images, omitted = decoding.decode_cells(
            outputs, (len(images_bgr), rows, columns), head.strides_px, head.side_bins, score_threshold,
            foot_and_tip=head.foot_and_tip, class_count=head.class_count,
        )  # fmt: skip
        seen = [decoding.suppress_overlaps(boxes[images == number], nms_iou) for number in range(len(images_bgr))]
    else:
        found = decode_head(head, outputs, rows, columns, score_threshold)
        no_ends = np.full((len(found), decoding.COLUMNS - found.shape[1]), np.nan)
        boxes = np.concatenate((found[:, :5], no_ends, found[:, 5:]), axis=1)
        if isinstance(head, EndToEndHead):  # the network has suppressed overlaps already
            seen = [boxes[np.argsort(-boxes[:, 4], kind="stable")]]
        else:
            seen = [decoding.suppress_overlaps(boxes, nms_iou)]
    if classes is not None:
        seen = [each[[number in classes for number in each[:, -1].tolist()]] for each in seen]
    scales = np.array((scale_x, scale_y, scale_x, scale_y, 1.0, scale_x, scale_y, scale_x, scale_y, 1.0))
    return [(each / scales, omitted) for each in seen]
