"""Health checks: false alarms, honest positions and clocks on simulated good drives, and what the checks cost in an ingest.

    python benchmarks/bench_health.py [--drives 200] [--seed 0] [--no-cost] [--json FILE]

`tests/synthetic/good_drives.py` simulates: none of its drives may be held. NEES of positions: with a GNSS offset that stays the
same over a drive, at its middle and at a frame by chance. Clock: offsets of -200 to +200 ms. Cost: processor time of each check
as a share of that of `analyse`, on one worker and without earlier results.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.geometry.consistency import Nees
from conetl.model.health import Verdict, hold_reason
from conetl.perception import visual_odometry
from conetl.pipeline import analysis, odometry
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.tracking import drive_refinement, trajectory
from conetl.tracking.clock import MAX_SIGMA_S
from tests.folders import KITTI, SAMPLE
from tests.synthetic.good_drives import checked, clock_of, draw_calibration, draw_drive, position_nees
from tests.synthetic.odometry import pose_errors

#: Seeds of the parts are apart, so that none repeats the drives of another.
_POSITIONS, _CLOCKS, _CALIBRATIONS = 100_000, 200_000, 300_000
Row = dict[str, object]


def false_alarms(drives: int, seed: int) -> list[Row]:
    """Verdicts on good drives and calibrations, and positions before and after the refinement."""
    verdicts: Counter[Verdict] = Counter()
    logged_m: list[float] = []
    refined_m: list[float] = []
    held = corrected = 0
    for number in range(seed, seed + drives):
        drive = draw_drive(np.random.default_rng(number))
        refined, checks = checked(drive)
        _, of_calibration = draw_calibration(np.random.default_rng(_CALIBRATIONS + number))
        reason = hold_reason([*checks, *of_calibration])
        held += reason is not None
        corrected += refined.clock is not None and refined.clock.is_applied(0.0)
        verdicts.update(check.verdict for check in of_calibration)
        if reason is not None:
            print(f"held: seed {number}, {drive.kind}: {reason}")
        for pairs, found in ((drive.logged, logged_m), (refined.frame_pairs, refined_m)):
            found.append(float(np.sqrt((pose_errors(list(pairs), drive.truth)[:, :3] ** 2).sum(axis=1).mean())))
    share = np.array(refined_m) / np.array(logged_m)
    return [
        {
            "drives": drives, "held": held, "clocks corrected": corrected,
            "calibrations corrected": verdicts[Verdict.CORRECTED],
            "rms error over that of the log, median": float(np.median(share)),
            "90 %": float(np.quantile(share, 0.9)), "most": float(share.max()),
        }
    ]  # fmt: skip


def positions(drives: int, seed: int) -> list[Row]:
    """NEES of positions with a GNSS offset as large as the best record states."""
    rows: list[Row] = []
    for steady in (True, False):
        total = {"middle": Nees(0.0, 0), "by chance": Nees(0.0, 0)}
        for number in range(_POSITIONS + seed, _POSITIONS + seed + drives):
            rng = np.random.default_rng(number)
            drive = draw_drive(rng, constant_share=1.0, steady=steady)
            refined, _ = checked(drive)
            if refined.covariance is None:
                continue
            count = len(drive.truth)
            for name, frame in (("middle", count // 2), ("by chance", int(rng.integers(count)))):
                total[name] += position_nees(drive, refined, frame)
        for name, nees in total.items():
            low, high = (bound / nees.dof for bound in nees.band())
            rows.append(
                {
                    "stated sigma": "constant" if steady else "changing", "frame": name, "drives": nees.dof // 3,
                    "NEES": nees.per_dof, "95 % band": f"{low:.2f} to {high:.2f}", "holds": nees.holds(),
                }
            )  # fmt: skip
    return rows


def clocks(drives: int, seed: int) -> list[Row]:
    """Errors of the offsets that are found."""
    offsets = np.random.default_rng(_CLOCKS + seed).uniform(-0.2, 0.2, drives)
    rows: list[Row] = []
    for kind, turns in (("by chance", None), ("with bends, 15 s or more", True)):
        found = []
        for number, offset_s in enumerate(offsets.tolist()):
            rng = np.random.default_rng(_CLOCKS + seed + number)
            lasts_s = float(rng.uniform(15.0, 60.0)) if turns else None
            clock = clock_of(draw_drive(rng, offset_s=offset_s, turns=turns, lasts_s=lasts_s))
            if clock is not None and clock.sigma_s <= MAX_SIGMA_S:
                found.append((1e3 * (clock.offset_s - offset_s), 1e3 * clock.sigma_s))
        off, sigma = np.array(found).T
        nees = Nees(float(((off / sigma) ** 2).sum()), len(off))
        low, high = (bound / nees.dof for bound in nees.band())
        rows.append(
            {
                "drives": kind, "number": drives, "shown": len(off), "rms ms": float(np.sqrt((off**2).mean())),
                "most ms": float(np.abs(off).max()), "within 5 ms": int((np.abs(off) <= 5).sum()),
                "stated sigma ms, median": float(np.median(sigma)), "within 3 sigma": int((np.abs(off) <= 3 * sigma).sum()),
                "NEES": nees.per_dof, "95 % band": f"{low:.2f} to {high:.2f}",
            }
        )  # fmt: skip
    return rows


@contextmanager
def timed(spent_s: dict[str, float]) -> Iterator[None]:
    """Adds up the processor time in each check; with one worker nothing else runs meanwhile."""

    def counting(name: str, work: Callable[..., object]) -> Callable[..., object]:
        def step(*args: object, **options: object) -> object:
            start = time.process_time()
            result = work(*args, **options)
            result = list(result) if isinstance(result, Iterator) else result
            spent_s[name] = spent_s.get(name, 0.0) + time.process_time() - start
            return result

        return step

    places = (
        (analysis, "check_stereo"), (analysis, "check_calibration"), (analysis, "check_exposures"), (analysis, "check_doubled"),
        (analysis, "check_revisits"), (visual_odometry, "row_changes"), (odometry, "find_torn"),
        (odometry, "right_camera_ahead"), (odometry, "check_trajectory"), (odometry, "check_lost_frames"),
        (odometry, "check_recording"), (odometry, "check_lost_parts"), (drive_refinement, "estimate_clock"),
        (trajectory, "estimate_log_errors"), (trajectory, "fit_path"),
    )  # fmt: skip
    with ExitStack() as stack:
        for module, name in places:
            stack.enter_context(patch.object(module, name, counting(name, getattr(module, name))))
        yield


def cost(folders: list[Path]) -> list[Row]:
    """Processor time of the checks within `analyse`, and of the model of the log's errors, which the adjustment uses, too."""
    rows: list[Row] = []
    for folder in folders:
        drive, _ = read_drive(folder)
        spent_s: dict[str, float] = {}
        with tempfile.TemporaryDirectory(prefix="conetl-bench-") as home, timed(spent_s):
            start = time.process_time()
            analysis.analyse(drive, settings=Settings(home=Path(home), workers=1))
            total_s = time.process_time() - start
        rows.append(
            {"drive": folder.name, "pairs": len(drive.frame_pairs), "analyse s": total_s}
            | {"share %": 100 * sum(spent_s.values()) / total_s}
            | {f"{name} ms": 1e3 * used_s for name, used_s in spent_s.items()}
        )
    return rows


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--drives", type=int, default=200, help="simulated drives; half as many for positions")
    parser.add_argument("--seed", type=int, default=0, help="of the first drive; the others follow")
    parser.add_argument("--no-cost", action="store_true", help="skip the drives with images")
    options = parser.parse_args()
    figures = {
        "false alarms": false_alarms(options.drives, options.seed),
        "positions": positions(max(options.drives // 2, 1), options.seed),
        "clocks": clocks(options.drives, options.seed),
    }
    if not options.no_cost:
        figures["cost"] = cost([SAMPLE, *([KITTI] if KITTI.is_dir() else [])])
    for name, rows in figures.items():
        print_rows(name, rows)
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
