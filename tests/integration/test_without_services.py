"""Drives on one machine where nothing of `conetl up` runs: receipts, batches, and what goes wrong around a commit.

The first test lets the command start Prefect, as `test_drop_folder.py` does; the others use a server that runs.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import pytest
from prefect.client.orchestration import get_client
from prefect.client.schemas.filters import FlowRunFilter, FlowRunFilterName

from conetl.cli.ingest import ingest_drives, print_report
from conetl.db.connection import connect, execute
from conetl.db.map.archive import rename_map
from conetl.db.map.map_store import find_map, list_changesets
from conetl.db.receipt_store import is_published, pending_changesets
from conetl.model.errors import DriveFolderError, StorageError
from conetl.model.health import CALIBRATION, HealthCheck, HoldChange, Verdict
from conetl.model.ingest_report import DriveOnHoldError, IngestReport, TooManyRejectionsError
from conetl.model.map_records import DeltaKind
from conetl.model.params import IngestParams
from conetl.model.rejections import RejectionReason
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.publish import catch_up_all
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import read_header
from flows import artifacts, ingest_drive
from flows.runs import drive_run_name
from tests.command import until
from tests.integration.conftest import command_line, conetl_process
from tests.integration.drives_of_days import held_for
from tests.integration.small_drives import SAMPLES, cut_drive, processes_with, shift_poses

#: 210 bytes.
LONG_ID = "漢" * 70


def _backfill(
    root: Path, home: Path, database_url: str, *options: str, **environment: str
) -> tuple[int, dict[str, dict[str, object]]]:
    """Exit code, and by drive id what became of the drives."""
    done = conetl_process(
        home, database_url, "backfill", root.name, "--here", *options, folder=root.parent, **environment
    )
    assert done.stdout, done.stderr
    return done.returncode, {drive["drive_id"]: drive for drive in json.loads(done.stdout)["drives"]}


def _plan(root: Path, home: Path, database_url: str, *options: str) -> dict[str, dict[str, object]]:
    """What a backfill would do, by drive id; in this process, since it needs no Prefect."""
    said = json.loads(
        command_line(home, database_url)("backfill", root, "--here", "--dry-run", "--json", *options, code=1)
    )
    return {line["drive_id"]: line for line in said["plan"]["lines"]}


@pytest.mark.release
def test_a_backfill_without_services_leaves_nothing_but_the_map_and_its_receipts(
    tmp_path: Path, database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind a proxy, which cannot reach this machine's own addresses, and links by other names.

    One drive has an id of more bytes than a file name may have and a first stamp before all times, one a calibration beside its
    link only, and heights of another datum; a name that is not UTF-8 stops no drive beside it.
    """
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    odd, beside = (
        cut_drive(
            SAMPLES[n], tmp_path / f"disk{n}" / f"2026-05-0{n + 1}_run", f"2026-05-0{n + 1}", frames=range(12, 17)
        )
        for n in (0, 1)
    )
    (odd / "drive.yaml").write_text(f"drive_id: {LONG_ID}\ntimestamps_timezone: Europe/Berlin\n", encoding="utf-8")
    stamps = odd / "image_02" / "timestamps.txt"
    stamps.write_text("0001-01-01 00:00:00\n" + stamps.read_text().partition("\n")[2])
    shift_poses(beside, height_m=-48.0)
    links = tmp_path / "links"
    cut_drive(SAMPLES[1], links / os.fsdecode(b"M\xfcnchen"), "2026-05-01", frames=range(1))
    for calibration in beside.glob("calib*.txt"):
        calibration.rename(links / calibration.name)
    for name, drive in (("monday", odd), ("monday-again", odd), ("tuesday", beside)):
        (links / name).symlink_to(drive)
    where = links, tmp_path / "home", database_url
    planned = _plan(*where)
    assert planned["M\\xfcnchen"]["action"] == "refuse"
    code, drives = _backfill(*where)
    states = {LONG_ID: "committed", "2026-05-02_run": "held", "M\\xfcnchen": "failed"}
    assert {name: drive["state"] for name, drive in drives.items()} == states
    assert "48.0 m lower" in str(drives["2026-05-02_run"]["reason"])
    assert "not UTF-8" in str(drives["M\\xfcnchen"]["reason"])
    assert code == 2
    with closing(connect(database_url)) as conn:
        changesets = execute(
            conn, "select d.drive_id from conetl.changeset c join conetl.drive d using (drive_uuid) order by 1"
        )
        cones = execute(conn, "select count(*) as cones from conetl.feature_version")[0]["cones"]
        receipts = {r["drive_id"]: r["state"] for r in execute(conn, "select * from conetl.latest_receipt")}
    assert {row["drive_id"] for row in changesets} == {LONG_ID, "2026-05-02_run"} and len(changesets) == 2
    assert cones > 0
    assert receipts == states
    # The temporary server takes a moment to end.
    until(lambda: not processes_with("CONETL_HOME", tmp_path / "home"), "the end of all processes", 30, 0.2)

    drives = _plan(*where)
    assert "on hold since" in str(drives["2026-05-02_run"]["why"])
    assert {name: drive["action"] for name, drive in drives.items()} == {
        LONG_ID: "skip", "2026-05-02_run": "skip", "M\\xfcnchen": "refuse",
    }  # fmt: skip
    drives = _plan(*where, "--recheck", "--since", "2026-05-02")
    assert {name: drive["action"] for name, drive in drives.items()} == {
        "2026-05-02_run": "ingest", "M\\xfcnchen": "refuse",
    }  # fmt: skip


def report(**changes: Any) -> IngestReport:
    at = datetime(2026, 4, 1, tzinfo=UTC)
    values: dict[str, Any] = {
        "drive_id": "drive", "status": "committed", "changeset_id": "00000000-0000-4000-8000-000000000000",
        "captured_from": at, "captured_to": at, "map_name": "default", "map_srid": 32632, "frame_pairs": 3,
        "frame_pairs_rejected": 0, "detections": 0, "matches": 0, "positions": 0, "tracks": 0, "changes": (),
        "counts": dict.fromkeys(DeltaKind, 0), "rejections": {}, "params_sha256": "a", "model_sha256": "b",
        "content_sha256": "c" * 64, "seconds": 1.0, "committed_at": None,
    }  # fmt: skip
    return IngestReport(**values | changes)


@pytest.fixture
def attempt(
    conn: Any, database_url: str, samples: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Callable[..., Any]], dict[str, Any]]:
    """`attempt(work)`: the receipt of a job whose ingest is `work`; no Prefect runs."""
    drive = cut_drive(SAMPLES[0], tmp_path / "drive", "2026-04-01")
    samples.commit(conn, samples.added(samples.feature()), key="a")
    monkeypatch.setenv("CONETL_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("CONETL_DATABASE_URL", database_url)
    monkeypatch.setenv("PREFECT__RUNTIME__FLOW_RUN__RUN_COUNT", "1")
    monkeypatch.setattr(ingest_drive, "_describe_run", lambda *_: None)

    def receipt_of(work: Callable[..., Any]) -> dict[str, Any]:
        monkeypatch.setenv("PREFECT__RUNTIME__FLOW_RUN__ID", str(uuid4()))
        monkeypatch.setattr(ingest_drive, "ingest", work)
        try:
            ingest_drive.ingest_drive.fn(drive)
        except Exception as error:
            assert str(error)
        conn.rollback()
        (row,) = execute(conn, "select * from conetl.latest_receipt where map_name = 'default'")
        return row

    return receipt_of


def raising(error: Exception) -> Callable[..., Any]:
    def work(*_: object, **__: object) -> None:
        raise error

    return work


@pytest.mark.parametrize(
    ("error", "passes", "said"),
    [
        (httpx.ConnectError("All connection attempts failed"), True, "Prefect"),
        (StorageError("results cannot be written (No space left on device)"), True, "No space left"),
        (DriveFolderError("calib_cam_to_cam.txt: P_rect_03 is missing"), False, "P_rect_03"),
    ],
    ids=["Prefect restarts", "disk full", "calibration"],
)
def test_what_is_not_the_drives_own_may_pass(attempt: Any, error: Exception, passes: bool, said: str) -> None:
    receipt = attempt(raising(error))
    assert (receipt["state"], receipt["may_pass"]) == ("failed", passes)
    assert said in receipt["reason"]


def test_a_failure_after_the_commit_leaves_a_receipt_that_says_committed(attempt: Any, conn: Any) -> None:
    (changeset,) = list_changesets(conn)
    done = report(changeset_id=changeset.changeset_id, unpublished="the map's file cannot be written")
    receipt = attempt(lambda *_, **__: done)
    assert receipt["state"] == "committed"
    assert receipt["reason"] == "the map's file cannot be written"
    receipt = attempt(raising(DriveOnHoldError(done.model_copy(update={"status": "held", "on_hold": "It jumps."}))))
    assert receipt["state"] == "held" and "the map's file cannot be written" in receipt["reason"]
    receipt = attempt(raising(TooManyRejectionsError(done, 1, 0.1)))
    assert receipt["state"] == "committed"
    assert "the map's file cannot be written" in receipt["reason"]
    assert "max_rejected_fraction" in receipt["reason"]


def test_a_report_of_an_ingest_says_each_thing_once(capsys: pytest.CaptureFixture[str]) -> None:
    text = "right camera turned by 0.10 degrees"
    passed = HealthCheck(name=CALIBRATION, verdict=Verdict.PASS, value=None, detail=f"R{text[1:]}.")
    other = HoldChange(
        drive_id="later", changeset_no=7, changeset_id=uuid4(), state="on hold", reason="Its cones lie lower."
    )
    for check, times in ((passed, 0), (passed.model_copy(update={"verdict": Verdict.CORRECTED}), 1)):
        print_report(done := report(calibration=text, health=(check,), hold_changes=(other,)))
        said = capsys.readouterr().out
        assert said.count(text[1:]) == times
        assert "Its cones lie lower." not in said, "it is among the remarks"
    assert done.remarks == (other.sentence,), "it makes the exit code 1"


@pytest.mark.parametrize("on_hold", ["It jumps.", None])
def test_a_stored_drive_of_a_command_is_no_failed_run(
    prefect_here: Path, conn: Any, database_url: str, samples: Any, monkeypatch: pytest.MonkeyPatch, on_hold: str | None
) -> None:
    samples.commit(conn, samples.added(samples.feature()), key="a")
    stored = {"drive_id": f"drive {on_hold}", "changeset_id": list_changesets(conn)[0].changeset_id}
    made = report(status="held" if on_hold else "committed", on_hold=on_hold, **stored)

    def work(*_: object, **__: object) -> IngestReport:
        if on_hold:
            raise DriveOnHoldError(made)
        return made

    monkeypatch.setattr(ingest_drive, "ingest", work)
    settings = Settings(home=prefect_here, database_url=database_url)
    header = replace(read_header(SAMPLES[0]), drive_id=made.drive_id)
    if on_hold:
        with pytest.raises(DriveOnHoldError, match="It jumps"):
            ingest_drive.ingest_here(header, settings, IngestParams(), map_srid=None)
    else:
        assert ingest_drive.ingest_here(header, settings, IngestParams(), map_srid=None) == made
    named = FlowRunFilter(name=FlowRunFilterName(any_=[drive_run_name(read_header(SAMPLES[0]))]))
    with get_client(sync_client=True) as api:
        runs = api.read_flow_runs(flow_run_filter=named)
    assert ("OnHold" if on_hold else "Completed") in {run.state.name for run in runs if run.state is not None}


def test_the_message_of_a_run_lists_what_changed_now() -> None:
    counts = dict.fromkeys(DeltaKind, 0) | {DeltaKind.CONFIRMED: 2, DeltaKind.MISSED: 1}
    assert ingest_drive.outcome(report(counts=counts)) == "committed: 2 confirmed, 1 not observed"
    assert ingest_drive.outcome(report(counts=dict.fromkeys(DeltaKind, 0))) == "committed: no objects"
    known = report(counts=counts, committed_at=datetime(2026, 3, 2, 10, 5, tzinfo=UTC))
    said = "nothing to do, already on the map since 2026-03-02 10:05 UTC"
    assert ingest_drive.outcome(known) == said
    reverted = known.model_copy(update={"not_counted": "it was reverted"})
    assert ingest_drive.outcome(reverted) == f"{said}, but not in effect: it was reverted"


def test_a_report_says_why_fewer_objects_are_on_the_map_than_the_drive_shows(
    capsys: pytest.CaptureFixture[str],
) -> None:
    counts = dict.fromkeys(DeltaKind, 0) | {DeltaKind.ADDED: 6, DeltaKind.CONFIRMED: 2, DeltaKind.REMOVED: 1}
    print_report(report(tracks=9, counts=counts))
    assert "9 cones, of which 1 not added (uncertain, or too close to another object)." in " ".join(
        capsys.readouterr().out.split()
    )
    print_report(report(tracks=8, counts=counts))
    assert "8 cones." in " ".join(capsys.readouterr().out.split())
    print_report(report(tracks=9, counts=dict.fromkeys(DeltaKind, 0), on_hold="It jumps.", health=()))
    assert "9 cones." in " ".join(capsys.readouterr().out.split()), "nothing of it is added"


def test_a_report_says_that_no_lane_markings_were_found_where_they_were_searched(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_report(report(categories=("traffic_cone",), rejections={RejectionReason.BOX_CUT_BY_BORDER: 20}))
    said = capsys.readouterr().out
    assert "marking" not in said and "\nRejected records: 20 (box cut by border: 20).\n" in said
    print_report(report(categories=("lane_marking", "traffic_cone")))
    assert "No lane markings found; none changed on the map." in capsys.readouterr().out
    print_report(report(categories=("lane_marking",), markings=2, line_counts={DeltaKind.ADDED: 3}))
    assert "2 lane markings; stretches of them: 3 added." in capsys.readouterr().out
    left = "not added (uncertain, or too close to another object)"
    print_report(report(categories=("lane_marking",), markings=1))
    assert f"1 lane marking, of which 1 {left}; none changed on the map." in " ".join(capsys.readouterr().out.split())
    print_report(report(categories=("lane_marking",), markings=2, line_counts={DeltaKind.REMOVED: 1}))
    assert f"of which 2 {left}; stretches of them: 1 removed." in " ".join(capsys.readouterr().out.split())


@pytest.fixture
def events(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, dict[str, str]]]:
    """Events that would have gone to Prefect."""
    sent: list[tuple[str, dict[str, str]]] = []
    monkeypatch.setattr(artifacts, "emit_event", lambda event, resource, **_: sent.append((event, resource)))
    monkeypatch.setattr(artifacts.EventsWorker, "drain_all", lambda **_: None)
    return sent


def test_what_was_is_pending_is_published_without_the_drive(
    conn: Any, database_url: str, samples: Any, tmp_path: Path, events: list[tuple[str, dict[str, str]]]
) -> None:
    settings = Settings(home=tmp_path, database_url=database_url)  # type: ignore[arg-type]
    cone = samples.feature()
    samples.commit(conn, samples.added(cone), key="a")
    later_ns = samples.START_NS + samples.DAY_NS
    samples.commit(conn, samples.removed(cone, later_ns), key="b", start_ns=later_ns)
    samples.commit(conn, key="c", start_ns=later_ns + samples.DAY_NS, hold=held_for("GNSS/INS jumps."))

    def publish_pending(**quiet: timedelta) -> None:
        with MapDatabase(settings) as database:
            catch_up_all(settings, database, artifacts.send_events, **quiet)
        conn.rollback()

    publish_pending()
    assert not events, "the runs that committed them have time to tell them"

    settings.exports_folder.mkdir(parents=True)
    (settings.exports_folder / "default.geojson").mkdir()
    publish_pending(quiet=timedelta(0))  # does not stop those who call it
    assert len(pending_changesets(conn, map_name="default", quiet=timedelta(0))) == 3, "files come before the mark"

    (settings.exports_folder / "default.geojson").rmdir()
    publish_pending(quiet=timedelta(0))
    assert [name for name, _ in events] == [
        "conetl.changeset.committed", "conetl.changeset.committed", "conetl.cone.vanished", "conetl.drive.held",
    ]  # fmt: skip
    assert [resource["prefect.resource.name"] for _, resource in events[:2]] == ["drive_a", "drive_b"]
    assert events[1][1]["conetl.removed"] == "1"
    assert all(is_published(conn, changeset.changeset_id) for changeset in list_changesets(conn))
    assert (settings.exports_folder / "default.geojson").is_file()
    publish_pending(quiet=timedelta(0))
    assert len(events) == 4


@pytest.mark.release
def test_what_could_not_be_published_is_said_and_told_by_a_later_run(
    tmp_path: Path,
    prefect_here: Path,
    conn: Any,
    database_url: str,
    prefect: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Of two drives at the same time."""
    from flows import backfill

    home = prefect_here / "unpublished"
    for number in (1, 2):
        folder = cut_drive(SAMPLES[0], tmp_path / "drives" / f"2026-05-0{number}_run", f"2026-05-0{number}")
    in_the_way = home / "exports" / "default.geojson"
    in_the_way.mkdir(parents=True)
    done = conetl_process(home, database_url, "backfill", folder.parent, "--here", "--max-parallel", 2, **prefect)
    drives = json.loads(done.stdout)["drives"]
    assert [drive["state"] for drive in drives] == ["committed"] * 2, done.stderr
    assert all("default.geojson" in drive["reason"] for drive in drives)
    assert done.returncode == 1
    settings = Settings(home=home, database_url=database_url)  # type: ignore[arg-type]
    capsys.readouterr()
    [said], code = ingest_drives([folder], settings, IngestParams(), map_srid=None, show=lambda _: None)
    assert code == 1, "it is still in the way"
    assert said.status == "no changes" and said.unpublished is not None
    assert "default.geojson" in said.unpublished and "run the same command again" in said.unpublished
    assert said.unpublished in " ".join(capsys.readouterr().err.split())
    changesets = [changeset.changeset_id for changeset in list_changesets(conn)]
    assert [is_published(conn, one) for one in changesets] == [False] * 2
    in_the_way.rmdir()
    execute(conn, "update conetl.changeset set committed_at = committed_at - interval '1 hour'")
    conn.commit()
    monkeypatch.setenv("CONETL_HOME", str(home))
    monkeypatch.setenv("CONETL_DATABASE_URL", database_url)
    state = backfill.backfill(str(folder.parent), max_parallel=1, where="here", return_state=True)
    assert state.name == "NothingNew", state.message
    assert [is_published(conn, one) for one in changesets] == [True] * 2
    assert in_the_way.is_file()
    assert list((home / "exports" / "reports").rglob("*.html"))


@pytest.mark.release
@pytest.mark.usefixtures("prefect_here")
def test_a_map_that_is_renamed_during_a_backfill_is_not_made_anew(
    tmp_path: Path, conn: Any, database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flows import backfill, dispatch

    for number in (1, 2):
        cut_drive(SAMPLES[0], tmp_path / "drives" / f"2026-05-0{number}_run", f"2026-05-0{number}")
    for name, value in (("HOME", str(tmp_path / "home")), ("DATABASE_URL", database_url), ("WORKERS", "1")):
        monkeypatch.setenv(f"CONETL_{name}", value)
    true = dispatch.start_here

    def start(*arguments: Any) -> Any:
        if find_map(conn) is not None:
            rename_map(conn, "default", "older")
        conn.rollback()
        return true(*arguments)

    monkeypatch.setattr(dispatch, "start_here", start)
    state = backfill.backfill(str(tmp_path / "drives"), max_parallel=1, where="here", return_state=True)
    assert state.name == "SomeFailed" and "the map default was renamed or deleted" in str(state.message)
    assert [row["map_name"] for row in execute(conn, "select map_name from conetl.map")] == ["older"]


_LOST_ANSWER = """
import os, httpx
from conetl.pipeline.settings import prefect_environment, read_settings
os.environ.update(prefect_environment(read_settings().home))
from flows.tasks import PrefectExecutor
run = PrefectExecutor.run
def run_and_lose_the_answer(self, step, *arguments):
    result = run(self, step, *arguments)
    if step.__name__ == "commit":
        raise httpx.ConnectError("Prefect restarts")
    return result
PrefectExecutor.run = run_and_lose_the_answer
"""


def test_a_commit_whose_answer_was_lost_is_a_commit(
    tmp_path: Path, conn: Any, database_url: str, prefect: dict[str, str]
) -> None:
    drive = cut_drive(SAMPLES[0], tmp_path / "drive", "2026-05-01")
    done = conetl_process(tmp_path / "home", database_url, "ingest", drive, before=_LOST_ANSWER, **prefect)
    assert done.returncode == 0, done.stderr
    (changeset,) = list_changesets(conn)
    assert json.loads(done.stdout)[0]["changeset_id"] == str(changeset.changeset_id)
    assert is_published(conn, changeset.changeset_id)


_FAILING_DISK = """
import errno
from conetl.files import parquet_store
def fail(*_, **__):
    raise OSError(errno.EIO, "Input/output error", "results/chunk.parquet")
parquet_store.read_table = fail
"""


def test_a_disk_that_fails_is_no_mistake_of_conetl(
    tmp_path: Path, conn: Any, database_url: str, prefect: dict[str, str]
) -> None:
    drive = cut_drive(SAMPLES[0], tmp_path / "drive", "2026-05-01")
    done = conetl_process(tmp_path / "home", database_url, "ingest", drive, before=_FAILING_DISK, **prefect)
    assert done.returncode == 3, done.stderr
    assert "results/chunk.parquet: the storage failed (Input/output error)" in " ".join(done.stderr.split())
    assert list_changesets(conn) == []
