"""Receipts and plans on a real PostGIS: what is done, what is not, and what a crash looks like."""

from __future__ import annotations

import errno
import json
import os
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from conetl.db.connection import execute
from conetl.db.map.map_store import list_changesets
from conetl.db.receipt_store import Receipt, end_crashed, held_locks, holding, latest_receipts, run_lock, write_receipt
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.pipeline import chunks, entries
from conetl.pipeline.backfill_plan import Plan, plan_as_dict, plan_drives
from conetl.pipeline.chunks import analysis_of
from conetl.pipeline.entries import Entry
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "drives"
DAY = 86_400
ROOT = Path("drives")


def headers(count: int) -> list[DriveHeader]:
    """Simulated drives, one a day from 2026-01-01 on."""
    start_ns = int(datetime(2026, 1, 1, tzinfo=UTC).timestamp()) * 1_000_000_000
    return [
        DriveHeader(
            ROOT / f"d{i:04d}",
            f"d{i:04d}",
            f"{i:064x}",
            100,
            start_ns + i * DAY * 10**9,
            start_ns + i * DAY * 10**9 + 10**10,
            None,
        )
        for i in range(count)
    ]


@pytest.fixture
def plan(conn: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """`plan(headers, **options)`: a plan over drives that need not exist."""

    def make(drives: list[DriveHeader], **options: Any) -> Plan:
        by_path = {drive.path: drive for drive in drives}
        monkeypatch.setattr(entries, "read_header", by_path.__getitem__)
        return plan_drives(
            conn, ROOT, settings=Settings(), params=IngestParams(), entries=map(Entry, by_path), **options
        )

    return make


@pytest.fixture
def receipt(conn: Any, tmp_path: Path) -> Any:
    """`receipt(header, state, **values)`: writes a receipt, with the start before an end."""

    def write(header: DriveHeader, state: str, **values: Any) -> Receipt:
        analysis = analysis_of(IngestParams(), Settings()).sha256
        started = Receipt(
            attempt_id=uuid4(), map_name="default", drive_path=str(header.path), drive_id=header.drive_id,
            header_sha256=header.header_sha256, analysis_sha256=analysis, frame_pairs=100, flow_run_id=None, host="here",
        )  # fmt: skip
        started = replace(started, **{k: v for k, v in values.items() if k == "analysis_sha256"})
        write_receipt(conn, started, tmp_path)
        if state != "started":
            write_receipt(conn, replace(started, state=state, **values), tmp_path)
        return started

    return write


def latest(conn: Any, drive: DriveHeader) -> Receipt:
    return latest_receipts(conn, map_name="default", headers=[drive.header_sha256])[drive.header_sha256]


def actions(plan: Plan) -> list[tuple[str, str]]:
    return [(line.header.drive_id, line.action) for line in plan.lines]


def test_new_drives_are_planned_in_the_order_of_their_recording(plan: Any) -> None:
    made = plan(list(reversed(headers(3))))
    assert actions(made) == [("d0000", "ingest"), ("d0001", "ingest"), ("d0002", "ingest")]
    assert made.frame_pairs == 300
    assert made.estimate_s(1) is None
    assert json.loads(json.dumps(plan_as_dict(made, 2)))["to_ingest"] == 3


def test_since_belongs_to_the_span_and_until_does_not(plan: Any) -> None:
    made = plan(headers(5), since=datetime(2026, 1, 2, tzinfo=UTC), until=datetime(2026, 1, 4, tzinfo=UTC))
    assert [name for name, _ in actions(made)] == ["d0001", "d0002"]


def test_a_span_that_ends_before_it_begins_is_refused(plan: Any) -> None:
    """Such a plan was one of no drives, as where there are none."""
    with pytest.raises(
        InputError, match=r"--until \(2026-01-02 00:00 UTC\) must be later than --since \(2026-01-04 00:00"
    ):
        plan(headers(5), since=datetime(2026, 1, 4, tzinfo=UTC), until=datetime(2026, 1, 2, tzinfo=UTC))


def test_what_is_done_is_left_alone_and_only_what_failed_is_tried_again(
    plan: Any, receipt: Any, conn: Any, samples: Any
) -> None:
    samples.commit(conn, samples.added(samples.feature()), key="a")
    drives = headers(5)
    receipt(drives[0], "committed", changeset_id=changeset_id(conn), seconds=50.0, may_pass=False)
    receipt(drives[1], "failed", reason="no usable pose", may_pass=False)
    receipt(drives[2], "started")
    receipt(drives[3], "committed", changeset_id=changeset_id(conn), analysis_sha256="ab" * 32, may_pass=False)
    made = plan(drives)
    assert [action for _, action in actions(made)] == ["skip", "ingest", "ingest", "ingest", "ingest"]
    why = [line.why for line in made.lines]
    assert "no usable pose" in why[1]
    assert "interrupted" in why[2]
    assert "other parameters" in why[3]
    assert why[4] == "new"
    assert made.pairs_per_second == 2.0
    assert made.estimate_s(2) == 400 / 2.0 / 2
    assert [action for _, action in actions(plan(drives, recheck=True))] == ["ingest"] * 5


def test_a_schedule_leaves_alone_what_failed_until_it_changes(plan: Any, receipt: Any) -> None:
    drives = headers(4)
    receipt(drives[0], "failed", reason="no usable pose", may_pass=False)
    receipt(drives[1], "crashed", reason="signal 9", may_pass=True)
    for _ in range(3):
        receipt(drives[2], "crashed", reason="signal 9", may_pass=True)
    made = plan([*drives[:3], replace(drives[3], problem="there are no images")], once=True)
    assert [action for _, action in actions(made)] == ["skip", "ingest", "skip", "refuse"]
    changed = replace(drives[0], header_sha256="f" * 64)
    assert plan([changed], once=True).lines[0].action == "ingest"


def test_a_drive_that_was_ingested_by_hand_is_known(plan: Any, on_the_map: DriveHeader) -> None:
    known = on_the_map
    other = replace(known, path=ROOT / "other", header_sha256="e" * 64, captured_from_ns=known.captured_to_ns)
    assert [line.action for line in plan([known, other]).lines] == ["skip", "ingest"]


@pytest.fixture
def on_the_map(conn: Any, samples: Any) -> DriveHeader:
    """A recording of which a changeset with the present parameters and model was made; its receipts are the test's."""
    samples.commit(conn, samples.added(samples.feature()), key="a")
    analysis = analysis_of(IngestParams(), Settings())
    [made] = list_changesets(conn)
    conn.rollback()
    execute(
        conn,
        "update conetl.changeset set params_sha256 = %(p)s, model_sha256 = %(m)s, idempotency_key = %(k)s",
        {
            "p": analysis.params_sha256, "m": analysis.model_sha256,
            "k": analysis.changeset_key(made.content_sha256, made.map_srid),
        },
    )  # fmt: skip
    conn.commit()
    return replace(
        headers(1)[0], drive_id="drive_a", captured_from_ns=samples.START_NS, captured_to_ns=samples.START_NS + 10**10
    )


def test_a_drive_of_another_version_is_analysed_again_only_where_a_person_asks_for_it(
    plan: Any, receipt: Any, conn: Any, on_the_map: DriveHeader, monkeypatch: pytest.MonkeyPatch
) -> None:
    receipt(on_the_map, "committed", changeset_id=changeset_id(conn), may_pass=False)
    assert plan([on_the_map], reanalyse=True).lines[0].action == "skip", "of this version"
    monkeypatch.setattr(chunks, "ANALYSIS_VERSION", f"{chunks.ANALYSIS_VERSION} and more")
    (line,) = plan([on_the_map], once=True).lines
    assert (line.action, line.why) == ("skip", "analysed by another version: --reanalyse replaces changeset 1")
    (line,) = plan([on_the_map], reanalyse=True).lines
    assert (line.action, line.why) == ("ingest", "analysed by another version: replaces changeset 1")


@pytest.mark.parametrize("once", [True, False], ids=["drop folder", "backfill"])
def test_a_drive_that_changed_since_it_was_brought_onto_the_map_is_taken_again(
    plan: Any, receipt: Any, conn: Any, on_the_map: DriveHeader, once: bool
) -> None:
    """Corrected poses, another calibration, or the rest of a drive that was taken half copied: another header."""
    receipt(on_the_map, "committed", changeset_id=changeset_id(conn), may_pass=False)
    changed = replace(on_the_map, header_sha256="f" * 64)
    grown = replace(changed, captured_to_ns=(changed.captured_to_ns or 0) + 10**10)
    for drive in (changed, grown):
        (line,) = plan([drive], once=once).lines
        assert (line.action, line.why) == ("ingest", "changed since it was committed (changeset 1)")
    assert plan([on_the_map], once=once).lines[0].action == "skip"
    receipt(changed, "known", changeset_id=changeset_id(conn), may_pass=False)
    assert plan([changed], once=once).lines[0].action == "skip", "its content was compared, and that is remembered"


def test_parameters_of_earlier_do_not_make_a_drive_a_changed_one(
    plan: Any, receipt: Any, conn: Any, on_the_map: DriveHeader
) -> None:
    receipt(on_the_map, "committed", changeset_id=changeset_id(conn), may_pass=False)
    receipt(on_the_map, "failed", analysis_sha256="ab" * 32, reason="stopped", may_pass=False)
    (line,) = plan([on_the_map]).lines
    assert (line.action, line.why.startswith("on the map since")) == ("skip", True)


def test_a_reverted_drive_is_not_on_the_map_and_its_correction_is_ingested(
    plan: Any, receipt: Any, conn: Any, on_the_map: DriveHeader
) -> None:
    """`conetl ingest` writes no receipt, so the folder of a reverted changeset may hold the correction."""
    execute(
        conn,
        "insert into conetl.decision (decision_id, map_id, srid, kind, changeset_id, note, decided_by, decided_at) "
        "select %(id)s, map_id, srid, 'revert', changeset_id, '', 'a person', now() "
        "from conetl.changeset join conetl.map using (map_id)",
        {"id": uuid4()},
    )
    conn.commit()
    why = "not in effect: changeset 1 was reverted or replaced (see `conetl map decisions`)"
    assert [(line.action, line.why) for line in plan([on_the_map]).lines] == [("ingest", why)]
    receipt(on_the_map, "known", changeset_id=changeset_id(conn), may_pass=False)
    assert [(line.action, line.why) for line in plan([on_the_map]).lines] == [("skip", why)]


def test_the_same_recording_twice_is_ingested_once(plan: Any) -> None:
    first = headers(1)[0]
    made = plan([first, replace(first, path=ROOT / "copy")])
    assert sorted(line.action for line in made.lines) == ["ingest", "skip"]


def test_a_lock_says_who_lives(conn: Any, database_url: str, plan: Any, receipt: Any, tmp_path: Path) -> None:
    drive = headers(1)[0]
    started = receipt(drive, "started")
    names = [started.drive_lock, run_lock("a"), run_lock("b")]
    with holding(database_url, started.drive_lock, run_lock("a")):
        assert held_locks(conn, names) == set(names[:2])
        assert plan([drive]).lines[0].action == "wait"
        assert end_crashed(conn, started, "gone", tmp_path) is None
    assert held_locks(conn, names) == set()
    assert end_crashed(conn, started, "gone", tmp_path) is not None
    assert end_crashed(conn, started, "gone", tmp_path) is None, "told once"
    assert latest(conn, drive).state == "crashed"
    assert held_locks(conn, names) == set()


def test_drives_are_planned_without_opening_an_image(
    conn: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Real folders of real small files; the images cannot be read at all."""
    template = tmp_path / "template"
    sample = next(SAMPLES.iterdir())
    for side in ("image_02", "image_03"):
        (template / side / "data").mkdir(parents=True)
        for number in range(3):
            (template / side / "data" / f"{number:010d}.jpg").write_bytes(b"no image")
        shutil.copy(sample / side / "timestamps.txt", template / side)
    (template / "oxts" / "data").mkdir(parents=True)
    shutil.copy(sample / "oxts" / "data" / f"{0:010d}.txt", template / "oxts" / "data")
    for path in sample.glob("calib*"):
        shutil.copy(path, template)
    for number in range(100):
        drive = tmp_path / "year" / f"{number % 12:02d}" / f"drive_{number:04d}"
        shutil.copytree(template, drive, copy_function=_link)
    made = plan_drives(conn, tmp_path / "year", settings=Settings(), params=IngestParams())
    assert made.count("ingest") == 100
    assert made.frame_pairs == 300


def _link(source: str, target: str) -> None:
    Path(target).hardlink_to(source)


def changeset_id(conn: Any) -> Any:
    return execute(conn, "select changeset_id from conetl.changeset")[0]["changeset_id"]


@pytest.mark.parametrize("drive_id", ["\u6f22" * 200, "M\udcfcnchen"])
def test_any_id_has_a_receipt(drive_id: str, receipt: Any, conn: Any, tmp_path: Path) -> None:
    """File systems count bytes; and names of files may be bytes that are not UTF-8."""
    drive = replace(headers(1)[0], drive_id=drive_id)
    receipt(drive, "failed", reason=f"{drive_id} is wrong", may_pass=False)
    kept = latest(conn, drive)
    assert kept.reason.startswith("M\\xfcnchen" if "M" in drive_id else drive_id)
    (path,) = (tmp_path / "default").glob("*.json")
    copy = json.loads(path.read_text())
    assert (copy["drive_id"], copy["state"], copy["attempts"]) == (kept.drive_id, "failed", 1)
    assert copy["reason"] == kept.reason


def test_a_full_disk_costs_the_copy_of_a_receipt_and_nothing_else(
    receipt: Any, conn: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The row is what counts; of the copy there is the earlier one, and no half one beside it."""
    [drive] = headers(1)
    receipt(drive, "started")
    [copy] = tmp_path.rglob("*.json")
    before = copy.read_bytes()

    def full(_handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as failing:
        failing.setattr(os, "fsync", full)
        receipt(drive, "failed", reason="no usable pose", may_pass=False)
    assert latest(conn, drive).state == "failed"
    assert "its copy is not" in caplog.text
    assert "No space left" in caplog.text
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [copy]
    assert copy.read_bytes() == before
