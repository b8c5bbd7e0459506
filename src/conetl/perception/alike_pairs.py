"""Frame pairs that show what their neighbours show: of a standing vehicle, in a jam, or of cameras much faster than 10 Hz.

They cost as much as all others and add nothing: the errors of their detections are the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from conetl.geometry.pose import map_SE3_body
from conetl.geometry.small_arrays import pose_distance
from conetl.model.arrays import Floats, Image
from conetl.model.drive import FramePair
from conetl.model.params import SelectionParams
from conetl.perception.images import ImageFileError
from conetl.perception.working_size import ImageReader

#: Images are compared at this width (px), in blocks of this side, without what is coarser than this sigma.
_WIDTH_PX, _BLOCK_PX, _COARSE_PX = 160, 12, 3.0
#: Least correlation of images at one position: noise leaves 0.99, and 1.3 m on an empty street at most 0.9.
_SAME = 0.95


def without_alike(frame_pairs: Sequence[FramePair], read: ImageReader, params: SelectionParams) -> list[FramePair]:
    """The frame pairs that are worth a search, in order, with the first one.

    A pair is left out if the next one is still near the last that is kept: of 12 pairs per second all are kept, and of a stop the
    first and the last. Near is little time and distance; or hardly any distance by the log, if the left images agree as well as
    that suggests: a log may stand still while the vehicle drives. read: of grey left images; those of fast cameras are not read.
    """
    poses = np.array([map_SE3_body(pair.pose) for pair in frame_pairs])
    times_s = np.array([pair.captured_at_ns - frame_pairs[0].captured_at_ns for pair in frame_pairs]) * 1e-9
    if len(poses) > 1:  # after the last pair the vehicle goes on as before it
        poses = np.concatenate([poses, [poses[-1] @ np.linalg.inv(poses[-2]) @ poses[-1]]])
        times_s = np.append(times_s, 2 * times_s[-1] - times_s[-2])
    kept, view = [0], None
    for k in range(1, len(frame_pairs)):
        later_s = times_s[k : k + 2] - times_s[kept[-1]]
        turn_rad, shift_m = pose_distance(poses[k : k + 2], poses[kept[-1]])
        if later_s[1] <= params.dense_s and shift_m[1] <= params.dense_m:
            continue
        own = None
        if shift_m.max() < params.standing_m and turn_rad.max() <= params.standing_rad:
            own, view = _view(frame_pairs[k], read), _view(frame_pairs[kept[-1]], read) if view is None else view
            lost = (1 - params.standing_correlation) * shift_m[0] / params.standing_m
            if _agree(view, own) >= min(1 - lost, _SAME):
                continue
        kept.append(k)
        view = own
    return [frame_pairs[k] for k in kept] if len(kept) >= params.fewest_pairs else list(frame_pairs)


def _view(pair: FramePair, read: ImageReader) -> Floats:
    """(blocks, pixels) fine structure of the small left image; without blocks where it cannot be read."""
    try:
        image = read(pair, "left")
    except ImageFileError:
        return np.zeros((0, _BLOCK_PX**2))
    return _blocks(image)


def _blocks(image: Image) -> Floats:
    """(blocks, pixels) of a grey image (H, W)."""
    height = max(round(image.shape[0] * _WIDTH_PX / image.shape[1]), 1)
    small = cv2.resize(image, (_WIDTH_PX, height), interpolation=cv2.INTER_AREA).astype(np.float64)
    small -= cv2.GaussianBlur(small, (0, 0), _COARSE_PX)
    rows, columns = height // _BLOCK_PX, _WIDTH_PX // _BLOCK_PX
    cut = small[: rows * _BLOCK_PX, : columns * _BLOCK_PX].reshape(rows, _BLOCK_PX, columns, _BLOCK_PX)
    return cut.transpose(0, 2, 1, 3).reshape(-1, _BLOCK_PX**2)


def _agree(one: Floats, other: Floats) -> float:
    """Median correlation of the half of the blocks with the most structure: traffic that passes covers less than half of them."""
    if not len(one) or one.shape != other.shape:
        return 0.0
    own, others = (one**2).sum(axis=1), (other**2).sum(axis=1)
    found = (one * other).sum(axis=1) / np.sqrt(np.maximum(own * others, 1e-9))
    return float(np.median(found[own >= np.median(own)]))
