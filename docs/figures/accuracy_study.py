"""Makes the figures of the study of accuracy (benchmarks/RESULTS.md) and prints its tables: python docs/figures/accuracy_study.py

Needs Mitsuba (the extra `simulate`) for the rendered cone. Names of parts (range, calibration, frames, sides, render)
make only those.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from scipy import stats

from conetl.geometry.calibration.covariance import calibration_jacobian
from docs.figures import accuracy_cases as cases
from docs.figures import accuracy_render as rendered
from docs.figures.paper_rig import BASELINE_M, SIGMAS, paper_rig

DOCS = Path(__file__).parents[1]
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
RANGES_M = np.geomspace(3.0, 30.0, 25)
DOTS_M = np.array([3.0, 5.0, 8.53, 15.0, 30.0])
BASELINES_M = (0.10, BASELINE_M, 0.40, 0.60)
NOISE_PX = (0.1, 0.3, 1.0)
USUAL_PX = 0.3
MOTION_M = 0.01
AROUND = {
    "1 station": [0.0],
    "2, 30° apart": [0.0, 30.0],
    "2, 90° apart": [0.0, 90.0],
    "4 all round": [0.0, 90.0, 180.0, 270.0],
}
#: What the calibration's parameters are called in the figure, in the order of their weight.
GROUPS = {
    "principal points": ("left.cx_px", "right.cx_px", "left.cy_px", "right.cy_px"),
    "phi (about the vertical)": ("relative.ry_rad",),
    "focal lengths": ("left.fx_px", "right.fx_px", "left.fy_px", "right.fy_px"),
    "kappa (about the sight)": ("relative.rz_rad",),
    "base": ("relative.tx_m", "relative.ty_m", "relative.tz_m"),
    "omega (about the base)": ("relative.rx_rad",),
}


def over_range() -> str:
    """Range, baseline and pixel noise with exact calibration; and with the paper's calibration."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4.0), sharey=True, layout="constrained")
    rows = []
    for colour, baseline in zip(COLOURS, BASELINES_M, strict=False):
        rig = paper_rig(baseline_m=baseline)
        label = f"baseline {100 * baseline:.3g} cm"
        _curve(left, rig, USUAL_PX, colour, label)
        spreads = [cases.image_noise(rig, cases.foot_at(r), USUAL_PX, _rng()) for r in DOTS_M]
        rows.append([label, *(f"{_cm(s.analytic_m[0])} / {_cm(s.monte_carlo_m[0])}" for s in spreads)])
    left.set_title(f"exact calibration, {USUAL_PX} px, by baseline", fontsize=10)
    rig = paper_rig()
    for colour, noise in zip(COLOURS, NOISE_PX, strict=False):
        _curve(right, rig, noise, colour, f"{noise:g} px")
        if noise != USUAL_PX:
            spreads = [cases.image_noise(rig, cases.foot_at(r), noise, _rng()) for r in DOTS_M]
            rows.append(
                [
                    f"baseline 27.5 cm, {noise:g} px",
                    *(f"{_cm(s.analytic_m[0])} / {_cm(s.monte_carlo_m[0])}" for s in spreads),
                ]
            )
    spreads = [cases.calibration_and_noise(rig, cases.foot_at(r), USUAL_PX, _rng()) for r in DOTS_M]
    total = [
        cases.calibration_and_noise(rig, cases.foot_at(r), USUAL_PX, _rng(), draws=2).analytic_m[0] for r in RANGES_M
    ]
    right.plot(RANGES_M, total, "--", color="black", label=f"{USUAL_PX} px and the paper's calibration")
    right.plot(DOTS_M, [s.monte_carlo_m[0] for s in spreads], "o", color="black", ms=4)
    rows.append(
        ["with the paper's calibration", *(f"{_cm(s.analytic_m[0])} / {_cm(s.monte_carlo_m[0])}" for s in spreads)]
    )
    right.set_title("the paper's rig, by pixel noise", fontsize=10)
    for ax in (left, right):
        ax.set(xscale="log", yscale="log", xlabel="ground distance (m)")
        ax.set_xticks([3, 5, 10, 20, 30], labels=["3", "5", "10", "20", "30"])
        ax.set_yticks([0.001, 0.01, 0.1, 1.0, 10.0], labels=["1 mm", "1 cm", "10 cm", "1 m", "10 m"])
        ax.minorticks_off()
        ax.grid(color="#e5e5e5")
        ax.set_axisbelow(True)
    left.legend(fontsize=8, loc="lower right")
    right.legend(fontsize=8, loc="upper left")
    left.set_ylabel("sigma along the sight, one pair\n(lines: covariance, dots: Monte Carlo)")
    _save(figure, "accuracy_range.png")
    return _table(["sigma along the sight, cm: covariance / Monte Carlo", *(f"{r:g} m" for r in DOTS_M)], rows)


def calibration() -> str:
    """What each calibration parameter costs at 8.53 m, and whether the stated intervals hold."""
    rig, point = paper_rig(), cases.paper_point()
    jacobian = calibration_jacobian(point[None], rig)[0]
    parts = dict(zip(SIGMAS, np.abs(jacobian.T @ [0.0, 0.0, 1.0]) * list(SIGMAS.values()), strict=True))
    figure, (bars, hist) = plt.subplots(1, 2, figsize=(9.5, 3.2), width_ratios=(1.25, 1), layout="constrained")
    image = cases.image_noise(rig, point, USUAL_PX, _rng()).analytic_m[0]
    shares = {name: float(np.linalg.norm([parts[p] for p in members])) for name, members in GROUPS.items()}
    shares[f"image points, {USUAL_PX} px"] = float(image)
    names = sorted(shares, key=lambda name: shares[name])
    bars.barh(
        names, [100 * shares[name] for name in names], color=[COLOURS[0] if "px" in n else COLOURS[1] for n in names]
    )
    for k, name in enumerate(names):
        bars.text(100 * shares[name] + 0.6, k, f"{100 * shares[name]:.1f} cm", va="center", fontsize=8)
    bars.set(xlabel="sigma along the sight at 8.53 m (cm)", xlim=(0, 1.25 * 100 * max(shares.values())))
    bars.tick_params(labelsize=8)
    rows = []
    for noise in NOISE_PX:
        spread = cases.calibration_and_noise(rig, point, noise, _rng(), draws=2000)
        both = zip(spread.analytic_m, spread.monte_carlo_m, strict=True)
        shares_in = [f"{100 * share:.1f} %" for share in spread.inside_95]
        rows.append([f"{noise:g} px", *(f"{_cm(a)} / {_cm(b)}" for a, b in both), *shares_in])
    spread = cases.calibration_and_noise(rig, point, USUAL_PX, _rng(), draws=2000)
    x = np.linspace(-4, 4, 200)
    hist.hist(
        spread.normalised_along,
        np.linspace(-4, 4, 41),
        density=True,
        color=COLOURS[0],
        alpha=0.6,
        label="2,000 drawn rigs",
    )
    hist.plot(x, stats.norm.pdf(x), color="black", label="standard normal")
    hist.set(xlabel="range error / its stated sigma", yticks=[])
    hist.legend(fontsize=8)
    _save(figure, "accuracy_calibration.png")
    head = [
        "image noise",
        "along: sigma / Monte Carlo, cm",
        "across",
        "up",
        "95 % holds: along",
        "across",
        "up",
        "ellipsoid",
    ]
    return _table(head, rows)


def frames() -> str:
    """One frame pair against many of a drive past the cone."""
    rig = paper_rig()
    exact = rig.model_copy(update={"calibration_covariance": None})
    counts = (1, 2, 3, 5, 8, 12, 20, 30)
    lines: dict[str, list[cases.Spread]] = {
        "image points alone": [], "and 1 cm of position per frame": [], "image points and the paper's calibration": [],
    }  # fmt: skip
    for count in counts:
        poses, point = cases.passing(count)
        lines["image points alone"].append(cases.exact_stations(exact, point, USUAL_PX, _rng(), poses))
        lines["and 1 cm of position per frame"].append(
            cases.adjusted_drive(exact, point, USUAL_PX, MOTION_M, _rng(), poses, draws=200)
        )
        lines["image points and the paper's calibration"].append(
            cases.calibration_and_noise(rig, point, USUAL_PX, _rng(), poses=poses, draws=400)
        )
    figure, ax = plt.subplots(figsize=(6.2, 3.6), layout="constrained")
    rows = []
    for colour, (name, spreads) in zip(COLOURS, lines.items(), strict=False):
        sigma = [float(np.linalg.norm(s.analytic_m)) for s in spreads]
        errors = [float(np.linalg.norm(s.monte_carlo_m)) for s in spreads]
        ax.plot(counts, sigma, color=colour, label=name)
        ax.plot(counts, errors, "o", color=colour, ms=4)
        rows.append([name, *(f"{_cm(a)} / {_cm(b)}" for a, b in zip(sigma, errors, strict=True))])
    first = float(np.linalg.norm(lines["image points alone"][0].analytic_m))
    ax.plot(counts, first / np.sqrt(counts), ":", color=COLOURS[0], label="first one / square root of their number")
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="frame pairs, the nearest 6 m and the farthest 20 m before the cone",
        ylabel="3D sigma",
    )
    ax.set_xticks(counts, labels=[str(n) for n in counts])
    ax.set_yticks([0.001, 0.01, 0.1], labels=["1 mm", "1 cm", "10 cm"])
    ax.minorticks_off()
    ax.grid(color="#e5e5e5")
    ax.legend(fontsize=8)
    _save(figure, "accuracy_frames.png")
    return _table(["3D, cm: covariance / Monte Carlo", *(f"{n} pairs" if n > 1 else "1 pair" for n in counts)], rows)


def sides() -> str:
    """The cone from several stations around it, and off the axis."""
    rig = paper_rig()
    figure, axes = plt.subplots(1, 4, figsize=(9.5, 3.0), layout="constrained")
    rows = []
    for ax, (name, angles) in zip(axes, AROUND.items(), strict=True):
        poses = cases.around(8.53, np.radians(angles).tolist())
        exact = cases.exact_stations(rig, cases.paper_point(), USUAL_PX, _rng(), poses)
        full = cases.calibration_and_noise(rig, cases.paper_point(), USUAL_PX, _rng(), poses=poses, draws=1000)
        for colour, spread in ((COLOURS[1], full), (COLOURS[0], exact)):
            _ellipse(ax, spread.expected_cov_m2[np.ix_([0, 2], [0, 2])], colour)
        reach = 2.6 * 100 * float(np.sqrt(np.linalg.eigvalsh(full.expected_cov_m2)[-1]))
        ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        ax.set_title(name, fontsize=10)
        ax.tick_params(labelsize=7)
        ax.grid(color="#eeeeee")
        ax.set_axisbelow(True)
        rows.append([name, *(_cm(float(np.linalg.norm(s))) for s in
                             (exact.analytic_m, exact.monte_carlo_m, full.analytic_m, full.monte_carlo_m))])  # fmt: skip
    for bearing in (15, 30):
        point = cases.foot_at(8.53, np.radians(bearing))
        exact = cases.image_noise(rig, point, USUAL_PX, _rng())
        full = cases.calibration_and_noise(rig, point, USUAL_PX, _rng(), draws=1000)
        rows.append([f"1 station, {bearing}° off the axis", *(_cm(float(np.linalg.norm(s))) for s in
                     (exact.analytic_m, exact.monte_carlo_m, full.analytic_m, full.monte_carlo_m))])  # fmt: skip
    axes[0].set_ylabel("ahead (cm)", fontsize=8)
    for ax in axes:
        ax.set_xlabel("to the right (cm)", fontsize=8)
    handles = [
        Line2D([], [], color=COLOURS[0], label="image points"),
        Line2D([], [], color=COLOURS[1], label="and calibration"),
    ]
    figure.legend(handles=handles, fontsize=8, loc="outside upper center", ncols=2)
    _save(figure, "accuracy_sides.png")
    head = [
        "stations at 8.53 m",
        "image points: 3D sigma, cm",
        "Monte Carlo",
        "and calibration: 3D sigma, cm",
        "Monte Carlo",
    ]
    return _table(head, rows)


def rendered_cone() -> str:
    """The paper's case through detector, matching and intersection."""
    return rendered.study(DOCS / "images" / "accuracy_render.png")


def _curve(ax: Axes, rig: cases.Rig, noise: float, colour: str, label: str) -> None:
    sigma = [cases.image_noise(rig, cases.foot_at(r), noise, _rng(), draws=2).analytic_m[0] for r in RANGES_M]
    ax.plot(RANGES_M, sigma, color=colour, label=label)
    dots = [cases.image_noise(rig, cases.foot_at(r), noise, _rng()).monte_carlo_m[0] for r in DOTS_M]
    ax.plot(DOTS_M, dots, "o", color=colour, ms=4)


def _ellipse(ax: Axes, cov_m2: np.ndarray, colour: str) -> None:
    values, vectors = np.linalg.eigh(cov_m2)
    width, height = 2 * 100 * np.sqrt(stats.chi2.ppf(0.95, 2) * values)
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    ax.add_patch(Ellipse((0, 0), width, height, angle=angle, fill=False, color=colour, lw=1.6))


def _rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


def _cm(metres: float) -> str:
    return f"{100 * metres:.3g}"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _save(figure: plt.Figure, name: str) -> None:
    figure.savefig(DOCS / "images" / name, dpi=80)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parts = {"range": over_range, "calibration": calibration, "frames": frames, "sides": sides, "render": rendered_cone}
    parser.add_argument("parts", nargs="*", choices=[*parts, []], help="parts of the page; default: all")
    wanted = parser.parse_args().parts or list(parts)
    for name in wanted:
        started = time.monotonic()
        print(f"{parts[name]()}\n\n{name}: {time.monotonic() - started:.1f} s\n", flush=True)


if __name__ == "__main__":
    main()
