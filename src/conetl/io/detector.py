"""The cone detector: reads the shipped ONNX network and finds cones in one image. The only importer of onnxruntime.

A model is two files: `NAME.onnx` and `NAME.onnx.json` beside it, which says what the network is and what its bytes hash to.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from conetl.errors import ModelFileError
from conetl.io.detector_decode import COLUMNS, boxes_in_image, decode_maps, suppress_overlaps, without_parts

DEFAULT_MODEL = "conetl-cone-2.onnx"
MAX_SIDE_PX = 1600
LEAST_SIDE_PX = 8
SECOND_LOOK_FROM_PX = 480
LARGE_CONE_PX = 48.0


class ModelCard(BaseModel):
    """The sidecar of a model file: what the network eats and gives. Unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    version: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    input_layout: Literal["RGB float32 NCHW 0..1"]
    head: Literal["side-distributions"]
    side_bins: int = Field(ge=2)
    foot_and_tip: bool = False
    """Whether the head gives the cone's foot and tip besides its box."""
    score_logit_scale: float = Field(default=1.0, gt=0)
    score_logit_offset: float = 0.0
    """Calibration of the score: probability = sigmoid(scale * logit + offset)."""
    strides_px: tuple[int, ...] = Field(min_length=1)
    pad_multiple_px: int = Field(ge=1)
    class_names: tuple[str, ...] = Field(min_length=1, max_length=1)
    score_scale: str
    licence: str


@dataclass(frozen=True)
class Detector:
    """A loaded network. One per Python thread: sessions run with the number of threads they were loaded with."""

    session: onnxruntime.InferenceSession
    path: Path
    card: ModelCard
    input_name: str

    @property
    def name(self) -> str:
        return self.card.name

    @property
    def version(self) -> str:
        return self.card.version

    @property
    def sha256(self) -> str:
        return self.card.sha256


def shipped_model_path() -> Path:
    """The model that comes with conetl: in a checkout under `data/models/`, in an installed wheel inside the package."""
    package = Path(__file__).resolve().parents[1]
    in_wheel = package / "data" / "models" / DEFAULT_MODEL
    in_checkout = package.parents[1] / "data" / "models" / DEFAULT_MODEL
    return in_wheel if in_wheel.exists() else in_checkout


def read_model_card(model_path: Path) -> ModelCard:
    """Read and check the sidecar `<model>.json`. Raises ModelFileError."""
    card_path = model_path.with_name(model_path.name + ".json")
    try:
        text = card_path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelFileError(
            f"{card_path}: cannot read the model's sidecar ({error}); every model needs one beside it"
        ) from error
    try:
        return ModelCard.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "file"
        raise ModelFileError(f"{card_path}: not a valid model sidecar: {place}: {first['msg']}") from error


def load_detector(model_path: Path | None = None, *, threads: int = 1) -> Detector:
    """Load a model after checking its SHA-256 against the sidecar. Raises ModelFileError before any image is read."""
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
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a dozen unrelated kinds for a file that is no network
        raise ModelFileError(f"{path}: onnxruntime cannot load it as a network: {error}") from error
    inputs, outputs = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1 or len(outputs) != len(card.strides_px):
        raise ModelFileError(
            f"{path}: has {len(inputs)} inputs and {len(outputs)} outputs, the sidecar expects 1 and {len(card.strides_px)}"
        )
    channels = [output.shape[1] if len(output.shape) == 4 else None for output in outputs]
    expected = 4 * card.side_bins + (5 if card.foot_and_tip else 1)
    if any(isinstance(count, int) and count != expected for count in channels) or None in channels:
        raise ModelFileError(f"{path}: its outputs have {channels} channels, the sidecar expects {expected} each")
    return Detector(session=session, path=path, card=card, input_name=inputs[0].name)


def network_input(
    image_bgr: NDArray[np.uint8], pad_multiple_px: int, max_side_px: int
) -> tuple[NDArray[np.float32], float, float]:
    """Image (H, W, 3) -> network input (1, 3, H', W') and the scales (x, y) that were applied to the image.

    Native resolution unless a side exceeds `max_side_px`. The padding is at the right and bottom and repeats the edge, so
    that no false edge appears there.
    """
    height, width = image_bgr.shape[:2]
    scale = min(1.0, max_side_px / max(height, width))
    if scale < 1.0:
        size = (max(round(width * scale), 1), max(round(height * scale), 1))
        scaled = cv2.resize(image_bgr, size, interpolation=cv2.INTER_AREA)
    else:
        scaled = image_bgr
    rows, columns = scaled.shape[:2]
    padded = cv2.copyMakeBorder(scaled, 0, -rows % pad_multiple_px, 0, -columns % pad_multiple_px, cv2.BORDER_REPLICATE)
    blob: NDArray[np.float32] = np.asarray(
        cv2.dnn.blobFromImage(padded, 1.0 / 255.0, swapRB=True, crop=False), dtype=np.float32
    )
    return blob, columns / width, rows / height


def detect_image(
    detector: Detector,
    image_bgr: NDArray[np.uint8],
    *,
    score_threshold: float,
    nms_iou: float = 0.5,
    max_side_px: int = MAX_SIDE_PX,
    first_row: int = 0,
) -> NDArray[np.float64]:
    """Find the cones of one image (H, W, 3) uint8 BGR.

    Returns (N, 9) [x, y, w, h, score, foot x, foot y, tip x, tip y] by falling score: x, y is the top-left corner, in pixels of
    the given image, whose left and top edges are x = 0 and y = 0 (the centre of the first pixel is 0.5). Foot and tip are NaN
    where the network does not give them. first_row: rows above it are not looked at (see `geometry.horizon`).
    """
    if image_bgr.dtype != np.uint8 or image_bgr.ndim != 3 or image_bgr.shape[2] != 3:
        raise ValueError(f"expected a BGR image (H, W, 3) of uint8, got {image_bgr.shape} of {image_bgr.dtype}")
    whole = image_bgr
    first_row = min(max(first_row, 0), max(whole.shape[0] - SECOND_LOOK_FROM_PX // 4, 0))
    image_bgr = whole[first_row:]
    if min(image_bgr.shape[:2]) < LEAST_SIDE_PX:
        return np.zeros((0, COLUMNS))
    longest, shortest = max(image_bgr.shape[:2]), min(image_bgr.shape[:2])
    side_px = min(longest, max_side_px)
    boxes = look(detector, image_bgr, side_px, score_threshold, nms_iou)
    # Very tall cones outgrow the network at full size: tall pictures get two more looks, each half as large.
    if shortest * side_px / longest >= SECOND_LOOK_FROM_PX:
        for smaller_px in (side_px // 2, side_px // 4):
            again = look(detector, image_bgr, smaller_px, score_threshold, nms_iou)
            large = again[(again[:, 3] - again[:, 1]) * smaller_px / longest > LARGE_CONE_PX]
            boxes = suppress_overlaps(np.concatenate((without_parts(boxes, large), large)), nms_iou)
    boxes[:, [1, 3, 6, 8]] += first_row
    return boxes_in_image(boxes, whole.shape[1], whole.shape[0])


def look(
    detector: Detector, image_bgr: NDArray[np.uint8], max_side_px: int, score_threshold: float, nms_iou: float
) -> NDArray[np.float64]:
    """One run of the network: candidates (N, 9) of `decode_map` in pixels of the image, not yet cut at its edges."""
    blob, scale_x, scale_y = network_input(image_bgr, detector.card.pad_multiple_px, max_side_px)
    outputs = detector.session.run(None, {detector.input_name: blob})
    maps = [np.asarray(output)[0] for output in outputs]
    card = detector.card
    boxes = decode_maps(
        maps, card.strides_px, card.side_bins, score_threshold, nms_iou,
        foot_and_tip=card.foot_and_tip, calibration=(card.score_logit_scale, card.score_logit_offset),
    )  # fmt: skip
    return boxes / (scale_x, scale_y, scale_x, scale_y, 1.0, scale_x, scale_y, scale_x, scale_y)
