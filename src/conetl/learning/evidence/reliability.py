"""Reliability of probabilities: expected calibration error (Naeini et al. 2015) and the bins of its curve."""

from __future__ import annotations

import numpy as np

BINS = 10


def reliability_bins(probabilities: np.ndarray, truth: np.ndarray) -> list[tuple[float, float, int]]:
    """Mean probability, share that is true, and number, of each of ten equally wide bins that is not empty."""
    bins = np.minimum((probabilities * BINS).astype(int), BINS - 1)
    used = [bins == k for k in range(BINS) if (bins == k).any()]
    return [(float(probabilities[b].mean()), float(truth[b].mean()), int(b.sum())) for b in used]


def expected_calibration_error(probabilities: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance between said and true share, weighted by the number in each bin."""
    return sum(n * abs(said - true) for said, true, n in reliability_bins(probabilities, truth)) / len(truth)
