"""Honest recordings (`tests/honest`): how many are held, and are positions as good as stated, for each shape of error?

    python benchmarks/bench_honest.py [--seed 0] [--drives 20] [--only TEXT] [--json FILE]

None may be held: the errors of each log stay within the sigmas that it states. NEES per degree of freedom is one if the sigmas
of cones are right; + means that they are too small by the band of 95 %, ++ by that of 99 %, - and -- that they are too large.
Seeds below 1000 are for development: figures to quote are those of seeds from 1000 on, by which nothing was chosen.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator

from benchmarks.harness import arguments_of, print_rows, write_json
from tests.honest.drives import outcome_of
from tests.honest.logs import SHAPES, LogShape
from tests.honest.outcomes import Outcome, by_shape


def shapes_named(text: str) -> list[LogShape]:
    found = [shape for shape in SHAPES if re.search(text, shape.name)]
    if not found:
        raise SystemExit(f"no shape has {text!r} in its name")
    return found


def drives(shapes: Iterable[LogShape], seed: int, count: int) -> Iterator[Callable[[], Outcome]]:
    """So many of each shape, with its strengths in turn."""
    for shape in shapes:
        for number in range(seed, seed + count):
            sigma_m = shape.strengths_m[number % len(shape.strengths_m)]
            yield lambda shape=shape, number=number, sigma_m=sigma_m: outcome_of(number, shape, sigma_m)  # type: ignore[misc]


def run(title: str, work: Iterable[Callable[[], Outcome]]) -> list[Outcome]:
    """Outcomes of all, with a table by shape and the reasons of holds."""
    outcomes, start = [], time.monotonic()
    for number, step in enumerate(work, 1):
        outcomes.append(step())
        if sys.stderr.isatty():
            print(f"\r{title}: {number}, {time.monotonic() - start:.0f} s", end="", file=sys.stderr, flush=True)
    if outcomes:
        print_rows(f"{title}, {time.monotonic() - start:.0f} s", by_shape(outcomes))
    for outcome in outcomes:
        if outcome.held is not None:
            print(f"held: {outcome.name}: {outcome.held}")
    return outcomes


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of the first one of each shape; the others follow")
    parser.add_argument("--drives", type=int, default=20, help="without images, of each shape")
    parser.add_argument("--only", default="", metavar="TEXT", help="regular expression in the name of the shape")
    options = parser.parse_args()
    shapes = shapes_named(options.only)
    outcomes = run("Drives without images", drives(shapes, options.seed, options.drives))
    write_json(options.json, [outcome.as_dict() for outcome in outcomes])


if __name__ == "__main__":
    main()
