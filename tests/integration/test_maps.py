"""`conetl map list|create|rename|delete|restore`, `--map`, and numbers of changesets per map."""

from __future__ import annotations

import json
import signal
import zipfile
from contextlib import closing
from uuid import uuid4

import pytest

from conetl.db.connection import connect, execute, load_sql, transaction
from conetl.db.map.archive import delete_map, rename_map
from conetl.db.map.map_store import insert_map
from conetl.db.receipt_store import Receipt, try_lock, write_receipt
from conetl.model.errors import MapMismatchError
from conetl.pipeline import ingest as ingesting
from conetl.pipeline.maps.decisions import decide_location, revert
from conetl.pipeline.settings import Settings
from tests.command import free_port
from tests.conftest import filled_template
from tests.integration.drives_of_days import failed_audits, merge, survey
from tests.integration.small_drives import SAMPLES, cut_drive

#: Tables of the schema that a dump does not have: bookkeeping, the map itself, and what is shown while a drive is recorded.
NOT_DUMPED = {
    "schema_migration", "schema_functions", "map", "watched_drive", "provisional_feature", "feature_cell",
    "notice_round", "notice_receiver", "notice_delivery",
}  # fmt: skip


@pytest.fixture(scope="module")
def template_database(cluster_url, template_database):
    """Each test has a database with two maps."""
    with filled_template(cluster_url, template_database, two_maps) as name:
        yield name


def two_maps(conn):
    """`north` with three drives and decisions, one of them withdrawn, and `south` with two drives."""
    for day in (0, 2, 1):
        merge(conn, survey(day), map_name="north")
    for day in (0, 1):
        merge(conn, survey(day), map_name="south")
    conn.commit()
    [feature, *_] = features_of(conn, "north")
    decide_location(conn, "pin", feature, map_name="north", radius_m=1.0, note="bollard", decided_by="ann")
    reverted = revert(conn, "2", map_name="north", note="", decided_by="ann")
    revert(conn, str(reverted.decision_id), map_name="north", note="", decided_by="bob")


def features_of(conn, name):
    rows = execute(
        conn, "select feature_id from conetl.current_feature where map_name = %(name)s order by 1", {"name": name}
    )
    conn.rollback()
    return [str(row["feature_id"]) for row in rows]


def everything_of(conn, name):
    """Every row of every table that belongs to a map, as text, without what the database numbers itself."""
    [key] = execute(conn, "select map_id, map_name from conetl.map where map_name = %(name)s", {"name": name})
    rows = {}
    for table in execute(conn, load_sql("archive.tables"), {}):
        query = f"select {table['columns']} from conetl.{table['table_name']} where {table['condition']}"
        found = [row["t"] for row in execute(conn, f"select q::text as t from ({query}) q", key)]
        rows[table["table_name"]] = sorted(found)
    conn.rollback()
    return rows


def test_changesets_are_numbered_per_map_and_every_command_has_the_option(conetl):
    for name, count in (("north", 3), ("south", 2)):
        log = json.loads(conetl("map", "log", "--map", name, "--json"))
        assert [c["changeset_no"] for c in log] == list(range(count, 0, -1))
    assert conetl("map", "diff", 1, 2, "--map", "south") != conetl("map", "diff", 1, 2, "--map", "north")
    assert "Map south" in conetl("map", "show", "--map", "south")
    assert "has no changeset 3" in conetl("map", "diff", 1, 3, "--map", "south", code=2)


READING = (
    "map show", "map log", "map diff 1 2", "map picture x.png", "map export --out x.geojson", "map licence",
    "map export --out x.json --format wzdx", "map qgis --out x.qgz", "map check-layout", "map check-points x.csv",
    "map suppress a", "map pin a", "map revert 1", "map decisions", "report drive 1", "report night", "report quality",
    "base list", "base drop x", "drive held", "drive accept x", "view",
)  # fmt: skip


def test_a_view_without_its_map_says_which_there_are(conetl, monkeypatch):
    notes = []
    monkeypatch.setattr("conetl.cli.view.note", notes.append)
    monkeypatch.setattr("conetl.cli.view.uvicorn.Server.run", lambda *_, **__: None)
    before = signal.getsignal(signal.SIGINT)
    conetl("view", "--port", free_port())
    signal.signal(signal.SIGINT, before)
    [said] = notes
    assert said.startswith("this database has no map named default; it has north, south. Choose one with --map")


def test_a_misspelt_map_is_named_with_its_neighbours(conetl):
    for command in READING:
        said = conetl(*command.split(), "--map", "nroth", code=2)
        assert "no map named nroth; did you mean north" in said, command
    assert "it has north, south" in conetl("map", "show", "--map", "zzz", code=2)


def test_maps_are_created_listed_and_renamed(conetl, conn):
    assert "no map named default, and no other" not in conetl("map", "show", code=2)
    conetl("map", "create", "east", "--crs", "EPSG:25832")
    assert "invalid map name" in conetl("map", "create", "Weſt", "--crs", "EPSG:25832", code=2)
    listed = {m["map_name"]: m for m in json.loads(conetl("map", "list", "--json"))}
    assert [(name, m["changeset_count"]) for name, m in listed.items()] == [("east", 0), ("north", 3), ("south", 2)]
    before = everything_of(conn, "north")
    assert "already exists" in conetl("map", "rename", "north", "south", code=2)
    conetl("map", "rename", "north", "old_north")
    assert everything_of(conn, "old_north") == before


def test_a_map_that_a_drive_is_ingested_into_keeps_its_name(conetl, conn, database_url, tmp_path):
    """The next drive of the backfill would make a new map of the old name."""
    started = Receipt(
        attempt_id=uuid4(), map_name="north", drive_path="/drives/d9", drive_id="d9", header_sha256="0" * 64,
        analysis_sha256="1" * 64, frame_pairs=9, flow_run_id=None, host="here",
    )  # fmt: skip
    write_receipt(conn, started, tmp_path)
    with closing(connect(database_url)) as other, try_lock(other, started.drive_lock):
        for command in (("rename", "north", "old"), ("delete", "north", "--yes")):
            assert "map north: drive d9 is being ingested into it" in conetl("map", *command, code=2)
    left = Settings(home=tmp_path / "home", map_name="old").reports_folder
    left.mkdir(parents=True)
    assert f"{left}: contains reports of an earlier map old" in conetl("map", "rename", "north", "old", code=2)
    left.rename(left.with_name("south"))
    assert "already exists" in conetl("map", "rename", "north", "south", code=2)
    conetl("map", "rename", "north", "old")  # the process of the drive is gone


@pytest.mark.parametrize("change", ["rename", "delete"])
def test_a_map_that_is_gone_at_the_end_of_an_ingest_is_not_made_anew(change, conn, database_url, tmp_path, monkeypatch):
    """Neither is the drive written into a map of another name that the same id had."""
    drive = cut_drive(SAMPLES[0], tmp_path / "drive")
    with transaction(conn, "a map"):
        insert_map(conn, "east", 32632)
    true = ingesting.analyse

    def analyse(*arguments, **options):
        with closing(connect(database_url)) as other:
            if change == "rename":
                rename_map(other, "east", "west")
            else:
                delete_map(other, "east", tmp_path / "east.zip")
        return true(*arguments, **options)

    monkeypatch.setattr(ingesting, "analyse", analyse)
    settings = Settings(home=tmp_path / "home", database_url=database_url, map_name="east", workers=1)
    with pytest.raises(MapMismatchError, match="map east was renamed or deleted during the ingest"):
        ingesting.ingest(drive, settings=settings, map_srid=32632)
    names = [row["map_name"] for row in execute(conn, "select map_name from conetl.map order by 1")]
    assert names == ["north", "south", *(["west"] if change == "rename" else [])]
    assert execute(conn, "select * from conetl.drive where drive_id = 'drive'") == []


def test_a_renamed_map_goes_on_and_its_name_is_free_again(conetl, conn):
    """Ids are those that the map would have without the other name, and a new map of the old name may have the same drives."""
    conetl("map", "rename", "south", "valley")
    merge(conn, survey(2), map_name="valley")
    merge(conn, survey(0), map_name="south")
    conn.commit()
    assert merge(conn, survey(0), map_name="valley") is None
    merge(conn, survey(3), map_name="south")
    conn.commit()
    assert not set(features_of(conn, "south")) & set(features_of(conn, "valley"))
    assert failed_audits(conn) == []
    # The late drive replays the others: they find their features, whose ids have the old name.
    was = set(features_of(conn, "valley"))
    revert(conn, "3", map_name="valley", note="", decided_by="ann")
    merge(conn, survey(1), map_name="valley")
    conn.commit()
    assert was & set(features_of(conn, "valley"))
    assert failed_audits(conn) == []


def test_a_deleted_map_is_restored_as_it_was(conetl, conn, tmp_path):
    dump = tmp_path / "north.zip"
    before, other = everything_of(conn, "north"), everything_of(conn, "south")
    assert "add --yes" in conetl("map", "delete", "north", "--dump", dump, code=2)
    assert not dump.exists()
    assert f"conetl map restore {dump}" in conetl("map", "delete", "north", "--dump", dump, "--yes").replace("\n", " ")
    assert "no map named north" in conetl("map", "show", "--map", "north", code=2)
    assert everything_of(conn, "south") == other
    assert failed_audits(conn) == []
    conetl("map", "restore", dump)
    assert everything_of(conn, "north") == before and everything_of(conn, "south") == other
    assert failed_audits(conn) == []
    assert "already exists" in conetl("map", "restore", dump, code=2)
    assert "same ids as those of the map north" in conetl("map", "restore", dump, "--map", "copy", code=2)
    assert "already exists" in conetl("map", "delete", "north", "--yes", "--dump", dump, code=2)
    # It goes on: a drive that is on it is known, a new one is compared.
    assert merge(conn, survey(2), map_name="north") is None
    assert merge(conn, survey(3), map_name="north") is not None
    conn.commit()
    assert [c["changeset_no"] for c in json.loads(conetl("map", "log", "--map", "north", "--json"))] == [4, 3, 2, 1]


DAMAGES = (
    "not a zip", "without manifest", "rows missing", "rows broken", "half of the deltas", "rows of another map",
    "a name like a path", "no schema", "deep",
)  # fmt: skip


def test_a_damaged_dump_changes_nothing(conetl, conn, tmp_path):
    dump, bad = tmp_path / "north.zip", tmp_path / "bad.zip"
    conetl("map", "delete", "north", "--dump", dump, "--yes")
    assert dump.stat().st_mode & 0o777 == 0o600
    [south] = execute(conn, "select changeset_id::text from conetl.changeset limit 1")
    conn.rollback()
    for damage in DAMAGES:
        write_damaged(dump, bad, damage, south["changeset_id"])
        said = conetl("map", "restore", bad, code=2)
        assert "bad.zip" in said and len(said.splitlines()) <= 3, damage
        assert damage != "rows of another map" or "belong to another map" in said.replace("\n", " ")
        assert [m["map_name"] for m in json.loads(conetl("map", "list", "--json"))] == ["south"], damage


def write_damaged(dump, bad, damage, changeset_of_another_map):
    """A copy of a dump with one damage."""
    bad.write_bytes(b"PK but not a zip")
    if damage != "not a zip":
        with zipfile.ZipFile(dump) as whole, zipfile.ZipFile(bad, "w") as file:
            for name in whole.namelist():
                data = whole.read(name)
                if name == "manifest.json" and damage == "without manifest":
                    continue
                if name == "feature":
                    data = {"rows missing": b"", "rows broken": data.replace(b"\t", b"\tx")}.get(damage, data)
                if name == "delta" and damage == "half of the deltas":
                    data = b"".join(data.splitlines(keepends=True)[::2])
                if name == "changeset_published" and damage == "rows of another map":
                    data = f"{changeset_of_another_map}\t2026-03-02 10:00:00+00\n".encode()
                if name == "manifest.json":
                    manifest = json.loads(data)
                    if damage == "rows of another map":
                        manifest["rows"]["changeset_published"] = 1
                    if damage == "a name like a path":
                        manifest["map"]["map_name"] = "../../north"
                    if damage == "no schema":
                        manifest["schema"] = []
                    data = b"[" * 200_000 if damage == "deep" else json.dumps(manifest).encode()
                file.writestr(name, data)


def test_a_dump_has_every_table(conn):
    known = {row["table_name"] for row in execute(conn, load_sql("archive.tables"), {})}
    query = "select c.relname from pg_class c where c.relnamespace = 'conetl'::regnamespace and c.relkind = 'r'"
    assert known | NOT_DUMPED == {row["relname"] for row in execute(conn, query)}
