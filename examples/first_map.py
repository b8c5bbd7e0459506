"""From a sample drive to cones with covariances and a plan view: no database, no server.

python examples/first_map.py                # the first sample drive
python examples/first_map.py DRIVE PLOT.png
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from conetl import Track, analyse, cov_matrix, read_drive

SAMPLE = Path(__file__).resolve().parents[1] / "data" / "drives" / "2026-03-02_taper_pass1"


def main(folder: Path = SAMPLE, plot: Path = Path("first_map.png")) -> Sequence[Track]:
    """Find the cones of a drive, print them with their standard deviations, and draw them."""
    drive, rejections = read_drive(folder)
    found = analyse(drive, rejections=rejections)
    axes = Figure(figsize=(8, 6)).add_subplot(
        aspect="equal", xlabel="easting (m)", ylabel="northing (m)", title=drive.drive_id
    )
    axes.plot(*np.array([pair.pose.map_t_body_m[:2] for pair in found.drive.frame_pairs]).T, color="0.6")
    for track in found.tracks:
        cov_m2 = cov_matrix(track.cov_m2)
        east, north, up = np.sqrt(cov_m2.diagonal())
        print(f"{track.xyz_m[0]:.3f} {track.xyz_m[1]:.3f} {track.xyz_m[2]:.3f}  +- {east:.3f} {north:.3f} {up:.3f} m")
        variances, axes_of_ellipse = np.linalg.eigh(cov_m2[:2, :2])
        angle = np.degrees(np.arctan2(axes_of_ellipse[1, 1], axes_of_ellipse[0, 1]))
        width, height = 20 * np.sqrt(variances[::-1])  # ten sigmas to each side, to be seen
        axes.add_patch(Ellipse(track.xyz_m[:2], width, height, angle=angle, color="tab:orange"))
    axes.figure.savefig(plot)
    print(f"{len(found.tracks)} cones; {found.trajectory.detail}; {plot}")
    return found.tracks


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
