"""Honest recordings (`tests/honest`): how many are held, and are positions as good as stated, for each shape of error?

    python benchmarks/bench_honest.py [--seed 0] [--drives 20] [--recordings 0] [--renders FOLDER] [--only TEXT] [--json FILE]

None may be held: the errors of each log stay within the sigmas that it states. NEES per degree of freedom is one if the sigmas
of cones are right; + means that they are too small by the band of 95 %, ++ by that of 99 %, - and -- that they are too large.
`--drives` have simulated motions and no images. `--recordings` have images: sample drives, also with worse cameras, rendered ones
(`tests/honest/renders.py`), and KITTI, where no NEES is known. Their images are detected once, so that most take 2 to 6 s.
Seeds below 1000 are for development: figures to quote are those of seeds from 1000 on, by which nothing was chosen.
"""

from __future__ import annotations

import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.pipeline.settings import Settings
from tests.honest.drives import outcome_of
from tests.honest.logs import SHAPES, LogShape
from tests.honest.outcomes import Outcome, as_json, by
from tests.honest.recordings import Base, bases
from tests.honest.recordings import outcome_of as with_images


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
            yield partial(outcome_of, number, shape, sigma_m)


def recordings(
    shapes: list[LogShape], seed: int, count: int, known: Sequence[Callable[[], Base]], settings: Settings
) -> Iterator[Callable[[], Outcome]]:
    """So many, with shapes, recordings and strengths in turn."""
    for number in range(count):
        of_shape, turn = number % len(shapes), number // len(shapes)
        shape, base = shapes[of_shape], known[(7 * of_shape + turn) % len(known)]
        sigma_m = shape.strengths_m[turn % len(shape.strengths_m)]
        yield partial(with_images, seed + turn, shape, sigma_m, base, settings)


def run(title: str, work: Iterable[Callable[[], Outcome]]) -> list[Outcome]:
    """Outcomes of all; prints the reason of each hold at once, and a table by shape."""
    outcomes, start = [], time.monotonic()
    for number, step in enumerate(work, 1):
        outcomes.append(step())
        if (said := outcomes[-1].held) is not None:
            print(f"held: {outcomes[-1].name}: {said}", flush=True)
        if sys.stderr.isatty() or number % 20 == 0:
            print(f"\r{title}: {number}, {time.monotonic() - start:.0f} s", end="", file=sys.stderr, flush=True)
    if outcomes:
        print_rows(f"{title}, {time.monotonic() - start:.0f} s", by(lambda one: one.shape, outcomes))
    return outcomes


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of the first one of each shape; the others follow")
    parser.add_argument("--drives", type=int, default=20, help="without images, of each shape")
    parser.add_argument("--recordings", type=int, default=0, help="with images, of all shapes together")
    parser.add_argument("--renders", type=Path, metavar="FOLDER", help="of tests/honest/renders.py")
    parser.add_argument("--only", default="", metavar="TEXT", help="regular expression in the name of the shape")
    options = parser.parse_args()
    shapes = shapes_named(options.only)
    outcomes = run("Drives without images", drives(shapes, options.seed, options.drives))
    if options.recordings:
        with tempfile.TemporaryDirectory(prefix="conetl-bench-") as name:
            settings = Settings(home=Path(name) / "home", workers=1)
            (Path(name) / "drives").mkdir()
            known = bases(Path(name) / "drives", settings, options.renders)
            found = run("Recordings", recordings(shapes, options.seed, options.recordings, known, settings))
        print_rows("Recordings, by images", by(lambda one: one.on, found))
        outcomes += found
    write_json(options.json, as_json(outcomes))


if __name__ == "__main__":
    main()
