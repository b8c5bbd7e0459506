"""Migrations, roles and the .sql files themselves."""

from __future__ import annotations

import hashlib
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext
from uuid import uuid4

import psycopg2
import pytest

from conetl.db.connection import connect, database_errors, execute, load_sql, require_writer, sql_directory, statements
from conetl.db.map.import_store import read_licence, set_licence
from conetl.db.map.map_store import read_current_features
from conetl.db.schema import database_status, migrate
from conetl.model.errors import DatabaseError
from tests.command import until
from tests.conftest import cloned_database


@pytest.fixture
def empty_url(cluster_url):
    """A database without conetl's schema."""
    with cloned_database(cluster_url, "template1") as url:
        yield url


@pytest.fixture
def empty(empty_url):
    """Open connection to `empty_url`."""
    with closing(connect(empty_url)) as conn:
        yield conn


def test_an_empty_database_becomes_ready(empty):
    before = database_status(empty)
    assert (before["postgis_version"], before["applied_migrations"]) == (None, ())
    assert before["pending_migrations"][0] == "0001_baseline"
    assert migrate(empty) == list(before["pending_migrations"])
    after = database_status(empty)
    assert after["applied_migrations"] and not after["pending_migrations"]
    assert after["pending_migrations"] == after["missing_roles"] == after["maps"] == ()
    assert after["postgis_version"].startswith("3.")
    assert migrate(empty) == []


def test_an_unmigrated_database_says_what_to_run(empty):
    with pytest.raises(DatabaseError, match=r"run `conetl db migrate`"):
        read_current_features(empty)


def test_migrations_at_the_same_time_wait_for_each_other(empty_url):
    def one(_):
        with closing(connect(empty_url)) as conn:
            return migrate(conn)

    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(one, range(4)))
    assert sorted(map(len, results))[:3] == [0, 0, 0]
    assert max(map(len, results)) >= 1


def test_a_changed_old_migration_is_an_error(conn, tmp_path):
    folder = shutil.copytree(sql_directory() / "migrations", tmp_path / "migrations")
    assert migrate(conn, directory=folder) == []
    file = folder / "0001_baseline.sql"
    file.write_text(file.read_text() + "-- changed\n")
    with pytest.raises(DatabaseError, match=r"0001_baseline\.sql was changed"):
        migrate(conn, directory=folder)


def test_a_failing_migration_leaves_the_database_as_it_was(empty, tmp_path):
    folder = tmp_path / "migrations"
    shutil.copytree(sql_directory() / "migrations", folder)
    number = len(list(folder.iterdir())) + 1
    (folder / f"{number:04d}_broken.sql").write_text("create table conetl.half (n integer); select 1 / 0;")
    with pytest.raises(DatabaseError, match=r"division by zero"):
        migrate(empty, directory=folder)
    assert database_status(empty)["applied_migrations"] == ()
    assert execute(empty, "select to_regclass('conetl.half') as half") == [{"half": None}]


def test_views_and_functions_are_made_again_when_their_files_change(conn, tmp_path, monkeypatch):
    folder = shutil.copytree(sql_directory(), tmp_path / "sql")
    monkeypatch.setattr("conetl.db.connection.sql_directory", lambda: folder)

    def made() -> int:
        return int(execute(conn, "select count(*) as n from schema_functions")[0]["n"])

    assert (migrate(conn), made()) == ([], 1), "as they were made"
    added = folder / "functions" / "9_more.sql"
    # A second time it would be an error.
    added.write_text("create view conetl.some_map as select map_name from conetl.map;")
    for _ in range(2):
        assert (migrate(conn), made()) == ([], 2)
    execute(conn, "set role conetl_reader")
    assert execute(conn, "select * from some_map") == []
    conn.rollback()
    added.write_text("create view conetl.another_map as select map_name from conetl.map; select 1 / 0;")
    with pytest.raises(DatabaseError, match="division by zero"):
        migrate(conn)
    assert made() == 2
    assert execute(conn, "select to_regclass('conetl.another_map') as name") == [{"name": None}]


def migrate_until(conn, number):
    """To the schema after one of the earlier migrations."""
    execute(conn, load_sql("schema.schema_migration"))
    for path in sorted((sql_directory() / "migrations").glob("*.sql"))[:number]:
        execute(conn, path.read_text())
        known = {"name": path.stem, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        execute(conn, load_sql("schema.insert_migration"), known)


def test_rows_of_an_older_schema_are_brought_along(empty, caplog):
    """Changesets were numbered over the whole database, with gaps where a transaction failed; positions of a track had rows."""
    migrate_until(empty, 4)
    made = """
        with m as (insert into map (map_name, srid, created_at) values ('a', 32632, now()), ('b', 32632, now()) returning map_id),
        d as (
            insert into drive (drive_uuid, map_id, srid, drive_id, source_path, content_sha256, captured_from_ns, captured_to_ns,
                captured_period, expected_frame_count, reconcile, influence_m, area, kind)
            select gen_random_uuid(), map_id, 32632, 'x', 'x', repeat('0', 64), 0, 1, '[2026-01-01,2026-01-02)', 0, '{}', 1,
                ST_SetSRID(ST_MakePoint(0, 0), 32632), 'import'
            from m cross join generate_series(1, 3) returning drive_uuid, map_id
        )
        insert into changeset overriding system value
        select gen_random_uuid(), 5 * row_number() over (order by drive_uuid), map_id, drive_uuid, null,
            md5(drive_uuid::text) || md5(''), '', '', '0', now(), 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
        from d"""
    execute(empty, made)
    track = """
        insert into track
        select drive_uuid, n, 'traffic_cone', area, 1, 0, 0, 1, 0, 1, 1, 0, 0, 1, 0, 1, area, 1, 1, 1, 3, 0, 0, 0, 5
        from (select drive_uuid, ST_Force3D(area) as area from drive order by drive_uuid limit 1) d, generate_series(1, 2) n"""
    members = "select track_index, frame_index, match_index from track_member order by drive_uuid, 1, 2, 3"
    execute(empty, track)
    execute(
        empty,
        "insert into track_member select drive_uuid, 1, f, 4 - f from track, unnest(array[3, 1, 2]) f where track_index = 1",
    )
    positions = execute(empty, members)
    order = "select array_agg(changeset_id::text order by changeset_no) as ids from changeset group by map_id order by map_id"
    before = execute(empty, order)
    empty.commit()
    assert "0005_managed_maps" in migrate(empty)
    assert "older versions of conetl refuse it from now on" in caplog.text
    numbers = (
        "select array_agg(changeset_no order by changeset_no) as numbers from changeset group by map_id order by map_id"
    )
    assert [row["numbers"] for row in execute(empty, numbers)] == [[1, 2, 3], [1, 2, 3]]
    assert execute(empty, order) == before
    assert execute(empty, members) == positions
    kept = execute(empty, "select members from track order by track_index")
    assert [row["members"] for row in kept] == [[[1, 3], [2, 2], [3, 1]], []]


#: Drives a to d of the days 0 to 3 of a map before migration 0016, in the order in which they came; their numbers are instants of
#: the database. A row of versions: drive, version, present, valid from and until which day, known from and until when. Of deltas:
#: drive, kind, old and new version, existence probability after it.
OLD_MAP = """
    create temporary table made as
    select
        letter, day * 86400000000000::bigint as ns, to_timestamp(day * 86400) as day_at, to_timestamp(1e9 + number) as at, number,
        md5(letter)::uuid as id, repeat(letter, 64) as hash, 1 as map_id, 32632 as srid,
        ST_SetSRID(ST_MakePoint(1, 2, 3), 32632) as geom
    from (values ('a', 0, 1), ('c', 2, 2), ('d', 3, 3), ('b', 1, 4)) given (letter, day, number);
    insert into map (map_name, srid, created_at) values ('default', 32632, now());
    insert into drive (drive_uuid, map_id, srid, drive_id, source_path, content_sha256, captured_from_ns, captured_to_ns,
        captured_period, expected_frame_count, reconcile, influence_m, area, rig)
    select id, map_id, srid, letter, '', hash, ns, ns, tstzrange(day_at, day_at, '[]'), 1, '{}', 1, ST_Force2D(geom), '{}'
    from made;
    insert into changeset (changeset_id, changeset_no, map_id, drive_uuid, idempotency_key, params_sha256, model_sha256,
        code_version, committed_at, added_count, confirmed_count, moved_count, removed_count, frame_pair_count, detection_count,
        match_count, position_count, track_count, rejection_count, missed_count, height_changed_count, split_count, merged_count,
        marking_count, line_counts)
    select id, number, map_id, id, hash, '', '', '', at, number, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, number - 1, 0,
        case number when 3 then '{"moved": 5}'::jsonb else '{}' end
    from made"""
OLD_FEATURE = """
    insert into feature (feature_id, map_id, srid, created_by, cell)
    select md5(%s)::uuid, map_id, srid, id, 0 from made limit 1"""
OLD_VERSION = """
    insert into feature_version (cell, feature_id, version, map_id, srid, changeset_id, present, category, geom, centre_geom,
        cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, cone_height_m, cone_height_sigma_m, existence_probability,
        observation_count, first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period)
    select 0, md5(%s)::uuid, v.version, map_id, srid, id, v.present, 'traffic_cone', geom, geom, 1, 0, 0, 1, 0, 1, 1, 1, 0.9,
        1, 0, 0, ns, tstzrange(to_timestamp(v.day * 86400), to_timestamp(v.until::int * 86400)),
        tstzrange(to_timestamp(1e9 + v.known), to_timestamp(1e9 + v.known_until::int))
    from made join (values %s) v (letter, version, present, day, until, known, known_until) using (letter)"""
OLD_DELTA = """
    insert into delta (cell, feature_id, changeset_id, kind, old_version, new_version, changed_at_ns, changed_at, existence_after,
        of_line, system_period)
    select 0, md5(%s)::uuid, id, x.kind, x.old::int, x.new, ns, day_at, x.existence, false, tstzrange(at, null)
    from made join (values %s) x (letter, kind, old, new, existence) using (letter)"""
OLD = {
    "seen": (
        [("a", 1, True, 0, None, 1, 2), ("a", 1, True, 0, 2, 2, None), ("c", 2, True, 2, None, 2, None)],
        [("a", "added", None, 1, 0.9), ("c", "confirmed", 1, 2, 0.9), ("d", "missed", 2, 2, 0.7), ("b", "missed", 1, 1, 0.6)],
    ),
    "gone": (
        [("a", 1, True, 0, None, 1, 2), ("a", 1, True, 0, 2, 2, None), ("c", 2, False, 2, None, 2, None)],
        [("a", "added", None, 1, 0.9), ("c", "removed", 1, 2, 0.2)],
    ),
}  # fmt: skip


def test_the_evidence_of_older_rows_is_that_of_their_deltas(empty):
    """The drive b came last; it missed a cone whose next version, by the drive c, stayed as it was."""
    migrate_until(empty, 15)
    execute(empty, OLD_MAP)
    for name, (versions, deltas) in OLD.items():
        execute(empty, OLD_FEATURE, [name])
        for sql, rows in ((OLD_VERSION, versions), (OLD_DELTA, deltas)):
            for row in rows:
                execute(empty, sql, [name, row])
    empty.commit()
    migrate(empty)

    def known(name, at):
        """As known after a commit: drive, version, valid from and until, seen, missed, first missed, existence, present."""
        rows = execute(
            empty,
            """
            select
                d.drive_id, v.version, (extract(epoch from lower(v.valid_period)) / 86400)::int as day,
                (extract(epoch from upper(v.valid_period)) / 86400)::int as until, v.seen_count, v.missed_count,
                v.first_missed_ns / 86400000000000 as missed_day, v.existence_probability, v.present
            from feature_version v join changeset c using (changeset_id) join drive d using (drive_uuid)
            where v.feature_id = md5(%s)::uuid and v.system_period @> to_timestamp(1e9 + %s)
            order by v.valid_period""",
            [name, at],
        )
        return [tuple(row.values()) for row in rows]

    assert known("seen", 1) == [("a", 1, 0, None, 1, 0, None, 0.9, True)]
    assert known("seen", 2) == [("a", 1, 0, 2, 1, 0, None, 0.9, True), ("c", 2, 2, None, 2, 0, None, 0.9, True)]
    assert known("seen", 3) == [
        ("a", 1, 0, 2, 1, 0, None, 0.9, True), ("c", 2, 2, 3, 2, 0, None, 0.9, True), ("d", 2, 3, None, 2, 1, 3, 0.7, True),
    ]  # fmt: skip
    assert known("seen", 4) == [
        ("a", 1, 0, 1, 1, 0, None, 0.9, True), ("b", 1, 1, 2, 1, 1, 1, 0.6, True),
        ("c", 2, 2, 3, 2, 1, None, 0.9, True), ("d", 2, 3, None, 2, 2, 3, 0.7, True),
    ]  # fmt: skip
    assert known("gone", 4) == [("a", 1, 0, 2, 1, 0, None, 0.9, True), ("c", 2, 2, None, 1, 1, None, 0.2, False)]
    for audit in ("evidence", "gaps_in_valid_periods", "open_versions", "overlapping_periods"):
        assert execute(empty, load_sql(f"audits.{audit}")) == [], audit
    counts = execute(empty, "select change_counts from changeset order by changeset_no")
    assert [row["change_counts"] for row in counts] == [
        {"points": {"added": 1}, "lines": {}},
        {"points": {"added": 2, "merged": 1}, "lines": {}},
        {"points": {"added": 3, "merged": 2}, "lines": {"moved": 5}},
        {"points": {"added": 4, "merged": 3}, "lines": {}},
    ]


def test_a_database_from_before_the_baseline_is_refused_and_left_alone(empty):
    execute(empty, load_sql("schema.schema_migration"))
    execute(empty, load_sql("schema.insert_migration"), {"name": "0001_schema", "sha256": "x"})
    empty.commit()
    with pytest.raises(DatabaseError, match=r"before the schema's baseline.*conetl map export.*Nothing was changed"):
        migrate(empty)
    assert database_status(empty)["applied_migrations"] == ("0001_schema",)


def test_a_database_of_a_newer_conetl_is_refused(conn):
    execute(conn, "insert into schema_migration values ('9999_future', 'x')")
    conn.commit()
    with pytest.raises(DatabaseError, match=r"newer conetl.*9999_future"):
        migrate(conn)


@pytest.mark.parametrize(
    ("names", "wanted"),
    [
        (["0001_first", "0001_second"], "0002_"),
        (["0001_first", "0003_third"], "0002_"),
        (["0002_second"], "0001_"),
        (["0001_First"], "0001_"),
    ],
)
def test_a_misnamed_migration_is_refused(conn, tmp_path, names, wanted):
    """Numbers are contiguous from 0001: one that is missing would come after the later ones where these were applied."""
    for name in names:
        (tmp_path / f"{name}.sql").write_text("select 1;")
    with pytest.raises(DatabaseError, match=f"{names[-1]}.sql .* should be named {wanted}"):
        migrate(conn, directory=tmp_path)


def test_an_unreachable_database_is_one_clear_error(tmp_path):
    with pytest.raises(DatabaseError, match=r"cannot be reached.*conetl db up") as caught:
        connect(f"postgresql://someone:secret@/conetl?host={tmp_path}")
    assert "secret" not in str(caught.value)


def test_a_server_that_refuses_a_connection_is_not_one_to_be_started(database_url):
    with pytest.raises(DatabaseError, match=r'database "nosuch" does not exist\. The server refuses') as caught:
        connect(f"{database_url}&dbname=nosuch")
    assert "conetl db up" not in str(caught.value)


def test_an_ordinary_database_user_is_told_what_is_missing(empty):
    name = f"plain_{uuid4().hex}"
    execute(empty, f"create role {name} nologin")
    execute(empty, f"grant create on database {empty.info.dbname} to {name}")
    empty.commit()
    execute(empty, f"set role {name}")
    empty.commit()
    status = database_status(empty)
    assert (status["user"], status["may_create_roles"]) == (name, False)
    with pytest.raises(DatabaseError, match=r"extension .*permission|permission denied"):
        migrate(empty)
    execute(empty, "reset role")
    execute(empty, f"drop owned by {name}")
    execute(empty, f"drop role {name}")
    empty.commit()


def test_missing_roles_are_made_by_whoever_may(conn):
    execute(conn, "revoke usage on schema conetl from conetl_reader")
    conn.commit()
    assert database_status(conn)["missing_roles"] == ("conetl_reader",)
    execute(conn, "set session authorization conetl_writer")
    conn.commit()
    assert migrate(conn) == []
    assert database_status(conn)["missing_roles"] == ("conetl_reader",)
    execute(conn, "reset session authorization")
    conn.commit()
    migrate(conn)
    assert database_status(conn)["missing_roles"] == ()


def test_the_reader_may_only_read(conn, samples):
    samples.commit(conn, samples.added(samples.feature()), key="1")
    execute(conn, "set role conetl_reader")
    assert len(execute(conn, "select * from current_feature")) == 1
    assert len(execute(conn, "select * from feature_states('default')")) == 1
    for statement in (
        "insert into run values (gen_random_uuid(), now(), now(), '{}', null)",
        "update feature_version set system_period = system_period",
        "delete from delta",
        "truncate delta",
        "drop table delta",
    ):
        execute(conn, "savepoint s")
        with pytest.raises(psycopg2.errors.InsufficientPrivilege):
            execute(conn, statement)
        execute(conn, "rollback to s")
    refused = pytest.raises(DatabaseError, match=r"permission denied for .*role conetl_writer")
    with refused, database_errors("The map cannot be changed"):
        execute(conn, "delete from delta")
    conn.rollback()
    for role, allowed in (("conetl_reader", False), ("conetl_writer", True)):
        execute(conn, f"set role {role}")
        conn.commit()
        with nullcontext() if allowed else pytest.raises(DatabaseError, match=r"may only read.*role conetl_writer"):
            require_writer(conn)


def test_the_queries_of_the_documentation_run_for_a_reader(conn):
    page = (sql_directory().parent / "docs/reference/database.md").read_text()
    [block] = re.findall(r"```sql\n(.*?)```", page, re.DOTALL)
    queries = [query for query in block.split(";\n") if query.strip()]
    assert len(queries) == 4
    execute(conn, "set role conetl_reader")
    for query in queries:
        assert execute(conn, query) == []


def test_gis_programs_can_list_the_layers(conn):
    """QGIS, GDAL and others ask PostGIS's view, which reads the constraints of all tables."""
    execute(conn, "set role conetl_reader")
    rows = execute(conn, "select * from public.geometry_columns where f_table_schema = 'conetl'")
    layers = {(row["f_table_name"], row["f_geometry_column"]): (row["type"], row["coord_dimension"]) for row in rows}
    assert layers["current_feature", "geom"] == ("POINT", 3) and layers["current_feature", "line"] == ("LINESTRING", 3)
    assert {"drive", "decision", "base_source", "provisional_feature"} <= {table for table, _ in layers}


def test_the_writer_may_commit_but_not_rewrite_history(conn, samples):
    samples.commit(conn, samples.added(samples.feature()), key="1")
    execute(conn, "set session authorization conetl_writer")
    conn.commit()
    assert migrate(conn) == []
    moved = samples.changed("moved", samples.feature(), samples.START_NS + 5, observation_count=9)
    samples.commit(conn, samples.added(samples.feature("b")), moved, key="2")
    set_licence(conn, "default", "CC BY 4.0")
    assert read_licence(conn, "default") == "CC BY 4.0"
    for statement in (
        "update feature_version set version = 7",
        "delete from feature_version",
        "delete from changeset",
        "update delta set shift_m = 0",
        "update feature set cell = 0",
        "update map set srid = 32633",
        "update receipt set reason = 'x'",
        "insert into schema_migration values ('x', 'y')",
    ):
        execute(conn, "savepoint s")
        with pytest.raises(psycopg2.errors.InsufficientPrivilege):
            execute(conn, statement)
        execute(conn, "rollback to s")


@pytest.fixture(scope="module")
def map_of_one(module_database_url, samples):
    """One feature; each test rolls back what it does to it."""
    conn = connect(module_database_url)
    samples.commit(conn, samples.added(samples.feature()), key="1")
    yield conn
    conn.close()


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ("geom = ST_SetSRID(geom, 32633)", psycopg2.errors.CheckViolation),
        ("centre_geom = ST_SetSRID(centre_geom, 32633)", psycopg2.errors.CheckViolation),
        ("cov_xx = -1", psycopg2.errors.CheckViolation),
        ("object_height_m = 'nan'", psycopg2.errors.CheckViolation),
        ("valid_period = '[2020-01-01, 2021-01-01]'", psycopg2.errors.CheckViolation),
        ("valid_period = 'empty'", psycopg2.errors.CheckViolation),
        ("srid = 32633", psycopg2.errors.ForeignKeyViolation),
        ("feature_id = gen_random_uuid()", psycopg2.errors.ForeignKeyViolation),
        ("cell = cell + 1", psycopg2.errors.ForeignKeyViolation),
    ],
)
def test_the_schema_itself_refuses_nonsense(map_of_one, change, error):
    conn = map_of_one
    if change == "srid = 32633":
        execute(conn, "alter table feature_version drop constraint srid_of_geom, drop constraint srid_of_centre_geom")
    with pytest.raises(error):
        execute(conn, f"update feature_version set {change}")
    conn.rollback()


def test_one_id_is_one_feature_whatever_its_cell(map_of_one):
    """So that a second cell is no way around the constraint that refuses two versions at once."""
    with pytest.raises(psycopg2.errors.UniqueViolation, match="feature_by_id"):
        execute(
            map_of_one,
            "insert into feature (feature_id, map_id, srid, created_by, cell) "
            "select feature_id, map_id, srid, created_by, cell + 1 from feature",
        )
    map_of_one.rollback()


@pytest.mark.parametrize(
    ("place", "cell"),
    [
        ("0, 0", (0, 0)),
        ("255.999, 256", (1, 0)),
        ("-0.001, -256.001", (-2, -1)),
        ("458001, 5428010", (21203, 1789)),
        ("'infinity', '-infinity'", (-(2**30), 2**30)),
        ("'nan', 0", (0, 2**30)),
    ],
)
def test_a_place_has_one_cell_of_256_m(map_of_one, place, cell):
    row, column = cell
    found = execute(map_of_one, f"select cell_at(ST_SetSRID(ST_MakePoint({place}), 32632)) as cell")
    assert found == [{"cell": (row << 32) + column}]


@pytest.mark.parametrize(("north_m", "swing_m", "count"), [(0, 8, 1), (4000, 8, 4), (4000, 0, 4)])
def test_the_pieces_of_an_area_hold_what_it_holds(map_of_one, north_m, swing_m, count):
    """A straight road in one piece, an oblique one in many, whose boxes together are little larger than the road."""
    sql = f"""
        with road as (
            select ST_Buffer(ST_MakeLine(ST_MakePoint(i * 10, i * {north_m} / 500.0 + {swing_m} * sin(i / 30.0))
                order by i), 68) as area
            from generate_series(0, 500) i
        ),
        piece as (select p as piece from road, pieces(road.area) p),
        point as (
            select ST_MakePoint(x * 41.3 - 100, x * 41.3 * {north_m} / 5000.0 + y * 9.7 - 200) as point
            from generate_series(0, 130) x, generate_series(0, 40) y
        ),
        told as (
            select ST_Intersects(point, area) as inside, exists (select from piece where ST_Intersects(point, piece)) as found
            from point, road
        )
        select
            (select count(*) from piece) >= {count} as cut, (select sum(ST_Area(ST_Envelope(piece))) < 6 * ST_Area(area)
            from piece, road group by area) as narrow,
            bool_and(inside = found) as same, bool_or(inside) and not bool_and(inside) as both_kinds
        from told"""
    assert execute(map_of_one, sql) == [{"cut": True, "narrow": True, "same": True, "both_kinds": True}]


@pytest.mark.parametrize(
    ("period", "refused"),
    [
        ("[2026-03-02,)", True),
        ("[2026-03-01 23:59:59.999999,)", True),
        ("[2026-03-02,2026-03-02 00:00:00.000001)", True),
        ("[2026-02-01,2026-03-01)", False),
        ("[2026-02-01,2026-03-01 00:00:00.000001)", True),
        ("[-infinity,infinity)", True),
    ],
)
def test_versions_of_a_feature_may_touch_and_not_overlap(map_of_one, period, refused):
    conn = map_of_one
    execute(conn, "update feature_version set valid_period = '[2026-03-01,)'")
    execute(conn, "create temp table copy as select * from feature_version")
    execute(
        conn, "update copy set version = 2, version_row_id = version_row_id + 1000, valid_period = %(p)s", {"p": period}
    )
    insert = "insert into feature_version overriding system value select * from copy"
    if refused:
        with pytest.raises(psycopg2.errors.ExclusionViolation, match="no_overlap"):
            execute(conn, insert)
    else:
        execute(conn, insert)
        with pytest.raises(psycopg2.errors.ExclusionViolation, match="no_overlap"):
            execute(conn, "update feature_version set valid_period = '[2026-02-01,)' where version = 2")
    conn.rollback()


def test_of_two_sessions_the_second_sees_what_the_first_wrote(conn, database_url, samples):
    samples.commit(conn, samples.added(samples.feature()), key="1")
    execute(conn, "create table copy as select v.* from feature_version v, generate_series(1, 2)")
    execute(
        conn,
        "update copy set version_row_id = n + 1000, version = n, "
        "valid_period = tstzrange('2020-01-01'::date + n::int, '2021-01-01') "
        "from (select ctid as id, row_number() over () + 1 as n from copy) numbered where copy.ctid = numbered.id",
    )
    conn.commit()
    insert = "insert into feature_version overriding system value select * from copy where version = "
    execute(conn, insert + "2")

    def insert_another() -> None:
        with closing(connect(database_url)) as other:
            execute(other, insert + "3")

    waiting = (
        "select 1 from pg_locks l join pg_database d on d.oid = l.database "
        "where d.datname = current_database() and l.locktype = 'advisory' and not l.granted"
    )
    with ThreadPoolExecutor(1) as pool:
        another = pool.submit(insert_another)
        until(lambda: execute(conn, waiting), "the other session waits")
        conn.commit()
        with pytest.raises(psycopg2.errors.ExclusionViolation, match="no_overlap"):
            another.result()


#: `columns.sql` holds lists of columns for the statements of the others.
TOPICS = sorted(path.stem for path in sql_directory().glob("*.sql") if path.stem != "columns")


@pytest.mark.parametrize("name", [f"{topic}.{name}" for topic in TOPICS for name in statements(topic)])
def test_every_statement_says_its_purpose_and_names_its_parameters(name):
    text = load_sql(name)
    header = re.match(r"(--.*\n)+", text)
    assert header and header[0][3].isupper(), f"{name} has no purpose"
    if "Parameters: as the columns" not in header[0]:
        for parameter in set(re.findall(r"%\((\w+)\)s", text[header.end() :])):
            assert parameter in header[0], f"{name} does not explain {parameter}"
    if not name.startswith("schema."):
        body = re.sub(r"'[^']*'|--.*", "", text[header.end() :])
        assert body.count(";") == 1 and body.endswith(";"), f"{name} should hold one statement"


@pytest.mark.parametrize(
    ("name", "message"), [("no_such.thing", "cannot be read"), ("map.no_such", "has no statement no_such")]
)
def test_a_statement_that_is_not_there_is_reported(name, message):
    with pytest.raises(DatabaseError, match=message):
        load_sql(name)
