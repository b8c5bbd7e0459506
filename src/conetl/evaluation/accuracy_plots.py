"""Plots of a drive against truth as PNG bytes: errors over range, plan with error vectors, NEES against chi-square."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from scipy import stats

from conetl.geometry.consistency import leave_one_out_nees
from conetl.model.arrays import Floats
from conetl.reports import figures

if TYPE_CHECKING:
    from conetl.evaluation.drive_evaluation import DriveEvaluation

_AXES = ("along the line of sight", "across it", "up")
_SCALES = (1, 2, 5, 10, 20, 50, 100)
#: Radius of the 95 % region of a two-dimensional normal distribution, in sigmas.
_ELLIPSE_SIGMAS = float(np.sqrt(stats.chi2.ppf(0.95, 2)))
_NEES_SHOWN = 16.0


def errors_over_range(evaluation: DriveEvaluation) -> bytes:
    """Signed errors of single positions and tracks (at their nearest range) along the line of sight, across it and up, with the
    stated two-sigma band of single positions."""
    tracks, singles = evaluation.tracks, evaluation.singles
    range_m, sigmas_m = singles.range_m, singles.sigma_in_sight_axes()
    errors_m, track_errors_m = (one.in_sight_axes(one.difference_m) for one in (singles, tracks))
    figure = figures.new_figure(9, 7.2, dpi=100)
    axes = figure.subplots(3, 1, sharex=True)
    order = np.argsort(range_m)
    for k, ax in enumerate(axes):
        low, middle, high = _band(range_m[order], sigmas_m[order, k])
        ax.fill_between(middle, 2 * low, 2 * high, color=figures.GREEN, alpha=0.25, linewidth=0)
        ax.fill_between(middle, -2 * high, -2 * low, color=figures.GREEN, alpha=0.25, linewidth=0)
        centre = (low + high) / 2
        for sign in (-1, 1):
            label = "stated 2 sigma of a single position" if sign == 1 else None
            ax.plot(middle, sign * 2 * centre, color=figures.GREEN, linewidth=1.5, label=label)
        ax.plot(
            range_m, errors_m[:, k], ".", color=figures.SKY, markersize=5, label=f"single positions ({len(range_m)})"
        )
        ax.plot(
            tracks.range_m, track_errors_m[:, k], "^", color=figures.ORANGE, markeredgecolor="white", markersize=8,
            label=f"tracks ({len(track_errors_m)})",
        )  # fmt: skip
        inside = float(np.mean(np.abs(errors_m[:, k]) <= 2 * sigmas_m[:, k])) if len(range_m) else float("nan")
        ax.axhline(0.0, color="#bbbbbb", linewidth=0.8, zorder=0)
        ax.set_ylabel(f"{_AXES[k]} (m)")
        ax.set_title(f"{inside:.0%} within 2 sigma", fontsize=9, loc="right")
        figures.add_grid(ax)
        _limit(ax, errors_m[:, k], np.append(2 * sigmas_m[:, k], np.abs(track_errors_m[:, k])))
    # Range errors grow with the square of the range: a logarithmic axis beyond 10 cm keeps small ones readable.
    axes[0].set_yscale("symlog", linthresh=0.1, linscale=1.5)
    axes[0].set_yticks(
        [-3, -1, -0.3, -0.1, 0, 0.1, 0.3, 1, 3], labels=["-3", "-1", "-.3", "-.1", "0", ".1", ".3", "1", "3"]
    )
    axes[0].set_ylabel(f"{_AXES[0]} (m)\nlogarithmic beyond 0.1")
    axes[0].set_title(f"{evaluation.drive_id}: errors over range", loc="left")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=3)
    axes[2].set_xlabel("ground distance from the left camera (m), nearest one of tracks")
    return figures.png(figure)


def error_plan(evaluation: DriveEvaluation) -> bytes:
    """Plan of the cones with error vectors and 95 % ellipses of the tracks, enlarged by the factor in the title; single positions
    as dots."""
    singles, path_m = evaluation.singles, evaluation.path_m
    errors_m, cov_m2 = evaluation.tracks.difference_m, evaluation.tracks.cov_m2
    truth_m = np.array([line.truth.xyz_m for line in evaluation.lines])
    found = np.array([line.feature is not None for line in evaluation.lines])
    false_m = np.array([track.xyz_m for track in evaluation.false]).reshape(-1, 3)
    origin = np.floor(np.vstack([path_m[:, :2], truth_m[:, :2]]).min(axis=0))
    scale = _scale(np.linalg.norm(errors_m[:, :2], axis=1), cov_m2)
    truth, path, false = (points[:, :2] - origin for points in (truth_m, path_m, false_m))
    shown = np.vstack([truth, path, false])
    low, high = shown.min(axis=0) - 3, shown.max(axis=0) + 3
    height = 10 * (high[1] - low[1]) / (high[0] - low[0]) + 0.8
    figure = figures.new_figure(10, float(np.clip(height, 3.5, 10)), dpi=100)
    ax = figure.add_subplot()
    ax.plot(path[:, 0], path[:, 1], color=figures.GREY, linewidth=1.5, label="path of the left camera")
    if len(singles.truth_m):
        dots = singles.truth_m[:, :2] - origin + scale * singles.difference_m[:, :2]
        label = f"single positions ({len(dots)})"
        ax.plot(dots[:, 0], dots[:, 1], ".", color=figures.SKY, alpha=0.45, markersize=3, label=label)
    for k, (at, error, cov) in enumerate(zip(truth[found], scale * errors_m[:, :2], cov_m2, strict=True)):
        values, vectors = np.linalg.eigh(cov[:2, :2])
        ax.add_patch(
            Ellipse(
                tuple(at + error), *(2 * _ELLIPSE_SIGMAS * scale * np.sqrt(values)),
                angle=float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0]))), fill=False,
                color=figures.ORANGE, linewidth=1.2, label="95 % ellipse of a track" if k == 0 else None,
            )
        )  # fmt: skip
        figures.draw_arrow(ax, at, at + error, figures.ORANGE, lw=1.5, shrinkA=0, shrinkB=0)
    ax.scatter(
        truth[found, 0], truth[found, 1], s=10, color=figures.BLACK, label=f"surveyed cones ({found.sum()} found)"
    )
    if (~found).any():
        label = f"missed ({(~found).sum()})"
        ax.scatter(truth[~found, 0], truth[~found, 1], s=60, facecolors="none", edgecolors=figures.BLACK, label=label)
    if len(false):
        ax.scatter(false[:, 0], false[:, 1], marker="x", s=60, color=figures.PINK, label=f"false ({len(false)})")
    for line, at in zip(evaluation.lines, truth, strict=True):
        ax.annotate(line.truth.cone_id, at, xytext=(6, -12), textcoords="offset points", fontsize=8)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal")
    figures.add_grid(ax)
    ax.set_xlabel(f"easting - {origin[0]:.0f} (m)")
    ax.set_ylabel(f"northing - {origin[1]:.0f} (m)")
    ax.set_title(f"{evaluation.drive_id}; errors and ellipses enlarged {scale} times")
    ax.legend(fontsize=8, loc="best")
    return figures.png(figure)


def nees_histogram(evaluation: DriveEvaluation) -> bytes:
    """Histogram of the NEES of single positions and tracks without the drive's common errors, and chi-square with 3."""
    single, tracks = (
        leave_one_out_nees(one.difference_m, one.joint_cov_m2()) for one in (evaluation.singles, evaluation.tracks)
    )
    figure = figures.new_figure(9, 4.2, dpi=100)
    ax = figure.add_subplot()
    edges = np.linspace(0.0, _NEES_SHOWN, 33)
    beyond = float(np.mean(single > _NEES_SHOWN)) if len(single) else 0.0
    if len(single):
        width = edges[1] - edges[0]
        counts, _ = np.histogram(single, edges)
        label = f"single positions ({len(single)}), mean {single.mean():.2f}"
        ax.bar(edges[:-1], counts / len(single) / width, width, align="edge", color=figures.SKY, alpha=0.7, label=label)
    x = np.linspace(0.0, _NEES_SHOWN, 400)
    ax.plot(
        x,
        stats.chi2.pdf(x, 3),
        color=figures.BLACK,
        linewidth=1.8,
        label="chi-square with 3 degrees of freedom (mean 3)",
    )
    low, high = (float(stats.chi2.ppf(tail, 3)) for tail in (0.025, 0.975))
    ax.axvspan(low, high, color=figures.GREEN, alpha=0.10, label="its 95 %")
    top = ax.get_ylim()[1]
    if len(tracks):
        ax.plot(
            np.minimum(tracks, _NEES_SHOWN), np.full(len(tracks), 0.04 * top), "^", color=figures.ORANGE, markeredgecolor="white",
            markersize=9, label=f"tracks ({len(tracks)}), mean {tracks.mean():.2f}",
        )  # fmt: skip
    if beyond:
        ax.text(0.995, 0.40, f"{beyond:.1%} of the single positions\nlie beyond {_NEES_SHOWN:.0f}", transform=ax.transAxes,
                ha="right", fontsize=8)  # fmt: skip
    ax.set_xlim(0, _NEES_SHOWN * 1.005)
    ax.set_xlabel("NEES of one estimate without the drive's common errors")
    ax.set_ylabel("density")
    ax.set_title(f"{evaluation.drive_id}: do the stated sigmas hold?")
    ax.legend(fontsize=8)
    return figures.png(figure)


def _band(range_m: Floats, sigma_m: Floats) -> tuple[Floats, Floats, Floats]:
    """10 % quantile of the stated sigmas, range, and 90 % quantile, of groups of neighbours in range."""
    groups = np.array_split(np.arange(len(range_m)), max(1, min(12, len(range_m) // 8)))
    groups = [g for g in groups if len(g)]
    low = np.array([np.quantile(sigma_m[g], 0.1) for g in groups])
    high = np.array([np.quantile(sigma_m[g], 0.9) for g in groups])
    return low, np.array([np.median(range_m[g]) for g in groups]), high


def _limit(ax: Axes, errors: Floats, others: Floats) -> None:
    """Limit the axis so that a blunder does not hide everything else; count what is outside."""
    if not len(errors):
        return
    top = 1.25 * max(float(np.quantile(np.abs(errors), 0.99)), float(np.quantile(others, 0.98)))
    ax.set_ylim(-top, top)
    outside = int(np.sum(np.abs(errors) > top))
    if outside:
        ax.text(0.99, 0.04, f"{outside} beyond the axis", transform=ax.transAxes, ha="right", fontsize=8)


def _scale(errors_m: Floats, cov_m2: Floats) -> int:
    """Factor that makes a typical error or ellipse about 1.5 m long."""
    if not len(errors_m):
        return 1
    usual = max(
        float(np.median(errors_m)), float(np.median(np.sqrt(np.linalg.eigvalsh(cov_m2[:, :2, :2])[:, 1]))), 1e-3
    )
    return max((s for s in _SCALES if s * usual <= 1.5), default=1)
