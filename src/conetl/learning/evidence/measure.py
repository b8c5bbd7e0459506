"""The evidence of a model card: calibration, P(detect | height, hidden), false boxes, correlations (training/README.md)."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from conetl.learning.evidence.calibration import REFERENCE, compare_calibrations, fit_logistic
from conetl.learning.evidence.looks import MATCH_IOU, SCALES, ConeLooks
from conetl.model.detector_evidence import (
    UNMEASURED,
    DetectorEvidence,
    ImageCorrelation,
    box_log_ratio,
    detect_probability,
    joint_log_ratio,
    miss_log_ratio,
)
from conetl.model.params import IngestParams

THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
HEIGHTS_PX = (8.0, 12.0, 16.0, 20.0, 30.0, 60.0)
HIDDEN = (0.0, 0.125, 0.375)
HIDDEN_MOST = 0.625
#: A cell of the detection table begins with this many looks of the smooth fit's opinion.
PRIOR_LOOKS = 8.0


def detection_tables(looks: ConeLooks) -> tuple[list[list[int]], list[list[list[float]]]]:
    """Cones looked at, by height and hidden band, and P(box >= threshold) by threshold, height and hidden band.

    Beta prior of PRIOR_LOOKS looks around a logistic regression on log height and hidden share: cells with few looks lean on
    their neighbours.
    """
    rows = np.array([row for row in looks.cones if row[3] >= HEIGHTS_PX[0] and row[4] <= HIDDEN_MOST])
    height, hidden, best = rows[:, 3], rows[:, 4], rows[:, 5]
    i = np.searchsorted(HEIGHTS_PX, height, side="right") - 1
    j = np.searchsorted(HIDDEN, hidden, side="right") - 1
    octaves = np.log2(height / 30)
    features = np.stack((np.ones(len(rows)), octaves, np.minimum(octaves, 0), hidden), axis=1)
    counts = np.array([[((i == a) & (j == b)).sum() for b in range(len(HIDDEN))] for a in range(len(HEIGHTS_PX))])
    centres = np.log2(np.sqrt(np.multiply(HEIGHTS_PX, (*HEIGHTS_PX[1:], 200.0))) / 30)
    middles = np.array([0.0, 0.25, 0.5])
    tables = []
    for threshold in THRESHOLDS:
        found = best >= threshold
        weights = fit_logistic(features, found)
        z = weights[0] + weights[1] * centres + weights[2] * np.minimum(centres, 0)
        expected = 1 / (1 + np.exp(-(z[:, None] + weights[3] * middles[None, :])))
        hits = np.array(
            [[found[(i == a) & (j == b)].sum() for b in range(len(HIDDEN))] for a in range(len(HEIGHTS_PX))]
        )
        tables.append((hits + PRIOR_LOOKS * expected) / (counts + PRIOR_LOOKS))
    falling = np.minimum.accumulate(np.array(tables), axis=0)  # a higher threshold finds no more
    return counts.tolist(), np.clip(falling, 0.001, 0.999).round(4).tolist()


def found_again(looks: ConeLooks) -> tuple[int, list[float]]:
    """Lookalikes that could become a track, and P(box >= threshold in a look | REFERENCE reached in two other looks).

    A track has three positions at least: only recurring lookalikes must be distinguished from cones.
    """
    table = np.array(looks.lookalikes).reshape(-1, 5)
    by_thing = [table[table[:, 1] == thing, 4] for thing in np.unique(table[:, 1])]
    by_thing = [scores for scores in by_thing if (scores >= REFERENCE).sum() >= 2]
    judged = [s[k] for s in by_thing for k in range(len(s)) if (np.delete(s, k) >= REFERENCE).sum() >= 2]
    best = np.array(judged)
    return len(by_thing), [round(float(((best >= t).sum() + 0.5) / (len(best) + 1)), 4) for t in THRESHOLDS]


def false_box_rates(looks: ConeLooks) -> tuple[list[int], list[list[float]]]:
    """Images, and boxes on no cone per image by threshold and height (Gamma prior of half a box)."""
    exact = np.array(looks.exact)
    pictures = [int(exact.sum()) if low < 20 else len(exact) for low in HEIGHTS_PX]
    rows = np.array(looks.false_boxes).reshape(-1, 2)
    ends = (*HEIGHTS_PX[1:], np.inf)
    return pictures, [
        [
            round(float((((rows[:, 0] >= a) & (rows[:, 0] < b) & (rows[:, 1] >= t)).sum() + 0.5) / max(n, 1)), 5)
            for a, b, n in zip(HEIGHTS_PX, ends, pictures, strict=True)
        ]
        for t in THRESHOLDS
    ]


def look_ratios(looks: ConeLooks, evidence: DetectorEvidence) -> dict[str, list[np.ndarray]]:
    """Per cone in plain view and per lookalike: (N, 2) log-likelihood ratio of each look, as `tracking/existence.py` takes it,
    and the logarithm to base 2 of the apparent height."""
    params = IngestParams()
    least, threshold = params.reconcile.visible_min_height_px, params.detection.score_threshold
    tables = {
        "cones": np.array([(r[1], r[3], r[5]) for r in looks.cones if r[2] < len(SCALES) and r[4] < HIDDEN[1]]),
        "lookalikes": np.array([(r[1], r[3], r[4]) for r in looks.lookalikes]).reshape(-1, 3),
    }

    def ratio(height_px: float, score: float) -> float:
        if score < threshold:
            return miss_log_ratio(evidence, height_px, 0.0, threshold)
        return box_log_ratio(evidence, score, height_px, 0.0, params.track.score_doubt)

    ratios: dict[str, list[np.ndarray]] = {}
    for kind, table in tables.items():
        ratios[kind] = []
        for thing in np.unique(table[:, 0]):
            rows = table[(table[:, 0] == thing) & (table[:, 1] >= least)]
            # What never got a box never becomes a track: it is no part of the question.
            if len(rows) >= 3 and (rows[:, 2] >= threshold).any():
                ratios[kind].append(np.array([(ratio(h, s), np.log2(h)) for _, h, s in rows.tolist()]))
    return ratios


def fit_correlation(cones: list[np.ndarray]) -> ImageCorrelation:
    """Correlation of the ratios of two looks at one cone over the octaves between them.

    It stands for lookalikes, too: a few dozen are too few to say, and what they say is less: this errs to the safe side.
    """
    return correlation_over_octaves(*pairs_of_looks(standardised(cones)))


def standardised(things: list[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each thing the ratios of its looks, less the mean of all and over their standard deviation, and the octaves."""
    ratios = np.concatenate(things)[:, 0]
    return [((thing[:, 0] - ratios.mean()) / ratios.std(), thing[:, 1]) for thing in things]


def fit_miss_correlation(looks: ConeLooks, evidence: DetectorEvidence) -> tuple[ImageCorrelation, list[float]]:
    """Correlation of the misses of two looks at one cone in plain view over the octaves between them, and by half octaves.

    Each miss is taken against its probability at that apparent height, over its standard deviation (as Pearson residuals are).
    """
    params = IngestParams()
    least, threshold = params.reconcile.visible_min_height_px, params.detection.score_threshold
    rows = np.array([r for r in looks.cones if r[2] < len(SCALES) and r[4] < HIDDEN[1] and r[3] >= least])
    missed = 1 - np.array([detect_probability(evidence, height_px, 0.0, threshold) for height_px in rows[:, 3]])
    residuals = ((rows[:, 5] < threshold) - missed) / np.sqrt(missed * (1 - missed))
    by_cone = [rows[:, 1] == cone for cone in np.unique(rows[:, 1])]
    between, product = pairs_of_looks([(residuals[own], np.log2(rows[own, 3])) for own in by_cone])
    return correlation_over_octaves(between, product), by_half_octaves(between, product)


def pairs_of_looks(things: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Of every two looks at one thing the octaves between them and the product of their values.

    things: values (N,), in standard deviations from their mean, and logarithms to base 2 of the apparent heights (N,).
    """
    pairs = [
        (abs(height - heights[j]), value * values[j])
        for values, heights in things for i, (value, height) in enumerate(zip(values, heights, strict=True)) for j in range(i)
    ]  # fmt: skip
    octaves, products = np.array(pairs).reshape(-1, 2).T
    return octaves, products


def by_half_octaves(octaves: np.ndarray, products: np.ndarray) -> list[float]:
    parts = [products[(octaves >= low) & (octaves < low + 0.5)] for low in (0.0, 0.5, 1.0)]
    return [round(float(part.mean()), 2) for part in parts if len(part)]


def correlation_over_octaves(octaves: NDArray[np.float64], products: NDArray[np.float64]) -> ImageCorrelation:
    """Least squares on the products of all pairs of looks."""

    def residuals(p: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(p[0] * (p[1] + (1 - p[1]) * np.exp(-octaves / p[2])) - products)

    near, share, decay = least_squares(residuals, (0.8, 0.5, 0.5), bounds=((0.05, 0.0, 0.1), (0.98, 1.0, 3.0))).x
    return ImageCorrelation(
        near=round(float(near), 3), far=round(float(near * share), 3), decay_octaves=round(float(decay), 3)
    )


def fit_joint_scale(ratios: dict[str, list[np.ndarray]], evidence: DetectorEvidence) -> float:
    """The factor on the joint ratio of a thing's looks that tells cones from lookalikes with the least log loss.

    Both kinds weigh alike: the odds before any look are not its business. Without it looks that are bounded, or far from
    Gaussian, would be believed too little or too much when they are put together.
    """
    joint = {
        kind: np.array([joint_log_ratio(evidence, thing[:, 0], 2 ** thing[:, 1]) for thing in things])
        for kind, things in ratios.items()
    }

    def loss(scale: float) -> float:
        wrong = np.logaddexp(0, -scale * joint["cones"]).mean() + np.logaddexp(0, scale * joint["lookalikes"]).mean()
        return float(wrong)

    return round(float(minimize_scalar(loss, bounds=(0.2, 4.0), method="bounded").x), 3)


def measure(
    looks: ConeLooks, folds: np.ndarray, sha256: str
) -> tuple[DetectorEvidence, dict[str, np.ndarray], dict[str, Any]]:
    calibration, held_out, figures = compare_calibrations(looks, folds)
    counts, detected = detection_tables(looks)
    lookalikes, again = found_again(looks)
    pictures, rates = false_box_rates(looks)
    above = [truth for _, _, score, truth in looks.boxes if score >= REFERENCE]
    values = {
        "model_sha256": sha256, "match_iou": MATCH_IOU, "calibration": calibration, "reference_score": REFERENCE,
        "true_boxes": sum(above), "false_boxes": max(len(above) - sum(above), 1), "score_thresholds": THRESHOLDS,
        "height_bands_px": HEIGHTS_PX, "hidden_bands": HIDDEN, "hidden_most": HIDDEN_MOST, "looks": counts,
        "detected": detected, "lookalikes": lookalikes, "found_again": again, "false_box_pictures": pictures,
        "false_boxes_per_picture": rates, "look_correlation": UNMEASURED.look_correlation, "joint_scale": 1.0,
    }  # fmt: skip
    ratios = look_ratios(looks, DetectorEvidence.model_validate(values))
    values["look_correlation"] = fit_correlation(ratios["cones"])
    values["miss_correlation"], steps_of_misses = fit_miss_correlation(looks, DetectorEvidence.model_validate(values))
    figures["correlation of two misses of a cone, by half octaves between them"] = steps_of_misses
    values["joint_scale"] = fit_joint_scale(ratios, DetectorEvidence.model_validate(values))
    for kind, things in ratios.items():
        if not things:
            continue
        means = [float(thing[:, 0].mean()) for thing in things]
        figures[f"mean log-likelihood ratio of a look, {kind}"] = {
            "things": len(means),
            **{f"{q} %": round(float(np.percentile(means, q)), 2) for q in (5, 25, 50, 75, 95)},
            "correlation of two looks, by half octaves between them": by_half_octaves(
                *pairs_of_looks(standardised(things))
            ),
        }
    return DetectorEvidence.model_validate(values), held_out, figures


def sidecar_text(card: dict[str, Any]) -> str:
    """JSON with one line for each innermost list."""
    text = json.dumps(card, indent=2)
    return re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", lambda m: "[" + re.sub(r",\s+", ", ", m[1]) + "]", text) + "\n"
