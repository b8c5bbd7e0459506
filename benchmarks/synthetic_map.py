"""A made-up map of millions of cones, written by the server itself: for benchmarks of what reads the map.

Cones stand in closures of 100 along roads in a square of 40 km; feature k has `versions` versions, a day apart on the road and in the
database, each confirmed (and every tenth feature moved by 1 m) by a changeset of its own.
"""

# ruff: noqa: E501 -- SQL

from __future__ import annotations

from conetl.db.connection import Connection, execute, execute_count

SRID = 32632
_STATEMENTS = (
    "insert into conetl.map (map_name, srid, created_at) values (%(map)s, 32632, '2026-01-01T00:00Z')",
    """
    insert into conetl.drive (drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig, captured_from_ns, captured_to_ns,
        captured_period, expected_frame_count, reconcile, influence_m, area)
    select md5(%(map)s || 'drive' || d)::uuid, m.map_id, 32632, 'drive_' || d, 'made up', encode(sha256((%(map)s || d)::bytea), 'hex'),
        '{}', 1772352000000000000 + d * 86400000000000, 1772352060000000000 + d * 86400000000000,
        tstzrange(timestamptz '2026-03-01T08:00Z' + d * interval '1 day', timestamptz '2026-03-01T08:01Z' + d * interval '1 day'),
        1, '{}', 60, ST_MakeEnvelope(450000, 5420000, 490000, 5460000, 32632)
    from conetl.map m, generate_series(0, %(versions)s - 1) d
    where m.map_name = %(map)s
    """,
    """
    insert into conetl.changeset (changeset_id, map_id, drive_uuid, idempotency_key, params_sha256, model_sha256, code_version,
        committed_at, added_count, confirmed_count, moved_count, removed_count, frame_pair_count, detection_count, match_count,
        position_count, track_count, rejection_count)
    select md5(%(map)s || 'changeset' || d)::uuid, m.map_id, md5(%(map)s || 'drive' || d)::uuid,
        encode(sha256((%(map)s || 'key' || d)::bytea), 'hex'), '', '', '0', timestamptz '2026-03-01T20:00Z' + d * interval '1 day',
        0, 0, 0, 0, 0, 0, 0, 0, 0, 0
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
        cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, centre_geom, cone_height_m, cone_height_sigma_m, existence_probability,
        observation_count, first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period)
    select conetl.cell_at(ST_MakePoint(450000 + mod((k / 100) * 7919, 40000), 5420000 + mod((k / 100) * 104729, 40000))),
        md5(%(map)s || k)::uuid, d + 1, m.map_id, 32632, md5(%(map)s || 'changeset' || d)::uuid, true, false, 'traffic_cone',
        ST_SetSRID(ST_MakePoint(x, y, z), 32632), 0.0004 + s, s / 10, 0, 0.0005 + s, 0, 0.0009 + s,
        ST_SetSRID(ST_MakePoint(x, y, z + 0.35), 32632), case k %% 2 when 0 then 0.5 else 0.75 end, 0.02, 0.9 + (k %% 97) * 0.001,
        3 + d, 1772352000000000000 + k, 1772352000000000000 + d * 86400000000000 + k + 1,
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
        system_period)
    select v.cell, v.changeset_id, v.feature_id, case when v.version = 1 then 'added' else 'confirmed' end, nullif(v.version - 1, 0), v.version,
        null, v.valid_from_ns, lower(v.valid_period), case when v.version > 1 then 0 end, v.system_period
    from conetl.feature_version v
    join conetl.map m using (map_id)
    where m.map_name = %(map)s
    """,
)


def make_map(conn: Connection, map_name: str, *, features: int, versions: int = 1) -> None:
    """Write the map and commit. The exclusion constraint is put aside while loading (its index alone takes minutes) unless others use it."""
    parameters = {"map": map_name, "features": features, "versions": versions}
    execute(conn, "alter table conetl.feature_version drop constraint no_overlap")
    execute(conn, "set local session_replication_role = replica")  # no foreign key checks row by row
    for statement in _STATEMENTS:
        execute_count(conn, statement, parameters)
    conn.commit()
    execute(conn, "analyze conetl.feature, conetl.feature_version, conetl.delta, conetl.changeset")
    conn.commit()
