"""Planned against found: precision and recall of the differences in a simulated city of work zones over a month of nights.

    python benchmarks/bench_plans.py [--zones 200] [--nights 30] [--seeds 101 102 103] [--tolerance-m 15]

`tests/synthetic/permitted_city.py` describes what is simulated and what is real. Seeds below 100 were used in development.
"""

from __future__ import annotations

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.model.work_zone_params import PlanParams
from tests.synthetic.permitted_city import score


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--zones", type=int, default=200)
    parser.add_argument("--nights", type=int, default=30)
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102, 103])
    parser.add_argument("--tolerance-m", type=float, default=PlanParams().tolerance_m)
    options = parser.parse_args()
    rows, wrong = [], []
    for seed in options.seeds:
        found = score(options.zones, options.nights, seed, PlanParams(tolerance_m=options.tolerance_m))
        figures = found._asdict()
        wrong += figures.pop("wrong")
        rows.append({"seed": seed, **{name: figures[name] for name in figures if name != "differences"}})
    print_rows(f"{options.zones} zones, {options.nights} nights", rows)
    for line in wrong:
        print(" ", line)
    write_json(options.json, rows)


if __name__ == "__main__":
    main()
