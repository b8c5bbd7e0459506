"""Two synthetic maps of millions of cones, made by set-based SQL, and a drive along the roads of one of them.

`load_roads`: cones every 5 m beside winding roads of 50 km, 100 m apart; every 100,000 of them were founded by one drive and,
with history, confirmed by another one a day later. All audits pass. `make_closures`: closures of 100 cones along roads in a
square of 40 km, with any number of versions a day apart, each confirmed (and every tenth feature moved by 1 m) by a changeset
of its own.
"""

# ruff: noqa: E501 -- SQL

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from uuid import NAMESPACE_URL, UUID, uuid5

import numpy as np

from conetl.db.connection import Connection, execute, execute_count
from conetl.mapping.visibility import NotObserved
from conetl.model.base import Vec3
from conetl.model.drive import Drive, FramePair, Pose, Position, Track
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from conetl.model.rig import Camera, Rig

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
#: What the database compares states by.
RECONCILE = ReconcileParams().model_dump_json()

_POSITION = f"""ST_SetSRID(ST_MakePoint(
    {WEST_M} + {SPACING_M} * (i %% {ROAD_CONES}),
    {SOUTH_M} + {ROAD_DISTANCE_M} * (i / {ROAD_CONES}) + 8 * sin({SPACING_M} * (i %% {ROAD_CONES}) / 300.0),
    100 + {{up}}), {SRID})"""
_CELL = f"conetl.cell_at({_POSITION.format(up=0)})"
_ID = "uuid_in(md5('cone ' || i)::cstring)"


def position_of(numbers: np.ndarray) -> np.ndarray:
    """(N, 3) metres of cones by number."""
    along = SPACING_M * (numbers % ROAD_CONES)
    north = SOUTH_M + ROAD_DISTANCE_M * (numbers // ROAD_CONES) + 8 * np.sin(along / 300.0)
    return np.column_stack([WEST_M + along, north, np.full(len(numbers), 100.0)])


def load_roads(conn: Connection, count: int, *, history: bool = True) -> None:
    """Fill an empty, migrated database with a map of `count` features."""
    with _without_indexes(conn):
        [row] = execute(
            conn,
            "insert into conetl.map (map_name, srid, created_at) values (%(name)s, %(srid)s, '2026-03-01') returning map_id",
            {"name": MAP_NAME, "srid": SRID},
        )
        for start in range(0, count, BLOCK):
            _load_block(conn, row["map_id"], start, min(BLOCK, count - start), history)
    conn.commit()
    _analyse(conn)


def make_closures(conn: Connection, map_name: str, *, features: int, versions: int = 1) -> None:
    """Write the map of closures and commit."""
    parameters = {"map": map_name, "features": features, "versions": versions, "reconcile": RECONCILE}
    execute(conn, "set local session_replication_role = replica")  # no checks of foreign keys and overlaps
    for statement in _CLOSURES:
        execute_count(conn, statement, parameters)
    conn.commit()
    _analyse(conn)


def _analyse(conn: Connection) -> None:
    execute(conn, "update conetl.drive set rig = %(rig)s", {"rig": _rig().model_dump_json()})
    execute(conn, _FRAME)
    execute(conn, _CELLS)
    conn.commit()
    conn.autocommit = True
    execute(conn, "vacuum analyze")
    conn.autocommit = False


def _load_block(conn: Connection, map_id: int, start: int, count: int, history: bool) -> None:
    """`count` features from `start` on: founded by one drive, with history confirmed by the next."""
    at = position_of(np.array([start, start + count - 1]))
    box = f"{at[0, 0] - 100} {at[0, 1] - 60}, {WEST_M + ROAD_CONES * SPACING_M + 100} {at[1, 1] + 60}"
    values = {"map_id": map_id, "srid": SRID, "start": start, "stop": start + count - 1, "box": f"BOX({box})"}
    values["reconcile"] = RECONCILE
    days = []
    for day in (0, 1):
        key = hashlib.sha256(f"{MAP_NAME} {start} {day}".encode()).hexdigest()
        day_values = {
            "key": key,
            "drive": uuid5(NAMESPACE_URL, f"drive {key}"),
            "changeset": uuid5(NAMESPACE_URL, f"changeset {key}"),
            "from_ns": FOUNDED_NS + day * DAY_NS,
            "committed_s": FOUNDED_NS / 1e9 + day * 86400 + 43200 + start / BLOCK / 1000,
            "kind": ("added", "confirmed")[day],
            "count": count,
        }
        days.append(values | day_values)
        for sql in (_DRIVE, _CHANGESET) if day == 0 or history else ():
            execute(conn, sql, days[day])
    first, second = days
    both = first | {"later": second["changeset"], "later_s": second["committed_s"], "later_ns": second["from_ns"]}
    both["history"] = history
    for sql in (_FEATURES, _VERSIONS, _DELTAS):
        execute(conn, sql, both)


#: One of the first drive: the view counts its metres from there.
_FRAME = """
insert into conetl.frame_pair (drive_uuid, frame_index, left_path, right_path, captured_at_ns, geom, map_r_body, sigma_enu_m, sigma_rpy_rad)
select d.drive_uuid, 0, '', '', d.captured_from_ns, ST_SetSRID(ST_MakePoint(ST_XMin(d.area), ST_YMin(d.area), 100), d.srid),
    array[1, 0, 0, 0, 1, 0, 0, 0, 1], array[0.01, 0.01, 0.01], array[0.001, 0.001, 0.001]
from conetl.drive d
join conetl.changeset c using (drive_uuid)
where c.changeset_no = 1
on conflict do nothing"""
#: Triggers were off.
_CELLS = """
insert into conetl.feature_cell (map_id, zoom, x, y, category, is_line, feature_count, sum_cm)
select v.map_id, z, floor(ST_X(v.geom) / 2 ^ (20 - z)), floor(ST_Y(v.geom) / 2 ^ (20 - z)), v.category, v.line is not null, count(*),
    array[sum(round(ST_X(v.geom) * 100)), sum(round(ST_Y(v.geom) * 100)), sum(round(ST_Z(v.geom) * 100))]::bigint[]
from conetl.feature_version v
cross join conetl.cell_zooms() z
where v.present and upper_inf(v.system_period) and upper_inf(v.valid_period)
group by 1, 2, 3, 4, 5, 6
on conflict do nothing"""
_CLOSURES = (
    "insert into conetl.map (map_name, srid, created_at) values (%(map)s, 32632, '2026-01-01T00:00Z')",
    """
    insert into conetl.drive (drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig, captured_from_ns, captured_to_ns,
        captured_period, expected_frame_count, reconcile, influence_m, area)
    select md5(%(map)s || 'drive' || d)::uuid, m.map_id, 32632, 'drive_' || d, 'synthetic', encode(sha256((%(map)s || d)::bytea), 'hex'),
        '{}', 1772352000000000000 + d * 86400000000000, 1772352060000000000 + d * 86400000000000,
        tstzrange(timestamptz '2026-03-01T08:00Z' + d * interval '1 day', timestamptz '2026-03-01T08:01Z' + d * interval '1 day'),
        1, %(reconcile)s, 60, ST_MakeEnvelope(450000, 5420000, 490000, 5460000, 32632)
    from conetl.map m, generate_series(0, %(versions)s - 1) d
    where m.map_name = %(map)s
    """,
    """
    insert into conetl.changeset (changeset_id, map_id, changeset_no, drive_uuid, idempotency_key, params_sha256, model_sha256, code_version,
        committed_at, change_counts, frame_pair_count, detection_count, match_count, position_count, track_count, marking_count,
        rejection_count)
    select md5(%(map)s || 'changeset' || d)::uuid, m.map_id, d + 1, md5(%(map)s || 'drive' || d)::uuid,
        encode(sha256((%(map)s || 'key' || d)::bytea), 'hex'), '', '', '0', timestamptz '2026-03-01T20:00Z' + d * interval '1 day',
        '{"points": {}, "lines": {}}', 0, 0, 0, 0, 0, 0, 0
    from conetl.map m, generate_series(0, %(versions)s - 1) d
    where m.map_name = %(map)s
    """,
    """
    insert into conetl.feature (feature_id, map_id, srid, created_by, cell)
    select md5(%(map)s || k)::uuid, m.map_id, 32632, md5(%(map)s || 'changeset0')::uuid,
        conetl.cell_at(ST_MakePoint(450000 + mod((k / 100) * 7919, 40000), 5420000 + mod((k / 100) * 104729, 40000)))
    from conetl.map m, generate_series(1, %(features)s) k
    where m.map_name = %(map)s
    """,
    """
    insert into conetl.feature_version (cell, feature_id, version, map_id, srid, changeset_id, present, suppressed, category, geom,
        cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, centre_geom, object_height_m, object_height_sigma_m, existence_probability,
        observation_count, seen_count, missed_count, first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period)
    select conetl.cell_at(ST_MakePoint(450000 + mod((k / 100) * 7919, 40000), 5420000 + mod((k / 100) * 104729, 40000))),
        md5(%(map)s || k)::uuid, d + 1, m.map_id, 32632, md5(%(map)s || 'changeset' || d)::uuid, true, false, 'traffic_cone',
        ST_SetSRID(ST_MakePoint(x, y, z), 32632), 0.0004 + s, s / 10, 0, 0.0005 + s, 0, 0.0009 + s,
        ST_SetSRID(ST_MakePoint(x, y, z + 0.35), 32632), case k %% 2 when 0 then 0.5 else 0.75 end, 0.02, 0.9 + (k %% 97) * 0.001,
        3 + d, d + 1, 0, 1772352000000000000 + k, 1772352000000000000 + d * 86400000000000 + k + 1,
        1772352000000000000 + d * 86400000000000 + k,
        tstzrange(timestamptz '2026-03-01T08:00:00.000001Z' + d * interval '1 day',
            case when d < %(versions)s - 1 then timestamptz '2026-03-02T08:00:00.000001Z' + d * interval '1 day' end),
        tstzrange(timestamptz '2026-03-01T20:00Z' + d * interval '1 day', null)
    from conetl.map m, generate_series(1, %(features)s) k, generate_series(0, %(versions)s - 1) d,
    lateral (
        select
            450000 + mod((k / 100) * 7919, 40000) + (k %% 100) * 3.017 + case when k %% 10 = 0 then d else 0 end as x,
            5420000 + mod((k / 100) * 104729, 40000) + (k %% 100) * 0.731 as y, 110 + mod(k, 977) * 0.013 as z,
            0.0001 * mod(k, 13) as s
    ) place
    where m.map_name = %(map)s
    """,
    """
    insert into conetl.delta (cell, changeset_id, feature_id, kind, old_version, new_version, track_index, changed_at_ns, changed_at, shift_m,
        system_period, of_line)
    select v.cell, v.changeset_id, v.feature_id, case when v.version = 1 then 'added' else 'confirmed' end, nullif(v.version - 1, 0), v.version,
        null, v.valid_from_ns, lower(v.valid_period), case when v.version > 1 then 0 end, v.system_period, false
    from conetl.feature_version v
    join conetl.map m using (map_id)
    where m.map_name = %(map)s
    """,
)
_DRIVE = """
insert into conetl.drive (drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig, captured_from_ns, captured_to_ns,
    captured_period, expected_frame_count, reconcile, influence_m, area)
select %(drive)s, %(map_id)s, %(srid)s, %(key)s, '', %(key)s, '{}', %(from_ns)s, %(from_ns)s + 3600000000000,
    tstzrange(to_timestamp(%(from_ns)s / 1e9), to_timestamp(%(from_ns)s / 1e9 + 3600), '[]'), 1, %(reconcile)s, 60,
    ST_SetSRID(%(box)s::box2d::geometry, %(srid)s)"""
_CHANGESET = """
insert into conetl.changeset (changeset_id, map_id, changeset_no, drive_uuid, idempotency_key, params_sha256, model_sha256, code_version,
    committed_at, change_counts, frame_pair_count, detection_count, match_count, position_count, track_count, marking_count,
    rejection_count)
values (%(changeset)s, %(map_id)s,
    (select coalesce(max(c.changeset_no), 0) + 1 from conetl.changeset c where c.map_id = %(map_id)s), %(drive)s, %(key)s, '', '', 'bench', to_timestamp(%(committed_s)s),
    jsonb_build_object('points', jsonb_build_object(%(kind)s, %(count)s), 'lines', '{}'::jsonb), 0, 0, 0, 0, 0, 0, 0)"""
_FEATURES = f"""
insert into conetl.feature (feature_id, map_id, srid, created_by, cell)
select {_ID}, %(map_id)s, %(srid)s, %(changeset)s, {_CELL} from generate_series(%(start)s, %(stop)s) i"""
_VERSIONS = f"""
insert into conetl.feature_version (cell, feature_id, version, map_id, srid, changeset_id, present, category, geom,
    cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, centre_geom, object_height_m, object_height_sigma_m, existence_probability,
    observation_count, seen_count, missed_count, first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period)
select
    {_CELL},
    {_ID}, r.version, %(map_id)s, %(srid)s, case r.version when 1 then %(changeset)s::uuid else %(later)s::uuid end, true,
    'traffic_cone', {_POSITION.format(up=0)}, 0.01, 0.001, 0.0, 0.02, 0.0, 0.04, {_POSITION.format(up=0.35)}, 0.7, 0.02,
    0.9 + 0.09 * (r.version - 1), 3 * r.version, r.version, 0, %(from_ns)s,
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
    cell, changeset_id, feature_id, kind, old_version, new_version, changed_at_ns, changed_at, shift_m, system_period, of_line
)
select {_CELL}, d.changeset_id, {_ID}, d.kind, d.old_version, d.new_version, d.at_ns, to_timestamp(d.at_ns / 1e9), d.shift_m,
    tstzrange(to_timestamp(d.at_s), null), false
from (
    values (%(changeset)s::uuid, 'added', null, 1, %(from_ns)s, %(committed_s)s, null),
        (%(later)s::uuid, 'confirmed', 1, 2, %(later_ns)s, %(later_s)s, 0.0)
) d (changeset_id, kind, old_version, new_version, at_ns, at_s, shift_m), generate_series(%(start)s, %(stop)s) i
where %(history)s or d.kind = 'added'"""


@contextmanager
def _without_indexes(conn: Connection) -> Iterator[None]:
    """Drop indexes and constraints of the large tables and create them again at the end, which is several times as fast."""
    execute(conn, "set local maintenance_work_mem = '1GB'")
    execute(conn, "set local session_replication_role = replica")  # no checks of overlaps without an index
    constraints: list[str] = []
    keys: list[str] = []
    for table in ("conetl.feature", "conetl.feature_version", "conetl.delta"):
        rows = execute(
            conn,
            "select conname, conrelid::regclass::text as rel, pg_get_constraintdef(oid) as text, contype from pg_constraint "
            "where contype in ('f', 'p', 'u', 'x') and (conrelid = %(t)s::regclass or confrelid = %(t)s::regclass) "
            "order by contype <> 'f'",
            {"t": table},
        )
        for row in rows:
            execute(conn, f"alter table {row['rel']} drop constraint if exists {row['conname']}")
            statement = f"alter table {row['rel']} add constraint {row['conname']} {row['text']}"
            (keys if row["contype"] == "f" else constraints).append(statement)
        indexes = "select indexrelid::regclass::text as name, pg_get_indexdef(indexrelid) as text from pg_index where indrelid = %(t)s::regclass"
        for row in execute(conn, indexes, {"t": table}):
            execute(conn, f"drop index {row['name']}")
            constraints.append(row["text"])
    yield
    for statement in dict.fromkeys([*constraints, *keys]):
        execute(conn, statement)


@dataclass(frozen=True)
class SyntheticDrive:
    """A drive with its tracks in memory, and the cones that it did not find."""

    drive: Drive
    positions: list[Position]
    tracks: list[Track]
    gone: frozenset[UUID]

    def check_visibility(self, feature: MapFeature, _offset_m: np.ndarray, _others_m: np.ndarray) -> NotObserved | None:
        """Visibility is computed in another step; here it is known. -5: six frame pairs in plain view."""
        return NotObserved(6, self.tracks[0].first_seen_ns, -5.0) if feature.feature_id in self.gone else None


def cone_id(number: int) -> UUID:
    return UUID(bytes=hashlib.md5(f"cone {number}".encode(), usedforsecurity=False).digest())


def drive_along(first: int, count: int, *, seed: int = 1, days: int = 2, sightings: int = 1) -> SyntheticDrive:
    """A drive past `count` cones from number `first` on: 92 % confirmed, 3 % moved by 1.5 m, 5 % gone, and 5 % new ones.

    sightings: positions per track. The drive is off the map by (0.3, -0.2) m, and tracks scatter by 5 cm.
    """
    rng = np.random.default_rng(seed)
    numbers = np.arange(first, first + count)
    fate = rng.random(count)
    positions_m = position_of(numbers)
    fresh = positions_m[rng.random(count) < 0.05] + (2.5, 1.2, 0.0)
    positions_m[fate > 0.97, 1] += 1.5
    kept = positions_m[fate > 0.05]
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
    sha256 = hashlib.sha256(drive_id.encode()).hexdigest()
    drive = Drive.model_construct(
        drive_id=drive_id, source_path=drive_id, rig=_rig(), map_srid=SRID, content_sha256=sha256, frame_pairs=tuple(pairs),
        expected_frame_count=len(pairs),
    )  # fmt: skip
    return SyntheticDrive(drive, positions, tracks, frozenset(cone_id(int(n)) for n in numbers[fate <= 0.05]))


def _path(first: int, count: int, start_ns: int) -> list[FramePair]:
    """A frame pair every 10 m beside the cones, road after road."""
    at = position_of(np.arange(first, first + count, max(1, round(FRAME_STEP_M / SPACING_M))))
    identity = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return [
        FramePair.model_construct(
            frame_index=k, left_path="", right_path="", captured_at_ns=start_ns + k * 500_000_000,
            pose=Pose.model_construct(
                map_R_body=identity, map_t_body_m=(x, y - 3.0, z), sigma_enu_m=(0.3, 0.3, 0.5),
                sigma_rpy_rad=(0.001, 0.001, 0.002),
            ),
        )
        for k, (x, y, z) in enumerate(at.tolist())
    ]  # fmt: skip


def _rig() -> Rig:
    identity = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    camera = Camera(width_px=1242, height_px=375, fx_px=721.5, fy_px=721.5, cx_px=609.6, cy_px=172.9)
    half_a_metre = ((1.0, 0.0, 0.0, 0.5), *identity[1:])
    return Rig(rig_id="bench", left=camera, right=camera, body_SE3_left=identity, body_SE3_right=half_a_metre)


def _position(frame: int, match: int, xyz_m: Vec3) -> Position:
    return Position.model_construct(
        frame_index=frame, match_index=match, xyz_m=xyz_m, cov_m2=COV, centre_xyz_m=xyz_m, object_height_m=0.7,
        camera_xyz_m=(0.5, 1.6, 12.0), camera_cov_m2=COV, range_m=12.0, ray_angle_rad=0.04, residual_rms_px=0.3, iterations=3,
        score=0.9,
    )  # fmt: skip


def _track(index: int, xyz_m: Vec3, members: tuple[tuple[int, int], ...], seen_ns: int) -> Track:
    return Track.model_construct(
        track_index=index, category="traffic_cone", xyz_m=xyz_m, cov_m2=COV,
        relative_cov_m2=(0.0025, 0.0, 0.0, 0.0025, 0.0, 0.01), centre_xyz_m=(xyz_m[0], xyz_m[1], xyz_m[2] + 0.35),
        object_height_m=0.7, object_height_sigma_m=0.02, existence_probability=0.97, observation_count=len(members),
        first_seen_ns=seen_ns, last_seen_ns=seen_ns + 200_000_000, residual_rms_px=0.3, nearest_range_m=9.0, members=members,
    )  # fmt: skip
