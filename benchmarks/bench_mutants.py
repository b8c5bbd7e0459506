"""Wrong but well-formed recordings (`tests/mutants/table.py`): what each of them does to a map, beside what must become of it.

    python benchmarks/bench_mutants.py [--only TEXT] [--failures] [--json FILE]

Every recording has a map of its own. A cone of the map is wrong where it is further from every true one than chi-square 18.4 of
two degrees of freedom by its stated covariance (m^2), and a phantom where its existence probability is above 0.5 and no true cone
is within 1 m. Heights count as wrong beyond 4.3 of their stated sigmas. True are the cones of the simulation, before and after
the drive, and on KITTI those that the drive itself gives as it was recorded. A recording that needs a person passes where
`ingest` would end with 1 or 2 and name its cause. KITTI is left out where the shared data are missing.
"""

from __future__ import annotations

import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import SecretStr

from benchmarks.harness import arguments_of, own_cluster, print_rows, write_json
from conetl.db.connection import Connection
from conetl.db.map.map_store import read_current_features
from conetl.evaluation.truth import read_truth_cones
from conetl.geometry.packing import cov_matrix
from conetl.model.errors import EXIT_DONE, ConetlError
from conetl.model.ingest_report import DriveOnHoldError, IngestReport
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.rejections import DOUBTFUL_REASONS, Rejection
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.commit import commit
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.ingest import raise_if_doubtful
from conetl.pipeline.settings import Settings
from tests.folders import KITTI
from tests.mutants.table import FIRST, FOLDERS, GOOD, RECORDINGS, SECOND, STREET, STREET_AGAIN, WrongRecording

Floats = NDArray[np.float64]
CHI2, SIGMAS, PHANTOM_M, SAME_M = 18.4, 4.3, 1.0, 0.5
#: The good drive that is on the map before.
BEFORE = {SECOND: FIRST, STREET_AGAIN: STREET}


@dataclass(frozen=True)
class Outcome:
    """What became of one recording."""

    name: str
    on: str
    needs_person: bool
    exit: int = EXIT_DONE
    named: bool = True
    """Whether the cause is in what was said."""
    wrong: int = 0
    heights: int = 0
    removed: int = 0
    phantoms: int = 0
    cones: int = 0
    worst_m: float = 0.0
    """Largest horizontal error of a cone that is near a true one, and its stated sigma."""
    sigma_m: float = 0.0
    counts: str = ""
    said: str = ""
    seconds: float = 0.0

    @property
    def map_is_right(self) -> bool:
        return not (self.wrong or self.removed or self.phantoms or self.heights)

    @property
    def person_was_asked(self) -> bool:
        return self.exit in (1, 2) and self.named

    @property
    def passes(self) -> bool:
        return self.map_is_right and (self.person_was_asked or not self.needs_person)


def judged(
    outcome: Outcome, features: Sequence[MapFeature], truth: Floats, deltas: Iterable[Delta], standing: Floats
) -> Outcome:
    """The outcome with what is wrong on the map. truth: (N, 3) cones; standing: (M, 3) those that stood there all the time."""
    removed = [d.old for d in deltas if d.kind is DeltaKind.REMOVED and d.old]
    lost = sum(bool((np.linalg.norm(standing[:, :2] - old.xyz_m[:2], axis=1) < SAME_M).any()) for old in removed)
    if not features:
        return replace(outcome, removed=lost)
    xyz = np.array([feature.xyz_m for feature in features])
    cov = np.array([cov_matrix(feature.cov_m2) for feature in features])
    off = xyz[:, None] - truth
    chi2 = np.einsum("nti,nij,ntj->nt", off[..., :2], np.linalg.inv(cov[:, :2, :2]), off[..., :2])
    apart, nearest = np.linalg.norm(off[..., :2], axis=2).min(axis=1), chi2.argmin(axis=1)
    wrong = chi2.min(axis=1) > CHI2
    likely = np.array([feature.existence_probability > 0.5 for feature in features])
    heights = ~wrong & (np.abs(off[np.arange(len(xyz)), nearest, 2]) > SIGMAS * np.sqrt(cov[:, 2, 2]))
    worst = int(np.where(likely, apart, 0.0).argmax())
    return replace(
        outcome, wrong=int(wrong.sum()), heights=int(heights.sum()), removed=lost, cones=len(features),
        phantoms=int((wrong & likely & (apart > PHANTOM_M)).sum()), worst_m=float(apart[worst]),
        sigma_m=float(np.sqrt(np.trace(cov[worst, :2, :2]) / 2)),
    )  # fmt: skip


class Bench:
    """The good drives, analysed once, and the maps."""

    def __init__(self, settings: Settings, conn: Connection, folder: Path, places: Iterable[str]) -> None:
        self._settings, self._conn, self._folder = settings, conn, folder
        self._good: dict[str, AnalysedDrive] = {}
        self._truth: dict[str, Floats] = {}
        for where in (FIRST, STREET):
            if where in places or any(BEFORE.get(place) == where for place in places):
                self._good[where] = self._analyse(GOOD, where)[0]
                self._truth[where] = self._true(where)
        if SECOND in places:
            self._truth[SECOND] = self._true(SECOND)

    def _analyse(self, recording: WrongRecording, where: str) -> tuple[AnalysedDrive, list[Rejection]]:
        with tempfile.TemporaryDirectory(dir=self._folder) as folder:
            drive, rejections = recording.read(where, Path(folder))
            return analyse(drive, rejections=rejections, settings=self._settings), rejections

    def _true(self, where: str) -> Floats:
        if where == STREET:
            return np.array([track.xyz_m for track in self._good[where].tracks])
        return np.array([cone.xyz_m for cone in read_truth_cones(FOLDERS[where] / "truth.csv")[0]])

    def outcome(self, recording: WrongRecording, where: str) -> Outcome:
        """Commit the recording to a map of its own, after the good drive where there is one."""
        started, before = time.monotonic(), BEFORE.get(where)
        settings = self._settings.model_copy(update={"map_name": f"mutant_{time.monotonic_ns()}"})
        if before:
            commit(self._good[before], settings)
        outcome = Outcome(recording.name, where, recording.cause is not None)
        deltas: Sequence[Delta] = ()
        rejections: Sequence[Rejection] = ()
        try:
            analysed, rejections = self._analyse(recording, where)
            rejections = analysed.records.rejections
            committed = commit(analysed, settings)
            deltas = committed.deltas
            outcome = replace(
                outcome, counts=" ".join(f"{n} {kind.value}" for kind, n in committed.report.counts.items() if n)
            )
            raise_if_doubtful(IngestReport(**vars(committed.report), seconds=0.0), analysed)
        except ConetlError as error:
            said = error.report.on_hold if isinstance(error, DriveOnHoldError) else None  # without what all holds say
            outcome = replace(outcome, exit=error.exit_code, said=said or str(error))
        except Exception as error:  # an internal error is a result too
            outcome = replace(outcome, exit=70, said=f"{type(error).__name__}: {error}")
        details = {r.reason: r.detail for r in rejections if r.reason in DOUBTFUL_REASONS}
        said = " ".join([outcome.said, *details.values()])
        truths = [self._truth[place] for place in (before, where) if place in self._truth]
        standing = _common(truths) if before else np.empty((0, 3))
        outcome = replace(
            outcome, named=recording.cause is None or re.search(recording.cause, said, re.DOTALL) is not None, said=said,
            seconds=time.monotonic() - started,
        )  # fmt: skip
        features = read_current_features(self._conn, map_name=settings.map_name) if outcome.exit < 2 or before else []
        return judged(outcome, features, np.concatenate(truths), deltas, standing)


def _common(truths: Sequence[Floats]) -> Floats:
    """(M, 3) the cones of the first truth that are in all others too, within 0.1 m."""
    kept = truths[0]
    for other in truths[1:]:
        kept = kept[np.linalg.norm(kept[:, None] - other, axis=2).min(axis=1) < 0.1]
    return kept


def row_of(outcome: Outcome) -> dict[str, object]:
    person = "asked" if outcome.person_was_asked else "not asked" if outcome.exit == EXIT_DONE else "other cause"
    return {
        "recording": outcome.name, "on": outcome.on, "": "" if outcome.passes else "FAILS", "exit": outcome.exit,
        "person": person if outcome.needs_person else "", "out": outcome.wrong or "", "up": outcome.heights or "",
        "gone": outcome.removed or "", "false": outcome.phantoms or "", "cones": outcome.cones,
        "worst": outcome.worst_m, "stated": outcome.sigma_m, "changes": outcome.counts,
    }  # fmt: skip


def totals(outcomes: Sequence[Outcome]) -> dict[str, object]:
    people = [o for o in outcomes if o.needs_person]
    return {
        "recordings": len({o.name for o in outcomes}), "maps": len(outcomes), "pass": sum(o.passes for o in outcomes),
        "cones outside 18.4": sum(o.wrong for o in outcomes), "heights": sum(o.heights for o in outcomes),
        "standing cones removed": sum(o.removed for o in outcomes), "phantoms": sum(o.phantoms for o in outcomes),
        "need a person": len(people), "named": sum(o.person_was_asked for o in people),
        "held without need": sum(o.exit != EXIT_DONE and not o.needs_person for o in outcomes),
        "exit codes": " ".join(f"{code}: {n}" for code, n in sorted(Counter(o.exit for o in outcomes).items())),
    }  # fmt: skip


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--only", default="", metavar="TEXT", help="regular expression in their name or drive")
    parser.add_argument("--failures", action="store_true", help="also print what conetl said where a criterion fails")
    args = parser.parse_args()
    cases = [(r, on) for r in (GOOD, *RECORDINGS) for on in r.on if re.search(args.only, f"{r.name} on {on}")]
    if not KITTI.is_dir():
        print(f"KITTI is left out: {KITTI} is missing")
        cases = [(r, on) for r, on in cases if on not in (STREET, STREET_AGAIN)]
    if not cases:
        raise SystemExit(f"no recording has {args.only!r} in its name")
    outcomes = []
    with own_cluster() as (home, url), tempfile.TemporaryDirectory(prefix="conetl-bench-") as folder:
        settings = Settings(home=home, database_url=SecretStr(url), workers=2)
        with MapDatabase(settings) as database, database.connection() as conn:
            bench = Bench(settings, conn, Path(folder), {on for _, on in cases})
            for number, (recording, on) in enumerate(cases, 1):
                outcomes.append(bench.outcome(recording, on))
                print(f"\r{number} of {len(cases)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    columns = "out: beyond chi-square; up: heights; gone: standing, removed; false: phantoms; worst, stated: m"
    print_rows(f"What wrong recordings do to the map ({columns})", [row_of(outcome) for outcome in outcomes])
    print_rows("Totals", [{"figure": name, "value": value} for name, value in totals(outcomes).items()])
    if args.failures:
        for outcome in outcomes:
            if not outcome.passes:
                print(f"{outcome.name} on {outcome.on}: exit {outcome.exit}: {outcome.said or 'nothing'}")
    write_json(args.json, [asdict(outcome) for outcome in outcomes])


if __name__ == "__main__":
    main()
