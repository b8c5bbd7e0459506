"""From a score to P(cone | box): Platt scaling, beta calibration or isotonic regression, the best on held-out folds."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression, minimize

from conetl.learning.evidence.looks import LEAST_SCORE, ConeLooks
from conetl.learning.evidence.reliability import expected_calibration_error
from conetl.learning.images import LabelledImage
from conetl.model.detector_evidence import ScoreCalibration, calibrated_probability

REFERENCE = 0.3
FOLDS = 5
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


def folds_of(pictures: list[LabelledImage]) -> np.ndarray:
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
    looks: ConeLooks, folds: np.ndarray
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
