"""Consistency of calibrations: random halves of a folder of board images against each other.

    python benchmarks/bench_calibration.py FOLDER --board chessboard:9x6:37.8mm --pairing even-odd [--halves 10] [--seed 0]

All pairs are calibrated as `conetl calibrate` does. Then the pairs are split at random into two halves, each of which is
calibrated separately with the same lens model and board shape. The baselines of two halves share no image, so their difference
should be within 1.96 of its stated sigmas in 95 of 100 splits. Splits of few pairs are not independent of each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import arguments_of, write_json
from conetl.geometry.calibration.stereo_bundle import BoardView
from conetl.geometry.calibration.stereo_calibration import StereoCalibration, calibrate_stereo
from conetl.geometry.calibration.tables import rms_px
from conetl.model.rig import Side
from conetl.perception.boards.boards import Board, parse_board
from conetl.perception.boards.images import Size, find_boards, pairs_even_odd, pairs_in_folders, start_values


def baseline_mm(found: StereoCalibration) -> tuple[float, float]:
    """Length of the baseline and its sigma; its components are the last three unknowns of the rig."""
    base = found.bundle.left_SE3_right[:3, 3]
    along = base / np.linalg.norm(base)
    return 1e3 * float(np.linalg.norm(base)), 1e3 * float(along @ found.covariance.matrix[-3:, -3:] @ along) ** 0.5


def half_of(
    whole: StereoCalibration, views: Sequence[BoardView], pairs: set[int], board: Board, sizes: Mapping[Side, Size]
) -> tuple[float, float]:
    """Baseline and sigma (mm) from some of the pairs."""
    own = [view for view in views if view.pair_index in pairs]
    points = board.points_m()
    start = start_values(points, own, sizes)
    models = (whole.bundle.lens_model,)
    return baseline_mm(calibrate_stereo(points, own, start, models=models, board_shapes=(whole.board_shape,)))


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--board", required=True)
    parser.add_argument("--pairing", choices=("folders", "even-odd"), default="folders")
    parser.add_argument("--halves", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    board = parse_board(args.board)
    pairs = (pairs_even_odd if args.pairing == "even-odd" else pairs_in_folders)(args.folder)
    images = find_boards(pairs, board)
    points = board.points_m()
    whole = calibrate_stereo(points, images.views, start_values(points, images.views, images.sizes))
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
        (a, sigma_a), (b, sigma_b) = (
            half_of(whole, images.views, set(part.tolist()), board, images.sizes)
            for part in np.array_split(rng.permutation(both), 2)
        )
        normalised.append((a - b) / np.hypot(sigma_a, sigma_b))
        print(f"  {a:.2f} +- {sigma_a:.2f} mm, {b:.2f} +- {sigma_b:.2f} mm: {normalised[-1]:+.2f} sigmas", flush=True)
    inside, rms_z = int(np.sum(np.abs(normalised) < 1.96)), float(np.sqrt(np.mean(np.square(normalised))))
    print(f"{inside} of {args.halves} within the 95 % interval; root mean square {rms_z:.2f} sigmas, should be 1")
    write_json(args.json, {"baseline_mm": base, "sigma_mm": sigma, "differences_sigmas": normalised})


if __name__ == "__main__":
    main()
