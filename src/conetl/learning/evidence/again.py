"""The evidence of a network that was taught a few images: what they can measure, the rest as of the network it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pydantic import ValidationError

from conetl.learning.classes import CLASSES
from conetl.learning.evidence.calibration import REFERENCE, compare_calibrations, fit_platt, folds_of
from conetl.learning.evidence.looks import LEAST_SCORE, MATCH_IOU, ConeLooks, look_at_pictures
from conetl.learning.evidence.measure import (
    HEIGHTS_PX,
    HIDDEN,
    HIDDEN_MOST,
    THRESHOLDS,
    detection_tables,
    false_box_rates,
)
from conetl.learning.images import LabelledImage
from conetl.learning.replay import DRAWN
from conetl.model.detector_evidence import DetectorEvidence
from conetl.model.feature_classes import CONE
from conetl.perception.detector import Detector, detect_image

LEAST_CONES, LEAST_TRUE, LEAST_FALSE = 20, 20, 5
#: With fewer boxes only a straight line is fitted to their scores.
_FEW_BOXES = 200
#: With fewer wholly labelled images the false boxes per image stay those of the base network.
_LEAST_WHOLE = 10


def measure_again(
    detector: Detector, base: DetectorEvidence | None, images: Sequence[LabelledImage]
) -> tuple[DetectorEvidence | None, str]:
    """The evidence of a detector, and what it is from, or why there is none.

    base: that of the network it was made from: correlations and lookalikes, which a few dozen images cannot show, stay those.
    images: kept out of training; drawn scenes among them count for P(detect) only.
    """
    if base is None:
        return None, "the network that it was made from has no evidence"
    cone = CLASSES.index(CONE)
    cones = [replace(one, boxes=one.boxes[one.boxes[:, 8] == cone]) for one in images if CONE in one.taught]
    looks = look_at_pictures(cones, _is_whole, lambda image: detect_image(detector, image, score_threshold=LEAST_SCORE))
    own = sum(len(one.boxes) for one in cones if one.source != DRAWN)
    true = sum(row[3] for row in looks.boxes)
    false = len(looks.boxes) - true
    if len(looks.cones) < LEAST_CONES or true < LEAST_TRUE or false < LEAST_FALSE:
        return None, (
            f"{own} cones with {true} boxes on them and {false} false boxes in the images kept out: at least {LEAST_TRUE} and "
            f"{LEAST_FALSE} boxes are needed"
        )
    scores, truth = (np.array([row[k] for row in looks.boxes]) for k in (2, 3))
    counts, detected = detection_tables(looks)
    above = truth[scores >= REFERENCE]
    changed = {
        "model_sha256": detector.card.sha256, "match_iou": MATCH_IOU, "reference_score": REFERENCE,
        "true_boxes": max(int(above.sum()), 1), "false_boxes": max(int((~above).sum()), 1), "score_thresholds": THRESHOLDS,
        "height_bands_px": HEIGHTS_PX, "hidden_bands": HIDDEN, "hidden_most": HIDDEN_MOST, "looks": counts, "detected": detected,
    }  # fmt: skip
    if base.score_thresholds != THRESHOLDS or base.height_bands_px != HEIGHTS_PX:
        return None, "the evidence of the network that it was made from has other thresholds or heights"
    whole = sum(looks.exact)
    if whole >= _LEAST_WHOLE:
        changed |= dict(
            zip(("false_box_pictures", "false_boxes_per_picture"), false_box_rates(_of_whole(looks)), strict=True)
        )
    try:
        few = len(looks.boxes) < _FEW_BOXES
        changed["calibration"] = fit_platt(scores, truth) if few else compare_calibrations(looks, folds_of(cones))[0]
        evidence = DetectorEvidence.model_validate(base.model_dump() | changed)
    except ValidationError as error:
        return None, f"the scores in the images kept out do not order boxes by truth ({error.error_count()} problems)"
    drawn = sum(len(one.boxes) for one in cones) - own
    return evidence, f"{own} own and {drawn} drawn cones, {true} true and {false} false boxes"


def _is_whole(image: LabelledImage) -> bool:
    """Whether every cone in it is labelled."""
    return not image.judged_only


def _of_whole(looks: ConeLooks) -> ConeLooks:
    """What `false_box_rates` counts, per wholly labelled image: in the others only refused boxes are known to be false."""
    return replace(looks, exact=[one for one in looks.exact if one])
