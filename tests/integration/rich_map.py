"""One small map with something of everything, the same in each run: times of the database included.

Drives of several days (late, held, accepted, reverted), an imported map with every class and oblique covariances, lane markings,
decisions, work zones with versions and plans, base layers, provisional features, and entries that failed. Beside it a map west of
Greenwich and a map of several work zones. No two of its numbers are equal by chance.
"""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch
from uuid import UUID

import numpy as np

from conetl.db.connection import Connection, execute
from conetl.db.live_store import WatchedDrive, write_live
from conetl.db.map.map_store import list_changesets, map_transaction
from conetl.db.map.results import CommittedChangeset
from conetl.db.receipt_store import Receipt, StepTime, write_receipt, write_run_steps
from conetl.model.feature_classes import FEATURE_CLASSES, LINE_CLASSES
from conetl.model.rejections import Rejection, RejectionReason
from conetl.pipeline.maps.decisions import approve_change
from conetl.pipeline.maps.notices import record_notices
from tests import records
from tests.integration import drives_of_days as world
from tests.integration.test_planned_zones import line, permit, write
from tests.synthetic.painted_road import Paint, markings_of
from tests.synthetic.world import ORIGIN_M, START_NS, Cone
from tests.unit.readers.test_base_layers import geojson, write_las

HOUR_NS = 3_600_000_000_000
#: Of the first changeset; each write is an hour and a second later than the one before.
WRITTEN = datetime(2026, 3, 20, 6, 30, 15, 250_000, UTC)
STEP = timedelta(hours=1, seconds=1)
_MODULES = ("db.map.commit", "db.map.import_store", "db.map.plan_store", "pipeline.maps.decisions")
#: Beside the road, on the first two days only: a zone that is closed.
ASIDE = [Cone((13.0 + 5.5 * k, -4.2 - 0.1 * k, 0.0), height_m=0.7) for k in range(5)]
SIGNS = [Cone((33.0, 6.4, 2.1), height_m=0.62), Cone((24.0, 6.9, 2.2), height_m=0.75)]
#: Columns of the imported map, whose rows are those of `imported_rows`.
COLUMNS = (
    "feature_id", "category", "easting_m", "northing_m", "ellipsoidal_height_m", "object_height_m", "object_height_sigma_m",
    "existence_probability", "observation_count", "sigma_e_m", "sigma_n_m", "sigma_u_m", "cov_en_m2", "cov_eu_m2", "cov_nu_m2",
    "first_seen_at", "last_seen_at",
)  # fmt: skip


class Written(NamedTuple):
    """What is known of a map from its making."""

    writes: int
    """Instants of writes: `written(0)` to `written(writes - 1)`."""
    features: dict[str, str]
    """Name -> id, of the imported ones the class, of those decided about the decision."""


def written(number: int) -> datetime:
    """The instant of a write, in the clock of the database."""
    return WRITTEN + number * STEP


@contextmanager
def own_clock() -> Iterator[Callable[[], int]]:
    """While maps are written: their system times are those of `written`. Yields the number of writes so far."""
    numbers = itertools.count()
    last = [0]

    def tick(*_: object) -> datetime:
        last[0] = next(numbers)
        return written(last[0])

    with ExitStack() as stack:
        for name in _MODULES:
            stack.enter_context(patch(f"conetl.{name}.system_time", tick))
        yield lambda: last[0] + 1


def imported_rows() -> list[dict[str, Any]]:
    """Every class of point objects, 60 m beyond the cones; the axes of their ellipses are 1 : 3 : 2 and oblique. One is
    doubtful."""
    rows = []
    for number, category in enumerate(name for name in FEATURE_CLASSES if name not in LINE_CLASSES):
        angle, tilt = 0.3 + 0.35 * number, 0.2 - 0.04 * number
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [
            [1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)],
        ]  # fmt: skip
        cov_m2 = turn @ np.diag(np.square([0.021, 0.063, 0.042]) * (1 + 0.1 * number)) @ turn.T
        x, y, z = np.add(ORIGIN_M, (105.25 + 4.5 * number, 2.125 + 0.375 * number, 0.5 + 0.0625 * number)).tolist()
        stated = np.round([*np.sqrt(np.diag(cov_m2)), cov_m2[0, 1], cov_m2[0, 2], cov_m2[1, 2]], 9).tolist()
        seen = datetime(2026, 3, 1, 7, 10 + number, 5, 500_000, UTC)
        low, high = FEATURE_CLASSES[category].heights_m
        values = (
            UUID(int=0xC0DE + 256 * number), category, x, y, z, round((low + 2 * high) / 3 - 0.01, 3), 0.011 + 0.001 * number,
            0.87 + 0.01 * number - 0.4 * (number == 7), 5 + number, *stated,
            seen.isoformat(), (seen + timedelta(minutes=33, seconds=number)).isoformat(),
        )  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    return rows


def drive(day: int, *, hour: int = 0, frames: int = 40, name: str = "", gone: int = 0) -> world.Survey:
    """Of a day of `drives_of_days`, with signs, the cones aside, lane markings and rejected records. gone: of its last cones."""
    rng = np.random.default_rng([day, hour, frames])
    first_ns = START_NS + day * world.DAY_NS + hour * HOUR_NS
    cones = [*world.DAYS[day][: len(world.DAYS[day]) - gone], *(ASIDE if day < 2 else ())]
    made = world.survey_of(
        cones, rng, name or f"day_{day}_{hour}", frames=frames, start_m=0.0, first_ns=first_ns,
        rig=world.RIGS[day], signs=SIGNS[: 2 - (day > 1)],
    )  # fmt: skip
    first = made.drive.frame_pairs[0].pose.map_t_body_m[0] - ORIGIN_M[0]
    offset_m = np.subtract(made.drive.frame_pairs[0].pose.map_t_body_m, (ORIGIN_M[0] + round(first), *ORIGIN_M[1:]))
    paints = [Paint(5.25), Paint(1.75 if day < 2 else 1.0, colour="yellow", pattern="dashed", width_m=0.15)]
    lines = markings_of(
        paints, rng, (first + 6.0, first + 21.0), offset_m=offset_m, offset_sigma_m=0.3, seen_ns=first_ns
    )
    reasons = [RejectionReason.NEVER_NEAR] * (day + 1) + [RejectionReason.IMAGE_TRUNCATED] * (2 * day + 1)
    rejected = [
        Rejection(
            step="tracks" if reason is RejectionReason.NEVER_NEAR else "frames", reason=reason, record=f"record {k}",
            detail=f"found {k}, expected {k + 1}", payload={},
        )
        for k, reason in enumerate(reasons)
    ]  # fmt: skip
    pairs = made.drive.model_copy(update={"expected_frame_count": frames + 2 * day + 1})
    return made._replace(drive=pairs, markings=lines, rejections=rejected)


def make(conn: Connection, conetl: Callable[..., str], folder: Path) -> Written:
    """Fill the map `default` of an empty database. conetl: the command line on it; folder: for the files that it reads."""
    with own_clock() as count:
        path = folder / "all_classes.csv"
        with path.open("w", newline="") as file:
            table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(imported_rows())
        conetl("map", "import", path, "--map-srid", 32632, "--crs", "EPSG:32632")
        features = {row["category"]: str(row["feature_id"]) for row in imported_rows()}
        for day, hour in ((0, 0), (2, 0), (1, 0)):  # the second of them late
            _merge(conn, drive(day, hour=hour))
        standing = _standing(conetl)
        for number, (decided, more) in enumerate((("pin", ()), ("suppress", ()), ("classify", ("drum",)))):
            features[decided] = standing[number]
            note = ("--note", f"seen {number + 2} times", "--by", f"Ada {number}")
            conetl("map", decided, standing[number], *more, "--radius", 0.75 + 0.125 * number, *note)
        _merge(conn, drive(3))
        _merge(conn, drive(3, hour=2, frames=31, name="held"), hold="GNSS/INS jumps by 5 m.")
        _merge(conn, drive(3, hour=3, frames=32, name="accepted"), hold="The clocks differ by 0.2 s.")
        conetl("drive", "accept", "accepted", "--note", "a leap second", "--by", "Bo")
        _merge(conn, drive(3, hour=4, frames=23, name="reverted"))
        conetl("map", "revert", _changesets(conn)["reverted"].changeset_no, "--note", "wrong road", "--by", "Cy")
        _merge(conn, drive(3, hour=5, frames=8, name="short", gone=1))
        doubtful = _standing(conetl)[3]
        approve_change(conn, UUID(doubtful), map_name="default", note="looked at", decided_by="Di")
        conn.commit()
        features["approve"] = doubtful
        _plans(conetl, folder)
        _notices(conn, written(count()))
        conetl("map", "licence", "CC BY 4.0, Roads of Nowhere")
        lines = [line((5.0, 62.0), y)["coordinates"] for y in (5.3, 1.8, -1.75)]
        conetl("base", "import", geojson(folder / "lanes.geojson", *(_layer(one) for one in lines)))
        conetl("base", "import", write_las(folder / "street.laz", 300))
        _points(folder)
        _watched(conn)
        _failed(conn, folder)
        _west(conn)
        _zones(conn)
        return Written(count(), features)


def _merge(conn: Connection, made: world.Survey, hold: str | None = None, map_name: str = "default") -> None:
    world.merge(conn, made, hold=hold, map_name=map_name)
    conn.commit()
    one = _changesets(conn, map_name)[made.drive.drive_id]
    number = one.changeset_no
    steps = [
        StepTime("detect", 2 + number, 3.5 * number, 0.25, 2.5 * number),
        StepTime("merge", 1, 0.125 * number, 9.0, 9.5),
    ]
    write_run_steps(conn, one.changeset_id, steps)
    _notices(conn, one.committed_at, map_name)


def _notices(conn: Connection, at: datetime, map_name: str = "default") -> None:
    """Record what changed of zones and plans, as of this time."""
    record_notices(conn, map_name=map_name)
    execute(
        conn, "update conetl.notice set recorded_at = %(at)s where recorded_at > now() - interval '1 hour'", {"at": at}
    )
    conn.commit()


def _changesets(conn: Connection, map_name: str = "default") -> dict[str, CommittedChangeset]:
    found = {one.drive_id: one for one in list_changesets(conn, map_name=map_name)}
    conn.rollback()
    return found


def _standing(conetl: Callable[..., str]) -> list[str]:
    """Ids of the cones on the map that drives found, from west to east."""
    found = json.loads(conetl("map", "show", "--json"))["features"]
    cones = [one for one in found if one["category"] == "traffic_cone" and one["xyz_m"][0] < ORIGIN_M[0] + 80.0]
    return [
        one["feature_id"] for one in sorted(cones, key=lambda one: (one["xyz_m"][1] < ORIGIN_M[1], one["xyz_m"][0]))
    ]


def _layer(coordinates: list[list[float]]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": {"kind": "line_thin"},
        "geometry": {"type": "LineString", "coordinates": coordinates},
    }


def _plans(conetl: Callable[..., str], folder: Path) -> None:
    """Some agree, some do not; one list is imported twice, with changes."""
    named = {"road": "L 605", "lanes": "left lane"}
    plans = [
        permit("in place", line((14.0, 46.0), 2.0), status="approved", version="3", **named), permit("aside", line(y_m=400.0)),
        permit("empty", line((2.0, 9.0), -0.5), days=(-1.5, 8.25)), permit("later", days=(5, 9)),
        permit("longer", line((11.0, 40.0), -4.5), days=(-2.0, 9.5)),
    ]  # fmt: skip
    path = write(folder / "permits.geojson", *plans)
    conetl("zones", "plan", "import", path)
    plans[0] = permit("in place", line((12.0, 38.0), 2.2), status="changed", version="4", **named)
    conetl(
        "zones",
        "plan",
        "import",
        write(path, *plans, permit("broken", {"type": "Point", "coordinates": ["x", 1]})),
        code=1,
    )
    found = json.loads(conetl("zones", "compare", "--as-of", "2026-03-06", "--json"))["rows"]
    empty = next(row["difference_id"] for row in found if row["plan_id"] == "empty")
    said = ("--as-of", "2026-03-06", "--note", "by phone", "--by", "Eve")
    conetl("zones", "judge", empty, "accepted", *said)


def _points(folder: Path) -> None:
    """Surveyed feet of the cones of the last day, 2 to 9 cm from where they are; and a point where no cone is."""
    feet = [
        ORIGIN_M + cone.foot_m + (0.02 + 0.01 * k, -0.03 + 0.005 * k, 0.015) for k, cone in enumerate(world.DAYS[3])
    ]
    for name, some in (("points", feet), ("far_points", [feet[0] + (0.0, 300.0, 0.0)])):
        rows = [f"P{k},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(some)]
        (folder / f"{name}.csv").write_text("\n".join(["name,easting_m,northing_m,ellipsoidal_height_m", *rows]) + "\n")


def _west(conn: Connection) -> None:
    """A second map, west of Greenwich: a row of cones of which one moves on the second day."""
    cov_m2 = (0.0121, 0.0066, -0.0012, 0.0289, 0.0023, 0.0484)
    cones = [
        records.feature(
            f"west {k}", seen_ns=START_NS + k * 10**9, existence_probability=0.91 + 0.0125 * k, observation_count=4 + k,
            **records.standing_at((458_001.5 + 5.25 * k, 5_428_010.25 + 0.75 * k, 114.5 + 0.125 * k), 0.71 - 0.03 * k, cov_m2),
        )
        for k in range(5)
    ]  # fmt: skip
    options: dict[str, Any] = {"map_name": "west", "srid": 32611}
    records.commit(conn, *(records.added(cone) for cone in cones), key="a1", start_ns=START_NS, **options)
    x, y, z = cones[2].xyz_m
    later_ns = START_NS + world.DAY_NS
    moved = records.changed(
        "moved",
        cones[2],
        later_ns,
        observation_count=11,
        **records.standing_at((x + 0.75, y - 1.5, z + 0.0625), 0.6, cov_m2),
    )
    records.commit(conn, moved, key="a2", start_ns=later_ns, **options)
    conn.commit()


def _zones(conn: Connection) -> None:
    """A third map: two work zones that a later drive joins, and one 600 m away, where the last drive, held, finds none."""
    row = [Cone((10.0 + 4.0 * k, 3.6 - 0.03 * k, 0.0), height_m=0.7 - 0.01 * k) for k in range(14)]
    far = [Cone((612.0 + 4.5 * k, -3.2 - 0.3 * k, 0.0), height_m=0.52 + 0.02 * k) for k in range(5)]
    driven = (([*row[:5], *row[9:]], 0.0, 75), (far, 600.0, 40), (row, 0.0, 75), ([], 600.0, 45))
    for day, (cones, start_m, frames) in enumerate(driven):
        first_ns = START_NS + day * world.DAY_NS
        rng = np.random.default_rng([7, day])
        made = world.survey_of(cones, rng, f"zones_{day}", frames=frames, start_m=start_m, first_ns=first_ns)
        _merge(conn, made, map_name="zones")


def _watched(conn: Connection) -> None:
    """A cone near one of the map and one that is new, of a drive that is being recorded."""
    watched = WatchedDrive(UUID(int=77), "default", 32632, "tonight", "drives/tonight")
    at_ns = START_NS + 9 * world.DAY_NS
    near, far = (tuple(ORIGIN_M + at_m) for at_m in ((14.125, 3.5, 0.0625), (77.5, -2.25, 0.125)))
    cov_m2 = (0.0121, 0.0012, 0.0003, 0.0225, -0.0004, 0.0361)
    tracks = {
        number: records.track(
            number, 3 + number, seen_ns=at_ns + number * 10**9, existence_probability=0.91 - 0.125 * number,
            **records.standing_at(at_m, 0.69 - 0.125 * number, cov_m2),
        )
        for number, at_m in enumerate((near, far))
    }  # fmt: skip
    write_live(
        conn, watched, captured_ns=(at_ns, at_ns + 5 * 10**9), frame_pair_count=51, tracks=tracks, taken_back=(),
        least_reach_m=0.5,
    )  # fmt: skip


def _failed(conn: Connection, folder: Path) -> None:
    """Receipts of entries that are not on the map: failed twice, not finished, and repaired."""
    with map_transaction(conn):
        latest = list_changesets(conn)[0]
    states: list[tuple[str, int, str, dict[str, Any]]] = [
        ("broken", 1, "failed", {"reason": "no usable pose"}), ("broken", 2, "failed", {"reason": "no calibration"}),
        ("running", 1, "started", {}), ("repaired", 1, "failed", {"reason": "it will pass"}),
        ("repaired", 2, "committed", {"changeset_id": latest.changeset_id, "seconds": 12.5, "content_sha256": "0" * 64}),
    ]  # fmt: skip
    for number, (drive_id, attempt, state, values) in enumerate(states):
        one = Receipt(
            attempt_id=UUID(int=1000 + number), map_name="default", drive_path=f"{folder}/{drive_id}", drive_id=drive_id,
            header_sha256=f"{len(drive_id) * 7:064x}", analysis_sha256="0" * 64, frame_pairs=10 + attempt, flow_run_id=None,
            host="host", state=state, **values,
        )  # fmt: skip
        write_receipt(conn, one, folder)
        at = WRITTEN + timedelta(hours=2 * number, seconds=7)
        execute(
            conn,
            "update conetl.receipt set at = %(at)s where attempt_id = %(id)s and state = %(state)s",
            {"at": at, "id": one.attempt_id, "state": state},
        )
        conn.commit()
