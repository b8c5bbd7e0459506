"""Reliability of probabilities: expected calibration error (Naeini et al. 2015) and its curve."""

from __future__ import annotations

from pathlib import Path

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


def write_reliability_figure(path: Path, before: np.ndarray, after: np.ndarray, truth: np.ndarray, name: str) -> None:
    """Two curves, of the score as it is and of the held-out calibrated probability, with numbers of boxes below."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (top, below) = plt.subplots(
        2, 1, figsize=(4.6, 5.4), height_ratios=(4, 1), sharex=True, constrained_layout=True
    )
    top.plot((0, 1), (0, 1), color="0.7", linewidth=1)
    for values, label, colour, side in (
        (before, "score", "tab:orange", -1),
        (after, "calibrated, held out", "tab:blue", 1),
    ):
        said, true, number = (np.array(column) for column in zip(*reliability_bins(values, truth), strict=True))
        # Wilson interval of the share (95 %)
        z = 1.96
        middle = (true + z * z / (2 * number)) / (1 + z * z / number)
        half = z * np.sqrt(true * (1 - true) / number + z * z / (4 * number**2)) / (1 + z * z / number)
        bars = np.abs(np.stack((true - (middle - half), middle + half - true)))
        ece = expected_calibration_error(values, truth)
        top.errorbar(
            said, true, bars, color=colour, marker="o", markersize=4, capsize=2, label=f"{label}: ECE {ece:.3f}"
        )
        below.bar(said + 0.01 * side, number, width=0.02, color=colour)
    top.set(ylabel="share of boxes on a cone", ylim=(-0.02, 1.02), title=f"{name}: {len(truth)} boxes")
    top.legend(loc="lower right", frameon=False)
    below.set(xlabel="score, or probability", ylabel="boxes", xlim=(0, 1))
    figure.savefig(path, dpi=90)
    plt.close(figure)
