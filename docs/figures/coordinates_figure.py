"""Draws docs/images/coordinates.png, every frame of docs/reference/coordinates.md: python docs/figures/coordinates_figure.py"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle

BODY, CAMERA, MAP, CONE = "#1f6f8b", "#7a3e9d", "#444444", "#e8590c"


def axis(ax: Axes, at: tuple[float, float], to: tuple[float, float], name: str, colour: str) -> None:
    """One axis of a frame, with its name at the tip."""
    ax.annotate(
        "", xy=to, xytext=at, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
    )
    direction = np.subtract(to, at)
    place = np.array(to) + 0.16 * direction / np.linalg.norm(direction)
    ax.text(*place, name, color=colour, fontsize=9, ha="center", va="center")


def side_view(ax: Axes) -> None:
    ax.set_title("from the right: heights", fontsize=10, loc="left")
    ax.plot([-1.6, 7.3], [0, 0], color="#888888", lw=1.2)
    ax.add_patch(Rectangle((-1.2, 0.3), 2.6, 0.75, facecolor="#e9eef1", edgecolor="#9aa7ae"))
    for x in (-0.6, 0.8):
        ax.add_patch(Circle((x, 0.3), 0.3, facecolor="white", edgecolor="#9aa7ae"))
    imu, left = (0.0, 0.93), (1.08, 1.65)
    axis(ax, imu, (0.62, 0.93), "x", BODY)
    axis(ax, imu, (0.0, 1.75), "z", BODY)
    ax.text(-2.0, 1.3, "body (IMU):\nx forward, y left, z up", color=BODY, fontsize=9, ha="center")
    axis(ax, left, (1.85, 1.65), "z", CAMERA)
    axis(ax, left, (1.08, 1.2), "y", CAMERA)
    ax.text(1.15, 1.86, "left camera: x right, y down, z forward", color=CAMERA, fontsize=9, ha="left")
    ax.plot([imu[0], left[0]], [imu[1], left[1]], color=CAMERA, ls=":", lw=1.2)
    ax.text(0.38, 1.42, "lever\narm", color=CAMERA, fontsize=7.5, ha="center")
    x = 6.2
    ax.add_patch(Polygon([(x - 0.19, 0.05), (x + 0.19, 0.05), (x + 0.04, 0.7), (x - 0.04, 0.7)], facecolor=CONE))
    ax.add_patch(Rectangle((x - 0.26, 0), 0.52, 0.05, facecolor=CONE))
    ax.add_patch(Polygon([(x - 0.13, 0.28), (x + 0.13, 0.28), (x + 0.09, 0.46), (x - 0.09, 0.46)], facecolor="white"))
    for height, name, size in ((0.7, "tip", 5), (0.35, "box centre (the paper's point)", 5), (0.0, "foot = geom", 7)):
        ax.plot([left[0], x], [left[1], height], color=CONE, lw=0.6, alpha=0.7)
        ax.plot(x, height, "o", color="black", ms=size)
        ax.text(x + 0.34, height - (0.16 if height == 0 else 0), name, fontsize=9, va="center")
    ax.annotate("", xy=(left[0], -0.32), xytext=(x, -0.32), arrowprops={"arrowstyle": "<|-|>", "lw": 1})
    ax.text(3.6, -0.5, "range_m: level distance, left camera to foot", fontsize=9, ha="center")
    ax.set(xlim=(-3.3, 9.6), ylim=(-0.75, 2.2), aspect="equal")
    ax.axis("off")


def plan_view(ax: Axes) -> None:
    ax.set_title("from above: map, true north, body, rig", fontsize=10, loc="left")
    axis(ax, (-3.2, -2.0), (-1.8, -2.0), "E", MAP)
    axis(ax, (-3.2, -2.0), (-3.2, -0.5), "N (grid)", MAP)
    gamma = np.radians(14)
    axis(ax, (-3.2, -2.0), (-3.2 - 1.6 * np.sin(gamma), -2.0 + 1.6 * np.cos(gamma)), "", "#999999")
    ax.text(
        -3.2,
        -2.4,
        "map CRS; angle between the norths:\ngrid convergence (drawn too large)",
        fontsize=8,
        color=MAP,
        va="top",
    )
    ax.text(-3.7, -0.62, "true\nnorth", color="#888888", fontsize=9, ha="right", va="center")
    yaw = np.radians(28)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])

    def at(forward: float, left: float) -> tuple[float, float]:
        x, y = turn @ [forward, left]
        return float(x), float(y)

    ax.add_patch(
        Polygon([at(-1.2, 0.8), at(2.6, 0.8), at(2.6, -0.8), at(-1.2, -0.8)], facecolor="#e9eef1", edgecolor="#9aa7ae")
    )
    axis(ax, at(0, 0), at(1.4, 0), "x", BODY)
    axis(ax, at(0, 0), at(0, 1.1), "y left", BODY)
    ax.plot([0, 1.5], [0, 0], color="#999999", lw=0.8, ls="--")
    arc = np.linspace(0, yaw, 30)
    ax.plot(1.0 * np.cos(arc), 1.0 * np.sin(arc), color=BODY, lw=0.8)
    ax.text(1.06, 0.12, "yaw", color=BODY, fontsize=8)
    for name, side in (("left", 0.45), ("right", -0.45)):
        axis(ax, at(1.9, side), at(2.8, side), "z", CAMERA)
        ax.text(*at(2.25, side * 1.35), name, color=CAMERA, fontsize=8, ha="center", va="center", rotation=28)
        ax.plot(*zip(at(1.9, side), at(6.4, 0.3), strict=True), color=CONE, lw=0.8)
    axis(ax, at(1.9, -0.45), at(1.9, -1.25), "x", CAMERA)
    ax.plot(*zip(at(1.9, 0.45), at(1.9, -0.45), strict=True), color=CAMERA, lw=2.5)
    ax.plot(*at(6.4, 0.3), "o", color=CONE, ms=9)
    ax.text(at(6.4, 0.3)[0] + 0.25, at(6.4, 0.3)[1], "foot", fontsize=9)
    ax.text(*at(4.6, 0.72), "rays", fontsize=8, color=CONE, rotation=28)
    ax.set(xlim=(-4.6, 6.8), ylim=(-3.4, 4.1), aspect="equal")
    ax.axis("off")


def pixel_view(ax: Axes) -> None:
    ax.set_title("pixels", fontsize=10, loc="left")
    for i in range(4):
        for j in range(3):
            ax.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, facecolor="white", edgecolor="#bbbbbb"))
    axis(ax, (0, 0), (1.6, 0), "u", CAMERA)
    axis(ax, (0, 0), (0, 1.6), "v", CAMERA)
    ax.plot(0, 0, "o", color=CAMERA, ms=5)
    ax.text(0.1, -0.22, "(0, 0): centre of the first pixel", fontsize=8, color=CAMERA)
    ax.plot(-0.5, -0.5, "s", color=CONE, ms=5)
    ax.text(-0.5, -0.72, "boxes (x, y, w, h) count from this corner", fontsize=8, color=CONE)
    ax.set(xlim=(-0.9, 4.4), ylim=(2.8, -1.0), aspect="equal")
    ax.axis("off")


def main() -> None:
    figure = plt.figure(figsize=(11, 7.2), dpi=110)
    grid = figure.add_gridspec(2, 2, height_ratios=[1, 1.35], width_ratios=[1.7, 1], hspace=0.12, wspace=0.05)
    side_view(figure.add_subplot(grid[0, :]))
    plan_view(figure.add_subplot(grid[1, 0]))
    pixel_view(figure.add_subplot(grid[1, 1]))
    figure.savefig(Path(__file__).parents[1] / "images" / "coordinates.png", bbox_inches="tight")


if __name__ == "__main__":
    main()
