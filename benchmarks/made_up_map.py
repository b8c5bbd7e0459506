"""A made-up map of millions of cones, loaded with set-based SQL, and a drive along its roads: for `bench_map.py`.

Cones stand every 5 m beside roads of 50 km that lie 100 m apart and swing gently. Every 100,000 of them were founded by one
drive. With history they were confirmed by another one a day later, so each feature has three rows: as first believed, as
believed since, and as it is now. All of it passes the audits.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from uuid import NAMESPACE_URL, UUID, uuid5

import numpy as np

from conetl.db.connection import Connection, execute
from conetl.mapping.visibility import NotObserved
from conetl.model.map_records import MapFeature
from conetl.model.records import (
    Camera,
    Drive,
    FramePair,
    Pose,
    Position,
    Rig,
    Track,
    Vec3,
)

SRID = 32632
MAP_NAME = "bench"
ROAD_CONES = 10_000
SPACING_M = 5.0
ROAD_DISTANCE_M = 100.0
WEST_M, SOUTH_M = 400_000.0, 5_400_000.0
BLOCK = 100_000
#: 2026-03-01 08:00 UTC
FOUNDED_NS = 1_772_352_000_000_000_000
DAY_NS = 86_400_000_000_000
COV = (0.01, 0.001, 0.0, 0.02, 0.0, 0.04)
FRAME_STEP_M = 10.0

_PLACE = f"""ST_SetSRID(ST_MakePoint(
    {WEST_M} + {SPACING_M} * (i %% {ROAD_CONES}),
    {SOUTH_M} + {ROAD_DISTANCE_M} * (i / {ROAD_CONES}) + 8 * sin({SPACING_M} * (i %% {ROAD_CONES}) / 300.0),
    100 + {{up}}), {SRID})"""
_CELL = f"conetl.cell_at({_PLACE.format(up=0)})"
_ID = "uuid_in(md5('cone ' || i)::cstring)"


def place_of(numbers: np.ndarray) -> np.ndarray:
    """(N, 3) metres of cones by number."""
    along = SPACING_M * (numbers % ROAD_CONES)
    north = SOUTH_M + ROAD_DISTANCE_M * (numbers // ROAD_CONES) + 8 * np.sin(along / 300.0)
    return np.column_stack([WEST_M + along, north, np.full(len(numbers), 100.0)])


def load_map(conn: Connection, count: int, *, history: bool = True, map_name: str = MAP_NAME) -> None:
    """Fill an empty, migrated database with a map of `count` features (a multiple of 100,000), and analyse it."""
    with _without_indexes(conn):
        execute(
            conn,
            "insert into conetl.map (map_name, srid, created_at) values (%(name)s, %(srid)s, '2026-03-01')",
            {"name": map_name, "srid": SRID},
        )
        map_id = execute(conn, "select map_id from conetl.map where map_name = %(name)s", {"name": map_name})[0][
            "map_id"
        ]
        for start in range(0, count, BLOCK):
            _load_block(conn, map_id, map_name, start, history)
    conn.commit()
    conn.autocommit = True
    execute(conn, "vacuum analyze")
    conn.autocommit = False


def _load_block(conn: Connection, map_id: int, map_name: str, start: int, history: bool) -> None:
    """The features from `start` on: founded by one drive, with history confirmed by the next."""
    at = place_of(np.array([start, start + BLOCK - 1]))
    box = f"{at[0, 0] - 100} {at[0, 1] - 60}, {WEST_M + ROAD_CONES * SPACING_M + 100} {at[1, 1] + 60}"
    values = {"map_id": map_id, "srid": SRID, "start": start, "stop": start + BLOCK - 1, "box": f"BOX({box})"}
    days = []
    for day in (0, 1):
        key = hashlib.sha256(f"{map_name} {start} {day}".encode()).hexdigest()
        days.append(
            values
            | {
                "key": key,
                "drive": uuid5(NAMESPACE_URL, f"drive {key}"),
                "changeset": uuid5(NAMESPACE_URL, f"changeset {key}"),
                "from_ns": FOUNDED_NS + day * DAY_NS,
                "committed_s": FOUNDED_NS / 1e9 + day * 86400 + 43200 + start / BLOCK / 1000,
                "added": BLOCK if day == 0 else 0,
                "confirmed": BLOCK if day == 1 else 0,
            }
        )
        for sql in (_DRIVE, _CHANGESET) if day == 0 or history else ():
            execute(conn, sql, days[day])
    first, second = days
    both = first | {"later": second["changeset"], "later_s": second["committed_s"], "later_ns": second["from_ns"]}
    both["history"] = history
    for sql in (_FEATURES, _VERSIONS, _DELTAS):
        execute(conn, sql, both)


_DRIVE = """
insert into conetl.drive (drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig, captured_from_ns, captured_to_ns,
    captured_period, expected_frame_count, reconcile, influence_m, area)
select %(drive)s, %(map_id)s, %(srid)s, %(key)s, '', %(key)s, '{}', %(from_ns)s, %(from_ns)s + 3600000000000,
    tstzrange(to_timestamp(%(from_ns)s / 1e9), to_timestamp(%(from_ns)s / 1e9 + 3600), '[]'), 1, '{}', 60,
    ST_SetSRID(%(box)s::box2d::geometry, %(srid)s)"""
_CHANGESET = """
insert into conetl.changeset (changeset_id, map_id, drive_uuid, idempotency_key, params_sha256, model_sha256, code_version,
    committed_at, added_count, confirmed_count, moved_count, removed_count, frame_pair_count, detection_count, match_count,
    position_count, track_count, rejection_count)
values (%(changeset)s, %(map_id)s, %(drive)s, %(key)s, '', '', 'bench', to_timestamp(%(committed_s)s), %(added)s, %(confirmed)s,
    0, 0, 0, 0, 0, 0, 0, 0)"""
_FEATURES = f"""
insert into conetl.feature (feature_id, map_id, srid, created_by, cell)
select {_ID}, %(map_id)s, %(srid)s, %(changeset)s, {_CELL} from generate_series(%(start)s, %(stop)s) i"""
_VERSIONS = f"""
insert into conetl.feature_version (cell, feature_id, version, map_id, srid, changeset_id, present, category, geom,
    cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, centre_geom, cone_height_m, cone_height_sigma_m, existence_probability,
    observation_count, first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period)
select
    {_CELL},
    {_ID}, r.version, %(map_id)s, %(srid)s, case r.version when 1 then %(changeset)s::uuid else %(later)s::uuid end, true,
    'traffic_cone', {_PLACE.format(up=0)}, 0.01, 0.001, 0.0, 0.02, 0.0, 0.04, {_PLACE.format(up=0.35)}, 0.7, 0.02,
    0.9 + 0.09 * (r.version - 1), 3 * r.version, %(from_ns)s,
    case r.version when 1 then %(from_ns)s else %(later_ns)s end + 200000000,
    case r.version when 1 then %(from_ns)s else %(later_ns)s end,
    tstzrange(
        to_timestamp(case r.version when 1 then %(from_ns)s else %(later_ns)s end / 1e9),
        case when r.ended then to_timestamp(%(later_ns)s / 1e9) end
    ),
    tstzrange(
        to_timestamp(case when r.closed then %(committed_s)s else %(later_s)s end),
        case when r.closed and %(history)s then to_timestamp(%(later_s)s) end
    )
from (values (1, false, true), (1, true, false), (2, false, false)) r (version, ended, closed),
    generate_series(%(start)s, %(stop)s) i
where %(history)s or r.closed"""
_DELTAS = f"""
insert into conetl.delta (
    cell, changeset_id, feature_id, kind, old_version, new_version, changed_at_ns, changed_at, shift_m, system_period
)
select {_CELL}, d.changeset_id, {_ID}, d.kind, d.old_version, d.new_version, d.at_ns, to_timestamp(d.at_ns / 1e9), d.shift_m,
    tstzrange(to_timestamp(d.at_s), null)
from (
    values (%(changeset)s::uuid, 'added', null, 1, %(from_ns)s, %(committed_s)s, null),
        (%(later)s::uuid, 'confirmed', 1, 2, %(later_ns)s, %(later_s)s, 0.0)
) d (changeset_id, kind, old_version, new_version, at_ns, at_s, shift_m), generate_series(%(start)s, %(stop)s) i
where %(history)s or d.kind = 'added'"""


@contextmanager
def _without_indexes(conn: Connection) -> Iterator[None]:
    """Indexes and foreign keys of the large tables are made again at the end, which is several times as fast."""
    execute(conn, "set local maintenance_work_mem = '1GB'")
    tables = ("feature", "feature_version", "delta")
    again = []
    for table in tables:
        constraints = execute(
            conn,
            "select conname, conrelid::regclass::text as rel, pg_get_constraintdef(oid) as text, contype from pg_constraint "
            "where contype in ('f', 'p', 'u', 'x') and (conrelid = %(t)s::regclass or confrelid = %(t)s::regclass) "
            "order by contype <> 'f'",
            {"t": f"conetl.{table}"},
        )
        for row in constraints:
            execute(conn, f"alter table {row['rel']} drop constraint if exists {row['conname']}")
            again.append(
                (row["contype"] == "f", f"alter table {row['rel']} add constraint {row['conname']} {row['text']}")
            )
        for row in execute(
            conn,
            "select indexrelid::regclass::text as name, pg_get_indexdef(indexrelid) as text from pg_index "
            "where indrelid = %(t)s::regclass",
            {"t": f"conetl.{table}"},
        ):
            execute(conn, f"drop index {row['name']}")
            again.append((False, row["text"]))
    yield
    for _, statement in sorted(dict.fromkeys(again), key=lambda pair: pair[0]):  # foreign keys last
        execute(conn, statement)


# --------------------------------------------------------------------------- one more drive


@dataclass(frozen=True)
class Sightings:
    """A drive with its tracks in memory, and the cones that it found gone."""

    drive: Drive
    positions: list[Position]
    tracks: list[Track]
    gone: frozenset[UUID]

    def check_visibility(self, feature: MapFeature, _offset_m: np.ndarray, _others_m: np.ndarray) -> NotObserved | None:
        """Where the drive looked is another step's work: here the answer is known. -5: six looks in plain view."""
        return NotObserved(6, self.tracks[0].first_seen_ns, -5.0) if feature.feature_id in self.gone else None


def cone_id(number: int) -> UUID:
    return UUID(bytes=hashlib.md5(f"cone {number}".encode(), usedforsecurity=False).digest())


def drive_along(first: int, count: int, *, seed: int = 1, days: int = 2, sightings: int = 1) -> Sightings:
    """A drive past `count` cones from number `first` on: 92 % confirmed, 3 % moved by 1.5 m, 5 % gone, and 5 % new ones.

    sightings: positions a track. The drive lies (0.3, -0.2) m off the map, and tracks scatter by 5 cm.
    """
    rng = np.random.default_rng(seed)
    numbers = np.arange(first, first + count)
    fate = rng.random(count)
    places = place_of(numbers)
    fresh = places[rng.random(count) < 0.05] + (2.5, 1.2, 0.0)
    moved = fate > 0.97
    places[moved, 1] += 1.5
    kept = places[fate > 0.05]
    seen = np.vstack([kept, fresh])
    seen = seen[np.argsort(seen[:, 1] // ROAD_DISTANCE_M * 1e6 + seen[:, 0], kind="stable")]
    seen = seen + np.array([0.3, -0.2, 0.05]) + rng.normal(0, 0.05, seen.shape)
    start_ns = FOUNDED_NS + days * DAY_NS
    pairs = _path(first, count, start_ns)
    frame_of = np.linspace(0, len(pairs) - sightings, len(seen)).astype(int)
    positions, tracks = [], []
    matches = np.zeros(len(pairs) + 1, int)
    for k, xyz in enumerate(seen.tolist()):
        members = []
        for frame in range(int(frame_of[k]), int(frame_of[k]) + sightings):
            members.append((frame, int(matches[frame])))
            matches[frame] += 1
            positions.append(_position(frame, members[-1][1], (xyz[0], xyz[1], xyz[2])))
        tracks.append(_track(k, (xyz[0], xyz[1], xyz[2]), tuple(members), pairs[members[0][0]].captured_at_ns))
    drive_id = f"{first} {count} {seed} {days}"
    drive = Drive.model_construct(
        drive_id=drive_id,
        source_path=drive_id,
        rig=_rig(),
        map_srid=SRID,
        content_sha256=hashlib.sha256(drive_id.encode()).hexdigest(),
        frame_pairs=tuple(pairs),
        expected_frame_count=len(pairs),
    )
    return Sightings(drive, positions, tracks, frozenset(cone_id(int(n)) for n in numbers[fate <= 0.05]))


def _path(first: int, count: int, start_ns: int) -> list[FramePair]:
    """A frame pair every 10 m beside the cones, road after road."""
    at = place_of(np.arange(first, first + count, max(1, round(FRAME_STEP_M / SPACING_M))))
    identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return [
        FramePair.model_construct(
            frame_index=k,
            left_path="",
            right_path="",
            captured_at_ns=start_ns + k * 500_000_000,
            pose=Pose.model_construct(
                map_R_body=identity,
                map_t_body_m=(x, y - 3.0, z),
                sigma_enu_m=(0.3, 0.3, 0.5),
                sigma_rpy_rad=(0.001, 0.001, 0.002),
            ),
        )
        for k, (x, y, z) in enumerate(at.tolist())
    ]


def _rig() -> Rig:
    identity = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    camera = Camera(width_px=1242, height_px=375, fx_px=721.5, fy_px=721.5, cx_px=609.6, cy_px=172.9)
    return Rig(rig_id="bench", left=camera, right=camera, body_SE3_left=identity, body_SE3_right=identity)


def _position(frame: int, match: int, xyz_m: Vec3) -> Position:
    return Position.model_construct(
        frame_index=frame,
        match_index=match,
        xyz_m=xyz_m,
        cov_m2=COV,
        centre_xyz_m=xyz_m,
        cone_height_m=0.7,
        camera_xyz_m=(0.5, 1.6, 12.0),
        camera_cov_m2=COV,
        range_m=12.0,
        ray_angle_rad=0.04,
        residual_rms_px=0.3,
        iterations=3,
        score=0.9,
    )


def _track(index: int, xyz_m: Vec3, members: tuple[tuple[int, int], ...], seen_ns: int) -> Track:
    return Track.model_construct(
        track_index=index,
        category="traffic_cone",
        xyz_m=xyz_m,
        cov_m2=COV,
        relative_cov_m2=(0.0025, 0.0, 0.0, 0.0025, 0.0, 0.01),
        centre_xyz_m=(xyz_m[0], xyz_m[1], xyz_m[2] + 0.35),
        cone_height_m=0.7,
        cone_height_sigma_m=0.02,
        existence_probability=0.97,
        observation_count=len(members),
        first_seen_ns=seen_ns,
        last_seen_ns=seen_ns + 200_000_000,
        residual_rms_px=0.3,
        nearest_range_m=9.0,
        members=members,
    )


def index_sizes(conn: Connection, tables: Sequence[str]) -> list[dict[str, object]]:
    """Size of each table and of each of its indexes in bytes."""
    return execute(
        conn,
        "select c.relname as table_name, i.relname as index_name, pg_relation_size(i.oid) as bytes, pg_table_size(c.oid) as heap "
        "from pg_class c join pg_index x on x.indrelid = c.oid join pg_class i on i.oid = x.indexrelid "
        "where c.relnamespace = 'conetl'::regnamespace and c.relname = any(%(tables)s) order by 1, 3 desc",
        {"tables": list(tables)},
    )
