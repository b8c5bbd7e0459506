"""How well the map tells what happened on a road: a confusion matrix over simulated days, three drives each.

    python benchmarks/bench_changes.py [--days 200] [--roads 4] [--processes 2] [--seed 1] [--hidden]

The days are shared out to several roads, each with a map of its own (`tests/synthetic/changing_road.py` says what is simulated
and what is real). Processor time: about 2.5 s a day.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from conetl.perception.model_card import read_model_card
from tests.synthetic.changing_road import HIDDEN, Score, simulate


def one_road(days_and_seed: tuple[int, int]) -> Score:
    evidence = read_model_card(None).evidence
    if evidence is None:
        raise SystemExit("the shipped model's sidecar holds no evidence: nothing to simulate with")
    days, seed = days_and_seed
    return simulate(days, evidence, seed=seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=int, default=200)
    parser.add_argument("--roads", type=int, default=4)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1, help="of the first road; the others count up from it")
    parser.add_argument("--hidden", action="store_true", help="tell of wrong ones that no drive had in plain view, too")
    options = parser.parse_args()
    jobs = [(len(range(road, options.days, options.roads)), options.seed + road) for road in range(options.roads)]
    total = Score()
    with ProcessPoolExecutor(options.processes) as pool:
        for (days, seed), score in zip(jobs, pool.map(one_road, jobs), strict=True):
            total.confusion += score.confusion
            total.wrong += score.wrong
            total.removed_well_seen += score.removed_well_seen
            total.removed_at_once += score.removed_at_once
            total.unseen_removed += score.unseen_removed
            print(f"road of seed {seed}, {days} days: F1 {score.f1:.4f}; of all so far {total.f1:.4f}", flush=True)
    print_table(total.confusion)
    print(f"days {options.days}, F1 of added, moved, removed after 3 drives: {total.f1:.4f}")
    print(
        f"taken away in plain view of one drive: {total.removed_well_seen}, removed by it: {total.deleted_recall:.3f}"
    )
    print(f"removed without the spot having been in view: {total.unseen_removed}")
    for line in total.wrong:
        if options.hidden or HIDDEN not in line:
            print(" ", line)


def print_table(confusion: Counter[tuple[str, str]]) -> None:
    rows = sorted({truth for truth, _ in confusion})
    columns = sorted({said for _, said in confusion})
    print(f"{'happened, the map says:':24}" + "".join(f"{name:>16}" for name in columns))
    for row in rows:
        print(f"{row:24}" + "".join(f"{confusion[row, column] or '':>16}" for column in columns))


if __name__ == "__main__":
    main()
