"""What the scores of a model mean: calibration, P(detect | height, hidden), false boxes; into its sidecar.

    python -m training.calibrate_scores MODEL.onnx --cones DIR [--more-cones DIR --left-out NAMES [--clips DIR]]
        [--labelled DIR] [--cone-free DIR] [--json OUT] [--write]

Run it after `quantise.py`, on images that took no part in training. `--left-out` names sources and clips as for `train.py`:
with them, scores mean something away from the training sources, too. With `--clips` the false boxes of the other classes are
counted on the clips left out. `--labelled` names renders (images/, labels/) with exact
labels, `--cone-free` a folder of images without any cone. With `--write` the figures go into `MODEL.onnx.json` and the
reliability curve beside the model, `MODEL.reliability.png`; the text for the model card is printed.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression, least_squares, minimize, minimize_scalar
from scipy.stats import chi2

from conetl.model.detector_evidence import (
    UNMEASURED,
    DetectorEvidence,
    ImageCorrelation,
    ScoreCalibration,
    box_log_ratio,
    calibrated_probability,
    detect_probability,
    joint_log_ratio,
    miss_log_ratio,
)
from conetl.model.feature_classes import CONE
from conetl.model.params import IngestParams
from conetl.perception.detector import Detector, detect_image, load_detector
from conetl.perception.model_card import read_model_card
from training.classes import CLASSES
from training.dataset import Image, read_cones, read_left_out, read_renders
from training.evaluate import at_score, left_out_clips, of_class
from training.looks import LEAST_SCORE, MATCH_IOU, SCALES, Looks, look_at_pictures
from training.reliability import expected_calibration_error, write_reliability_figure

THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
REFERENCE = 0.3
HEIGHTS_PX = (8.0, 12.0, 16.0, 20.0, 30.0, 60.0)
HIDDEN = (0.0, 0.125, 0.375)
HIDDEN_MOST = 0.625
FOLDS = 5
#: A cell of the detection table begins with this many looks of the smooth fit's opinion.
PRIOR_LOOKS = 8.0
#: A way with more parameters must be better than the next simpler one by this share of the log loss.
WORTHWHILE = 0.01


def logit(p: np.ndarray | float) -> np.ndarray:
    p = np.clip(p, 1e-4, 1 - 1e-4)
    return np.asarray(np.log(p / (1 - p)))


def fit_logistic(features: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Weights (K,) of a logistic regression of truth (N,) on features (N, K), with a ridge of 0.01 that keeps them finite."""

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        z = features @ weights
        slope = features.T @ (1 / (1 + np.exp(-z)) - truth) + 0.01 * weights
        return float(np.logaddexp(0, z).sum() - z @ truth + 0.005 * weights @ weights), slope

    return np.asarray(minimize(loss, np.zeros(features.shape[1]), jac=True, method="BFGS").x)


def fit_platt(scores: np.ndarray, truth: np.ndarray) -> ScoreCalibration:
    """Straight line on log-odds; targets softened as Platt (1999) does, so that no probability becomes 0 or 1."""
    yes, no = truth.sum(), (~truth).sum()
    soft = np.where(truth, (yes + 1) / (yes + 2), 1 / (no + 2))
    offset, scale = fit_logistic(np.stack((np.ones(len(scores)), logit(scores)), axis=1), soft)
    # A straight line ends where its probability leaves what a number in the sidecar can hold.
    ends = np.clip(sorted((np.array([-8.5, 8.5]) - offset) / scale), logit(0.001), logit(0.999))
    return _calibration("platt", ends, offset + scale * ends)


def fit_beta(scores: np.ndarray, truth: np.ndarray) -> ScoreCalibration:
    """Log-odds as a weighted sum of log s and -log(1 - s) (Kull, Silva Filho & Flach 2017); knots evenly on the log-odds of s."""
    least, most = logit(scores.min()), logit(scores.max())
    knots = np.linspace(float(least), float(most), 33)

    def features(s: np.ndarray) -> np.ndarray:
        return np.stack((np.ones(len(s)), np.log(s), -np.log1p(-s)), axis=1)

    weights = fit_logistic(features(np.clip(scores, 1e-4, 1 - 1e-4)), truth.astype(float))
    lines = np.maximum.accumulate(features(1 / (1 + np.exp(-knots))) @ weights)
    return _calibration("beta", knots, np.clip(lines, -8.5, 8.5))


def fit_isotonic(scores: np.ndarray, truth: np.ndarray) -> ScoreCalibration:
    """Isotonic regression; each step's share is (k + 1/2) / (n + 1), so that none is 0 or 1, its knot at the mean log-odds."""
    order = np.argsort(scores, kind="stable")
    steps = isotonic_regression(truth[order].astype(float)).x
    groups = np.split(order, np.flatnonzero(np.diff(steps)) + 1)
    knots = np.array([logit(scores[group]).mean() for group in groups])
    shares = np.array([(truth[group].sum() + 0.5) / (len(group) + 1) for group in groups])
    apart = np.concatenate(([True], np.diff(knots) > 1e-3))
    return _calibration("isotonic", knots[apart], logit(np.maximum.accumulate(shares)[apart]))


def _calibration(method: str, score_logits: np.ndarray, probability_logits: np.ndarray) -> ScoreCalibration:
    scores, probabilities = (1 / (1 + np.exp(-v)) for v in (score_logits, probability_logits))
    return ScoreCalibration.model_validate(
        {"method": method, "scores": scores.round(6).tolist(), "probabilities": probabilities.round(6).tolist()}
    )


def apply(calibration: ScoreCalibration, scores: np.ndarray) -> np.ndarray:
    return np.array([calibrated_probability(calibration, float(s)) for s in scores])


def folds_of(pictures: list[Image]) -> np.ndarray:
    """Fold (N,) of each image: neighbours by name, which may be frames of one film or views of one scene, stay together."""
    folds = np.zeros(len(pictures), dtype=int)
    for source in sorted({p.source for p in pictures}):
        ours = sorted((k for k, p in enumerate(pictures) if p.source == source), key=lambda k: pictures[k].name)
        for fold, part in enumerate(np.array_split(ours, FOLDS)):
            folds[part] = fold
    return folds


def log_loss(probabilities: np.ndarray, truth: np.ndarray) -> float:
    p = np.clip(probabilities, 1e-6, 1 - 1e-6)
    return float(-np.where(truth, np.log(p), np.log1p(-p)).mean())


def compare_calibrations(
    looks: Looks, folds: np.ndarray
) -> tuple[ScoreCalibration, dict[str, np.ndarray], dict[str, Any]]:
    """The better kind fitted on all boxes, the held-out probabilities of each kind, and their figures."""
    picture, _, scores, truth = (np.array(column) for column in zip(*looks.boxes, strict=True))
    fits = {"platt": fit_platt, "beta": fit_beta, "isotonic": fit_isotonic}  # by their number of parameters
    held_out = {"score": scores} | {name: np.zeros(len(scores)) for name in fits}
    for fold in range(FOLDS):
        test = folds[picture] == fold
        for name, fit in fits.items():
            held_out[name][test] = apply(fit(scores[~test], truth[~test]), scores[test])
    figures: dict[str, Any] = {}
    for least in (LEAST_SCORE, REFERENCE):
        chosen = scores >= least
        figures[f"boxes from score {least}"] = {"boxes": int(chosen.sum()), "on a cone": int(truth[chosen].sum())} | {
            name: {
                "ece": round(expected_calibration_error(p[chosen], truth[chosen]), 4),
                "brier": round(float(np.mean((p[chosen] - truth[chosen]) ** 2)), 4),
                "log_loss": round(log_loss(p[chosen], truth[chosen]), 4),
            }
            for name, p in held_out.items()
        }
    losses = {name: log_loss(held_out[name], truth) for name in fits}
    best = "platt"
    for name in ("beta", "isotonic"):
        if losses[name] < (1 - WORTHWHILE) * losses[best]:
            best = name
    return fits[best](scores, truth), held_out, figures


def detection_tables(looks: Looks) -> tuple[list[list[int]], list[list[list[float]]]]:
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


def found_again(looks: Looks) -> tuple[int, list[float]]:
    """Lookalikes that could become a track, and P(box >= threshold in a look | REFERENCE reached in two other looks).

    A track has three positions at least: only recurring lookalikes must be distinguished from cones.
    """
    table = np.array(looks.lookalikes).reshape(-1, 5)
    by_thing = [table[table[:, 1] == thing, 4] for thing in np.unique(table[:, 1])]
    by_thing = [scores for scores in by_thing if (scores >= REFERENCE).sum() >= 2]
    judged = [s[k] for s in by_thing for k in range(len(s)) if (np.delete(s, k) >= REFERENCE).sum() >= 2]
    best = np.array(judged)
    return len(by_thing), [round(float(((best >= t).sum() + 0.5) / (len(best) + 1)), 4) for t in THRESHOLDS]


def false_box_rates(looks: Looks) -> tuple[list[int], list[list[float]]]:
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


def look_ratios(looks: Looks, evidence: DetectorEvidence) -> dict[str, list[np.ndarray]]:
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


def fit_miss_correlation(looks: Looks, evidence: DetectorEvidence) -> tuple[ImageCorrelation, list[float]]:
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
    looks: Looks, folds: np.ndarray, sha256: str
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


def model_card_text(evidence: DetectorEvidence, figures: dict[str, Any]) -> str:
    """The tables for the model card, in Markdown."""
    lines = ["| apparent height px | " + " | ".join(f"hidden {h}" for h in ("0-12 %", "12-37 %", "37-62 %")) + " |"]
    lines.append("|---" * 4 + "|")
    k = evidence.score_thresholds.index(REFERENCE)
    ends = [f"{high:g}" for high in evidence.height_bands_px[1:]] + [""]
    for i, (low, high) in enumerate(zip(evidence.height_bands_px, ends, strict=True)):
        cells = [
            f"{evidence.detected[k][i][j]:.2f} ({evidence.looks[i][j]})" for j in range(len(evidence.hidden_bands))
        ]
        lines.append(f"| {low:g}-{high} | " + " | ".join(cells) + " |")
    return "\n".join((f"P(detect at {REFERENCE}) (looks)", *lines, json.dumps(figures, indent=1)))


def false_box_bounds(detector: Detector, clips: list[Image]) -> dict[str, float]:
    """Boxes on no object per image, of each class but the cone: the upper 95 % limit of the mean of a Poisson count."""
    names = [name for name in detector.card.class_names if name != CONE]
    found = [
        detect_image(detector, p.image, score_threshold=REFERENCE, single_image=True, categories=names) for p in clips
    ]
    bounds = {}
    for name in names:
        pairs = [of_class(p, boxes, CLASSES.index(name)) for p, boxes in zip(clips, found, strict=True)]
        rate = at_score([p for p, _ in pairs], [boxes for _, boxes in pairs], REFERENCE)["false_a_picture"]
        count = round(rate * len(clips))
        bounds[name] = round(float(chi2.ppf(0.95, 2 * (count + 1)) / 2 / len(clips)), 2)
    return bounds


def read_cone_free(folder: Path) -> list[Image]:
    images = ((path, cv2.imread(str(path))) for path in sorted(folder.iterdir()) if path.suffix in (".jpg", ".png"))
    return [Image(path.stem, "cone-free", image, np.zeros((0, 9))) for path, image in images if image is not None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--cones", type=Path, required=True)
    parser.add_argument("--more-cones", type=Path)
    parser.add_argument("--left-out", default="")
    parser.add_argument("--clips", type=Path)
    parser.add_argument("--labelled", type=Path)
    parser.add_argument("--cone-free", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    sidecar = args.model.with_name(args.model.name + ".json")
    card = json.loads(sidecar.read_text())
    card.pop("evidence", None)  # that of an earlier file would keep this one from loading
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / args.model.name
        copy.write_bytes(args.model.read_bytes())
        copy.with_name(copy.name + ".json").write_text(json.dumps(card))
        detector = load_detector(copy)
    pictures = read_cones(args.cones, "val")
    pictures += read_left_out(args.more_cones, args.left_out) if args.more_cones else []
    renders = read_renders(args.labelled, set()) if args.labelled else []
    pictures += [dataclasses.replace(p, boxes=p.boxes[p.boxes[:, 8] == CLASSES.index(CONE)]) for p in renders]
    pictures += read_cone_free(args.cone_free) if args.cone_free else []
    looks = look_at_pictures(
        pictures,
        lambda picture: picture.source in ("renders", "cone-free"),
        lambda image: detect_image(detector, image, score_threshold=LEAST_SCORE),
    )
    evidence, held_out, figures = measure(looks, folds_of(pictures), detector.card.sha256)
    if args.clips:
        clips = left_out_clips(args.clips, args.left_out)
        evidence = evidence.model_copy(update={"false_boxes_by_class": false_box_bounds(detector, clips)})
    print(model_card_text(evidence, figures))
    if args.json:
        args.json.write_text(json.dumps({"figures": figures, "evidence": evidence.model_dump()}, indent=2) + "\n")
    if args.write:
        sidecar.write_text(sidecar_text(card | {"evidence": evidence.model_dump(mode="json")}))
        read_model_card(args.model)
        truth = np.array([row[3] for row in looks.boxes])
        curve = args.model.with_suffix(".reliability.png")
        write_reliability_figure(
            curve, held_out["score"], held_out[evidence.calibration.method], truth, detector.card.name
        )
        print(f"{sidecar}, {curve}: written")


if __name__ == "__main__":
    main()
