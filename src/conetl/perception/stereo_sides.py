"""Whether left is left: images that are swapped, mirrored or upside down put what is near on the wrong side.

In a rectified pair every point lies in the right image at the same row and not farther right than in the left one. Of matched ORB
features (Rublee et al. 2011) in the sample drives and a real street 0 to 1 % contradict it; with swapped, mirrored or upside-down
images 85 to 100 % do.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.model.errors import DriveFolderError
from conetl.model.records import Drive
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_pair_image

_PAIRS, _FEATURES, _MIN_MATCHES = 5, 1000, 50
#: Of the image's height; a rig that is not rectified well is the business of self-calibration.
_ROW_TOLERANCE = 0.02
_MAX_HAMMING = 50
_WRONG_SHARE = 0.7


def require_left_and_right(drive: Drive) -> None:
    """Look at some pairs of a drive. Raises DriveFolderError where their sides are wrong; images without detail pass."""
    chosen = np.unique(np.linspace(0, len(drive.frame_pairs) - 1, _PAIRS).astype(int))
    disparities = np.concatenate([_disparities(drive, int(number)) for number in chosen])
    wrong = int((disparities < -1.0).sum())
    if len(disparities) >= _MIN_MATCHES and wrong > _WRONG_SHARE * len(disparities):
        raise DriveFolderError(
            f"{drive.source_path}: the images are swapped, mirrored or upside down: of {len(disparities)} points in both images "
            f"{wrong} lie farther right in the right image. Exchange the cameras' folders (drive.yaml: cameras), or turn the "
            "images."
        )


def _disparities(drive: Drive, number: int) -> NDArray[np.float64]:
    """Columns left minus right (pixels of half the size) of matched features of one pair; none where an image is broken."""
    pair = drive.frame_pairs[number]
    try:
        images = [read_pair_image(pair, side, drive.rig, grey=True) for side in ("left", "right")]
    except ImageFileError:
        return np.empty(0)
    orb = cv2.ORB.create(_FEATURES)
    points, features = zip(
        *(
            orb.detectAndCompute(cv2.resize(i, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), None)
            for i in images
        ),
        strict=True,
    )
    if any(each is None for each in features):
        return np.empty(0)
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(*features)
    ends = [(points[0][m.queryIdx].pt, points[1][m.trainIdx].pt) for m in matches if m.distance < _MAX_HAMMING]
    left, right = np.reshape(np.array(ends), (-1, 2, 2)).transpose(1, 0, 2)
    same_row = np.abs(left[:, 1] - right[:, 1]) <= _ROW_TOLERANCE * images[0].shape[0] / 2
    return np.asarray((left - right)[same_row, 0], np.float64)
