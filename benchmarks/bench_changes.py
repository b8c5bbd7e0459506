"""Accuracy of the map's changes: a confusion matrix over simulated days with three drives each.

    python benchmarks/bench_changes.py [--days 200] [--roads 4] [--processes 2] [--seed 1] [--hidden]

The days are distributed over several roads, each with a map of its own; `tests/synthetic/changing_road.py` describes what is
simulated and what is real. Processor time: about 0.3 s per day.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ProcessPoolExecutor

from benchmarks.harness import arguments_of, evidence_of_model, print_rows, write_json
from tests.synthetic.changing_road import HIDDEN, Score, simulate


def one_road(days_and_seed: tuple[int, int]) -> Score:
    days, seed = days_and_seed
    return simulate(days, evidence_of_model(), seed=seed)


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--days", type=int, default=200)
    parser.add_argument("--roads", type=int, default=4)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1, help="of the first road; the others follow")
    parser.add_argument(
        "--hidden", action="store_true", help="also list wrong changes that were in no drive's plain view"
    )
    options = parser.parse_args()
    jobs = [(len(range(road, options.days, options.roads)), options.seed + road) for road in range(options.roads)]
    total = Score()
    with ProcessPoolExecutor(options.processes) as pool:
        for (days, seed), score in zip(jobs, pool.map(one_road, jobs), strict=True):
            total.confusion += score.confusion
            total.wrong += score.wrong
            total.held += score.held
            total.removed_well_seen += score.removed_well_seen
            total.removed_at_once += score.removed_at_once
            total.unseen_removed += score.unseen_removed
            print(f"road of seed {seed}, {days} days: F1 {score.f1:.4f}; all roads so far {total.f1:.4f}", flush=True)
    print_rows("Columns: change on the map", confusion_rows(total.confusion))
    print(f"days {options.days}, F1 of added, moved, removed after 3 drives: {total.f1:.4f}")
    print(
        f"taken away in plain view of one drive: {total.removed_well_seen}, removed by it: {total.deleted_recall:.3f}"
    )
    print(f"removed although their position was never in view: {total.unseen_removed}")
    print(f"good drives that were held: {len(total.held)}")
    for line in total.held:
        print(" ", line)
    for line in total.wrong:
        if options.hidden or HIDDEN not in line:
            print(" ", line)
    write_json(options.json, {"f1": total.f1, "confusion": [[*key, n] for key, n in total.confusion.items()]})


def confusion_rows(confusion: Counter[tuple[str, str]]) -> list[dict[str, object]]:
    """One row per real change."""
    columns = sorted({on_map for _, on_map in confusion})
    return [
        {"real change": real} | {name: confusion[real, name] or "" for name in columns}
        for real in sorted({real for real, _ in confusion})
    ]


if __name__ == "__main__":
    main()
