"""Do calibrations of the same rig agree as well as they say? Random halves of a folder of board pictures against each other.

    python benchmarks/bench_calibration.py FOLDER --board chessboard:9x6:37.8mm --pairing even-odd [--halves 10] [--seed 0]

All pairs are calibrated as `conetl calibrate` does. Then the pairs are split at random into two halves, each of which is
calibrated by itself with that lens model and board shape: the baselines of two halves share no picture, so their difference
should lie within 1.96 of its stated sigmas in 95 of 100 splits. Splits of few pairs are not independent of each other.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from conetl.geometry.calibration.board_views import BoardView
from conetl.geometry.calibration.stereo_calibration import StereoCalibration, calibrate_stereo
from conetl.geometry.calibration.tables import rms_px
from conetl.perception.boards.boards import Board, parse_board
from conetl.perception.boards.images import find_boards, pairs_even_odd, pairs_in_folders
from conetl.perception.boards.start_values import start_values


def baseline_mm(found: StereoCalibration) -> tuple[float, float]:
    """Length of the base and its sigma; the last three unknowns of the rig are its components."""
    base = found.bundle.left_SE3_right[:3, 3]
    along = base / np.linalg.norm(base)
    return 1e3 * float(np.linalg.norm(base)), 1e3 * float(along @ found.covariance.matrix[-3:, -3:] @ along) ** 0.5


def half_of(
    whole: StereoCalibration, views: Sequence[BoardView], pairs: set[int], board: Board, sizes: dict
) -> tuple[float, float]:
    """Baseline and sigma (mm) from some of the pairs."""
    own = [view for view in views if view.pair_index in pairs]
    points = board.points_m()
    return baseline_mm(
        calibrate_stereo(
            points, own, start_values(points, own, sizes), models=(whole.bundle.lens_model,), board_shapes=(whole.board_shape,)
        )
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--board", required=True)
    parser.add_argument("--pairing", choices=("folders", "even-odd"), default="folders")
    parser.add_argument("--halves", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    board = parse_board(args.board)
    pairs = (pairs_even_odd if args.pairing == "even-odd" else pairs_in_folders)(args.folder)
    pictures = find_boards(pairs, board)
    points = board.points_m()
    whole = calibrate_stereo(points, pictures.views, start_values(points, pictures.views, pictures.sizes))
    both = whole.stereo_pairs
    base, sigma = baseline_mm(whole)
    rms = rms_px(whole.bundle, [view for view in whole.views if view.pair_index in set(both)])
    print(
        f"{len(both)} of {len(pairs)} pairs, lens {whole.bundle.lens_model}, board {whole.board_shape}, stereo RMS {rms:.3f} px,"
    )
    print(f"baseline {base:.2f} +- {sigma:.2f} mm")
    rng = np.random.default_rng(args.seed)
    normalised = []
    for _ in range(args.halves):
        order = rng.permutation(both)
        (a, sigma_a), (b, sigma_b) = (
            half_of(whole, pictures.views, {int(p) for p in part}, board, pictures.sizes)
            for part in np.array_split(order, 2)
        )
        normalised.append((a - b) / np.hypot(sigma_a, sigma_b))
        print(
            f"  {a:.2f} +- {sigma_a:.2f} mm against {b:.2f} +- {sigma_b:.2f} mm: {normalised[-1]:+.2f} sigmas",
            flush=True,
        )
    inside, rms_z = int(np.sum(np.abs(normalised) < 1.96)), float(np.sqrt(np.mean(np.square(normalised))))
    print(f"{inside} of {args.halves} inside the 95 % interval; root mean square {rms_z:.2f} sigmas, should be 1")


if __name__ == "__main__":
    main()
