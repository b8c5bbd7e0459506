"""The main job end to end on the sample drives: a real PostGIS, and a real Prefect server where the command needs one.

What a drive does to the map is the same through the command line and through Python, which spares the start of a process.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import httpx
import numpy as np
import pytest

from conetl.cli.ingest import ingest_drives, print_report
from conetl.db.connection import connect, execute
from conetl.db.live_store import read_provisional
from conetl.db.map.map_store import list_changesets
from conetl.exports.wzdx import schema_faults
from conetl.model.errors import DriveFolderError, InputError, ServiceError
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.ingest_report import DriveOnHoldError, IngestReport, TooManyRejectionsError
from conetl.model.map_records import DeltaKind
from conetl.model.params import DetectionParams, IngestParams, params_sha256
from conetl.model.rejections import RejectionReason
from conetl.pipeline.commit import CommittedDrive
from conetl.pipeline.executor import step
from conetl.pipeline.ingest import ingest
from conetl.pipeline.settings import Settings
from conetl.reports.drive_page import drive_page
from tests.command import ROOT, conetl, until
from tests.integration.conftest import QUIET, command_line
from tests.integration.small_drives import SAMPLES, cut_drive, shift_poses, spoil_huffman_table, unpublished

SHARED = Path(os.environ.get("CONETL_SHARED_DATA", ROOT.parent / "shared" / "data"))
KITTI = SHARED / "kitti_2011_09_26_drive_0005_sync"

#: Everything that a drive leaves on the map, but for what a clock or a sequence says.
FINAL_TABLES = {
    "drive": "to_jsonb(t) - 'source_path'",
    "frame_pair": "to_jsonb(t) - 'left_path' - 'right_path'",
    "detection": "to_jsonb(t)",
    "stereo_match": "to_jsonb(t)",
    "position": "to_jsonb(t)",
    "track": "to_jsonb(t)",
    "changeset": "to_jsonb(t) - 'changeset_no' - 'run_id' - 'committed_at'",
    "quarantine": "to_jsonb(t) - 'quarantine_id'",
    "feature": "to_jsonb(t)",
    "feature_version": "to_jsonb(t) - 'version_row_id' - 'system_period'",
    "delta": "to_jsonb(t) - 'delta_row_id' - 'system_period'",
}


@dataclass(frozen=True)
class Desk:
    """A user's environment: home folder, Prefect server, database."""

    environment: dict[str, str]

    def command(self, *arguments: object) -> list[str]:
        return [sys.executable, "-m", "conetl", *map(str, arguments)]

    def run(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return conetl(*arguments, **self.environment)

    def ask(self, *arguments: object, code: int = 0) -> str:
        """What a command says that needs the database only; in this process."""
        environment = self.environment
        url, map_name = environment["CONETL_DATABASE_URL"], environment.get("CONETL_MAP_NAME", "default")
        return command_line(Path(environment["CONETL_HOME"]), url, map_name)(*arguments, code=code)

    @property
    def settings(self) -> Settings:
        """Those of its commands."""
        names = {"home": "CONETL_HOME", "database_url": "CONETL_DATABASE_URL", "map_name": "CONETL_MAP_NAME"}
        values = {field: self.environment[name] for field, name in names.items() if name in self.environment}
        return Settings.model_validate(values)

    def ingest(self, drive: Path, **params: object) -> IngestReport:
        """What the command does to the map, in this process and without Prefect."""
        return ingest(drive, IngestParams.model_validate(params), self.settings, publish_new=unpublished)

    def features(self, *options: object) -> Any:
        return json.loads(self.ask("map", "show", *options, "--json"))["features"]

    def with_database(self, url: str) -> Desk:
        return Desk({**self.environment, "CONETL_DATABASE_URL": url})

    def final_tables(self) -> dict[str, list[str]]:
        with closing(connect(self.environment["CONETL_DATABASE_URL"])) as conn:
            return {
                table: [
                    row["line"]
                    for row in execute(conn, f"select ({content})::text as line from conetl.{table} t order by 1")
                ]
                for table, content in FINAL_TABLES.items()
            }


@pytest.fixture(scope="session")
def office(sample_settings: Settings, prefect: dict[str, str]) -> Desk:
    """Home folder that all tests of the sample drives share; detections are computed once."""
    home = sample_settings.home
    return Desk({**os.environ, "CONETL_HOME": str(home), "PREFECT_HOME": str(home / "prefect"), **QUIET, **prefect})


@pytest.fixture
def desk(office: Desk, database_url: str) -> Desk:
    return office.with_database(database_url)


@pytest.fixture
def small_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In the same folder for each test, and so by the same paths: what one test has found in its images the others read."""
    folder = tmp_path_factory.getbasetemp() / "small-drives"
    shutil.rmtree(folder, ignore_errors=True)
    return cut_drive(SAMPLES[0], folder / "small", frames=range(4, 20))


def truth_changes(drive: Path) -> dict[str, int]:
    kinds = dict.fromkeys(map(str, DeltaKind), 0)
    with (drive / "truth.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            kinds[row["change"]] += 1
    return kinds


def test_the_sample_drives_become_the_true_map(desk: Desk) -> None:
    command = desk.command("demo", SAMPLES[0].parent, "--json")
    done = subprocess.run(command, env=desk.environment, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    for drive, report in zip(SAMPLES, outcome["reports"], strict=True):
        assert report["counts"] == truth_changes(drive), drive.name
        assert report["frame_pairs_rejected"] == 0
    assert outcome["false_features"] == []
    assert all(cone["feature_id"] for cone in outcome["cones"])
    assert outcome["median_error_3d_m"] <= 0.05

    before = desk.final_tables()
    desk_demo = Desk({**desk.environment, "CONETL_MAP_NAME": "demo"})
    assert [desk_demo.ingest(drive).status for drive in SAMPLES] == ["no changes"] * 3
    assert desk.final_tables() == before
    desk.ask("db", "audit")

    check_the_table_of_the_tutorial(outcome["reports"][1]["changes"])
    check_the_feeds_of_three_days(desk_demo)

    # the first drive again under other parameters: its new analysis takes the place of the old one, and later drives follow
    assert desk_demo.ingest(SAMPLES[0], track={"min_observations": 4}).replayed_drives == len(SAMPLES) - 1
    desk.ask("db", "audit")

    export = Path(desk.environment["CONETL_HOME"]) / "map.geojson"
    desk_demo.ask("map", "export", "--out", export)
    collection = json.loads(export.read_text())
    assert len(collection["features"]) == len(outcome["cones"])
    assert len(desk_demo.features("--as-of", "2026-03-02T23:00")) == truth_changes(SAMPLES[0])["added"]


def check_the_table_of_the_tutorial(changes: list[dict[str, Any]]) -> None:
    """The row that docs/tutorial/first_map.md shows is one of the second drive; processors differ in the last digits."""
    text = (ROOT / "docs/tutorial/first_map.md").read_text()
    kind, feature, *shown = re.findall(r"^confirmed .*$", text, re.MULTILINE)[0].split()
    [found] = [one for one in changes if one["feature_id"].startswith(feature)]
    xyz_m = found["xyz_m"]
    rest = ("object_height_m", "sigma_horizontal_m", "sigma_height_m", "existence_probability", "observation_count")
    assert found["kind"] == kind
    values = [*xyz_m, *(found[name] for name in rest), found["shift_m"]]
    assert [float(value) for value in shown] == [
        pytest.approx(value, abs=most)
        for value, most in zip(values, (0.01, 0.01, 0.01, 0.02, 0.003, 0.003, 0.002, 3, 0.01), strict=True)
    ]


def check_the_feeds_of_three_days(desk: Desk) -> None:
    """The sample closure as WZDx: valid, one id, and the first and the last cone of each day."""
    path = Path(desk.environment["CONETL_HOME"]) / "feed.geojson"
    ids = set()
    for drive in SAMPLES:
        as_of = f"{drive.name[:10]}T23:00"
        feed = ("--publisher", "City", "--road-name", "L 605", "--as-of", as_of)
        desk.ask("map", "export", "--format", "wzdx", "--out", path, *feed)
        document = json.loads(path.read_text())
        assert schema_faults(document, "WorkZoneFeed") == []
        [event] = document["features"]
        ids.add(event["id"])
        assert event["properties"]["core_details"]["direction"] == "eastbound"
        assert event["properties"]["event_status"] == "active"
        assert event["properties"]["is_start_position_verified"] is True
        truth = {}
        with (drive / "truth.csv").open(newline="") as file:
            for row in csv.DictReader(file):
                if row["present"] == "1":
                    truth[row["cone_id"]] = (float(row["easting_m"]), float(row["northing_m"]))
        assert len(event["conetl"]["device_ids"]) == len(truth)
        places = {feature["feature_id"]: feature["xyz_m"] for feature in desk.features("--as-of", as_of)}
        # The closure runs from C01 to C09, eastwards, with traffic to its left.
        for end, name in (("first_device_id", "C01"), ("last_device_id", "C09")):
            x, y, _ = places[event["conetl"][end]]
            assert ((x - truth[name][0]) ** 2 + (y - truth[name][1]) ** 2) ** 0.5 < 0.3, (drive.name, end)
        assert event["conetl"]["closed_side"] == "right"
    assert len(ids) == 1


def test_bad_pairs_cost_those_pairs_only(desk: Desk, small_drive: Path) -> None:
    numbers = sorted(int(path.stem) for path in (small_drive / "image_02" / "data").iterdir())
    truncated = small_drive / "image_02" / "data" / f"{numbers[2]:010d}.jpg"
    truncated.write_bytes(truncated.read_bytes()[:-4000])
    (small_drive / "image_03" / "data" / f"{numbers[5]:010d}.jpg").unlink()
    oxts = small_drive / "oxts" / "data" / f"{numbers[9]:010d}.txt"
    values = oxts.read_text().split()
    oxts.write_text(" ".join(["nan", *values[1:]]))

    with pytest.raises(TooManyRejectionsError, match="3 of 16 frame pairs") as doubted:
        desk.ingest(small_drive)
    assert doubted.value.exit_code == 1, "3 of 16 pairs are more than a tenth"
    report = doubted.value.report
    assert (report.frame_pairs, report.frame_pairs_rejected) == (13, 3)
    reasons = ("image_truncated", "image_missing", "pose_invalid")
    assert [report.rejections[RejectionReason(reason)] for reason in reasons] == [1, 1, 1]
    assert report.counts[DeltaKind.ADDED] > 0
    assert desk.ingest(small_drive, max_rejected_fraction=0.5).frame_pairs_rejected == 3
    quarantine = desk.final_tables()["quarantine"]
    assert sum('"pose_invalid"' in line for line in quarantine) == 2, "once for each analysis"


def test_what_cannot_be_decoded_was_not_looked_at(desk: Desk, small_drive: Path, tmp_path: Path) -> None:
    """Only decoding finds that out, after the drive was read: no cone may go for it."""
    assert desk.ingest(small_drive).counts[DeltaKind.ADDED] > 3
    later, last = (
        cut_drive(SAMPLES[1], tmp_path / name, day, frames=range(4, 20))
        for name, day in (("later", "2026-03-12"), ("last", "2026-03-13"))
    )
    for drive, whole in ((later, 4), (last, 0)):
        for image in sorted((drive / "image_02" / "data").iterdir())[whole:]:
            spoil_huffman_table(image)
    with pytest.raises(TooManyRejectionsError, match="12 of 16 frame pairs") as doubted:
        desk.ingest(later)
    report = doubted.value.report
    assert (report.frame_pairs, report.frame_pairs_rejected) == (4, 12)
    assert report.rejections[RejectionReason.IMAGE_UNREADABLE] == 12
    assert report.counts[DeltaKind.REMOVED] == 0
    before = desk.final_tables()
    assert len(before["frame_pair"]) == 16 + 4
    with pytest.raises(DriveFolderError, match="none of 16 frame pairs has two images that can be decoded"):
        desk.ingest(last)
    assert desk.final_tables() == before


def test_a_corrected_delivery_waits_until_the_first_is_taken_back(desk: Desk, small_drive: Path) -> None:
    """Poses from post-processing: one recording must not count as two surveys."""
    desk.ingest(small_drive)
    shift_poses(small_drive, lat_deg=4.5e-6)  # half a metre
    before = desk.final_tables()
    with pytest.raises(InputError, match=r"other content \(changeset 1\).*conetl map revert 1 --map default"):
        desk.ingest(small_drive)
    other_name = shutil.copytree(small_drive, small_drive.with_name("the same again"))
    again = rf"this is the recording of drive {small_drive.name} again \(changeset 1\)"
    with pytest.raises(InputError, match=again):
        desk.ingest(other_name)
    for name, day, frames in (("the next day", "2026-03-03", range(4, 20)), ("a part", "2026-03-05", range(7, 17))):
        with pytest.raises(InputError, match=again):
            desk.ingest(cut_drive(SAMPLES[0], small_drive.with_name(name), day, frames=frames))
    (small_drive / "drive.yaml").write_text("timestamps_timezone: Europe/Berlin\n")
    with pytest.raises(InputError, match=r"other time stamps \(changeset 1\).*conetl map revert 1 --map default"):
        desk.ingest(small_drive)
    assert desk.final_tables() == before
    desk.ask("map", "revert", "1")
    report = desk.ingest(small_drive)
    assert report.status == "committed"
    assert report.counts[DeltaKind.ADDED] > 3
    desk.ask("db", "audit")


@pytest.mark.release
def test_images_that_are_on_the_map_with_another_log_are_refused(desk: Desk, small_drive: Path) -> None:
    """Of another GNSS, 0.8 m off by its log, dated and recompressed: what they show is in the same pixels."""
    desk.ingest(small_drive)
    again = cut_drive(SAMPLES[0], small_drive.with_name("another log"), "2026-03-06", frames=range(4, 20))
    for number, record in enumerate(sorted((again / "oxts" / "data").iterdir())):
        fields = record.read_text().split()
        fields[0], fields[23] = f"{float(fields[0]) + (0.8 + 0.1 * math.sin(number / 4)) / 111_195.0:.12f}", "0.3"
        record.write_text(" ".join(fields))
    for image in again.glob("image_0*/data/*"):
        cv2.imwrite(str(image), np.asarray(cv2.imread(str(image))), [cv2.IMWRITE_JPEG_QUALITY, 85])
    before = desk.final_tables()
    with pytest.raises(InputError, match=rf"recording of drive {small_drive.name} again .* in the same pixels"):
        desk.ingest(again)
    assert desk.final_tables() == before


def test_a_known_drive_that_does_not_count_says_why_and_what_makes_it_count(
    desk: Desk, small_drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(**params: object) -> str:
        print_report(desk.ingest(small_drive, **params))
        return " ".join(capsys.readouterr().out.split())

    assert "not in effect" not in said()
    decided = json.loads(desk.ask("map", "revert", "1", "--json"))
    text = said()
    assert "but not in effect: its changeset 1 was reverted." in text
    assert "to put it in effect again, revert that decision with `conetl map revert ID`" in text
    desk.ask("map", "revert", decided["decision_id"])
    assert "not in effect" not in said()
    assert "not in effect" not in said(trajectory={"refine": False})
    text = said()
    assert "a later analysis or delivery of the same recording (changeset 2) replaced it" in text
    desk.ask("map", "revert", "2")
    assert "not in effect" not in said()


def test_why_a_drive_is_on_hold_is_said_once_and_last(
    desk: Desk, small_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the drive itself, and of another one that goes on hold because of it. The command, but for Prefect."""
    lower = cut_drive(SAMPLES[1], tmp_path / "lower", frames=range(4, 20))
    shift_poses(lower, height_m=-1.6)
    desk.ingest(lower)
    [remark] = desk.ingest(small_drive).remarks
    assert remark.startswith("On hold now: drive lower (changeset 1). Its cones are 1.6 m lower")

    jumping = cut_drive(SAMPLES[2], tmp_path / "jumping", frames=range(4, 20))
    shift_poses(jumping, lat_deg=4e-5, first=8)
    monkeypatch.setattr("flows.server.prefect_server", nullcontext)
    monkeypatch.setattr("flows.ingest_drive.ingest_here", lambda header, *_, **__: desk.ingest(header.path))
    with patch.dict(os.environ):
        _, code = ingest_drives([jumping], desk.settings, IngestParams(), map_srid=None, show=print_report)
    assert code == 1
    said = capsys.readouterr()
    assert "jumping (2026-03-04 15:22 UTC): on hold (jumps of the poses), the map is unchanged." in said.out
    assert (said.out + said.err).count("GNSS/INS jumps by") == 1
    last = said.err.splitlines()[-1]
    assert last.startswith("conetl: Drive jumping is on hold and changes nothing on the map. GNSS/INS jumps by")
    assert last.endswith("conetl drive accept jumping --map default --note REASON")
    with pytest.raises(DriveOnHoldError, match="GNSS/INS jumps by") as known:
        desk.ingest(jumping)
    report = known.value.report
    assert known.value.exit_code == 1 and report.status == "held" and not report.counts_on_map


@pytest.fixture
def keyless(tmp_path: Path) -> Path:
    """A drive whose calibration lacks a key."""
    drive = cut_drive(SAMPLES[0], tmp_path / "keyless", frames=range(2))
    file = drive / "calib_cam_to_cam.txt"
    file.write_text("".join(x for x in file.read_text().splitlines(True) if not x.startswith("P_rect_03")))
    return drive


def test_bad_input_is_named_and_writes_nothing(
    desk: Desk, keyless: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hollow = tmp_path / "hollow"
    hollow.mkdir()
    found = ingest_drives([keyless, hollow], desk.settings, IngestParams(), map_srid=None, show=lambda _: None)
    assert found == ([], 2), "nobody waits for services to hear that"
    said = capsys.readouterr().err
    assert "P_rect_03" in said and "hollow" in said
    assert "no such drive folder" in desk.ask("ingest", tmp_path / "nowhere", code=2)
    assert not any(desk.final_tables().values())


@pytest.mark.release
def test_a_bad_drive_does_not_hold_up_the_others(desk: Desk, keyless: Path, small_drive: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    bad.mkdir()
    params = tmp_path / "params.yaml"
    params.write_text("track: {min_observations: 4}\n")
    result = desk.run("ingest", bad, keyless, small_drive, "--params", params, "--no-refine", "--json")
    assert result.returncode == 2
    assert "P_rect_03" in result.stderr and f"{bad}: " in result.stderr and "Traceback" not in result.stderr
    [report] = json.loads(result.stdout)
    assert report["drive_id"] == "small"
    options = {"track": {"min_observations": 4}, "trajectory": {"refine": False}}
    assert report["params_sha256"] == params_sha256(IngestParams.model_validate(options))


@pytest.mark.release
def test_kill_9_and_again_gives_the_tables_of_one_clean_run(
    desk: Desk, module_database_url: str, database_url: str, tmp_path: Path
) -> None:
    """Killed during the analysis and after the commit, whose event a later run tells, once.

    Within the merge: `test_exactly_once.py`.
    """
    clean, drive = desk.with_database(module_database_url), cut_drive(SAMPLES[0], tmp_path / "cut", "2026-03-11")
    assert [clean.ingest(drive).status for _ in range(2)] == ["committed", "no changes"]
    home = tmp_path / "home"
    victim = Desk({**desk.environment, "CONETL_HOME": str(home)})
    for point in ("matching", "commit"):
        with subprocess.Popen(
            victim.command("ingest", drive), env=victim.environment, cwd=ROOT, stderr=subprocess.DEVNULL
        ) as process:
            kill_at(point, home, database_url, process)
        assert process.returncode == -signal.SIGKILL, f"it was over before {point}"
        assert any(victim.final_tables().values()) is (point == "commit"), "half-written"
    assert victim.final_tables() == clean.final_tables()
    with closing(connect(database_url)) as conn:
        [changeset] = list_changesets(conn)
        assert execute(conn, "select * from conetl.changeset_published") == []
        conn.rollback()
        for _ in range(2):
            assert json.loads(victim.run("ingest", drive, "--json").stdout)[0]["status"] == "no changes"
            told = until(lambda: events_of(desk, str(changeset.changeset_id)), "its event", every_s=0.2)
            assert told == ["conetl.changeset.committed"]
        published = execute(conn, "select changeset_id from conetl.changeset_published")
        assert published == [{"changeset_id": changeset.changeset_id}]


def kill_at(point: str, home: Path, database_url: str, process: subprocess.Popen[bytes]) -> None:
    """Kill the ingest as soon as it has come to `point`; later ones hold what it wants next, so that it stays there."""

    def come_to(reached: Callable[[], object]) -> None:
        until(lambda: process.poll() is not None or reached(), point, every_s=0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()

    if point == "matching":  # what was written before it lies there, and what others write now may be half done
        come_to(lambda: len(list((home / "results").glob("*.parquet"))) >= 2)
        return
    with closing(connect(database_url)) as holder, closing(connect(database_url)) as watcher:

        def committed() -> object:
            rows = execute(watcher, "select 1 from conetl.changeset")
            watcher.rollback()
            return rows

        execute(holder, "lock table conetl.changeset_published in access exclusive mode")
        come_to(committed)


def events_of(desk: Desk, changeset_id: str) -> list[str]:
    """Names of the events of a changeset that the Prefect server holds; they are stored in batches, a moment later."""
    chosen = {"resource": {"id": [f"conetl.map.default.changeset.{changeset_id}"]}, "event": {"prefix": ["conetl."]}}
    user, _, password = desk.environment["PREFECT_API_AUTH_STRING"].partition(":")
    answer = httpx.post(
        f"{desk.environment['PREFECT_API_URL']}/events/filter", json={"filter": chosen}, timeout=30, trust_env=False,
        auth=(user, password),
    )  # fmt: skip
    return [event["event"] for event in answer.raise_for_status().json()["events"]]


def test_without_services_nothing_is_written(office: Desk, small_drive: Path) -> None:
    nowhere = office.with_database("postgresql://conetl@127.0.0.1:9/nowhere")
    with pytest.raises(ServiceError, match="CONETL_DATABASE_URL") as missing:
        nowhere.ingest(small_drive)
    assert missing.value.exit_code == 3
    no_prefect = Desk({**office.environment, "PREFECT_API_URL": "http://127.0.0.1:9/api"})
    result = no_prefect.run("ingest", small_drive)
    assert result.returncode == 3
    assert "PREFECT_API_URL" in result.stderr


def test_locate_needs_no_services(office: Desk) -> None:
    nowhere = office.with_database("postgresql://conetl@127.0.0.1:9/nowhere")
    pair = [SAMPLES[0] / side / "data" / "0000000010.jpg" for side in ("image_02", "image_03")]
    cones = json.loads(nowhere.ask("locate", *pair, "--calibration", SAMPLES[0], "--json"))["cones"]
    assert cones
    assert all(1 < cone["ground_distance_m"] < 40 for cone in cones)
    assert all(0.3 < cone["object_height_m"] < 1.0 for cone in cones)
    far = [path.with_name("0000000015.jpg") for path in pair]
    text = nowhere.ask("locate", *far, "--calibration", SAMPLES[0])
    assert "not used: match: the cone is 37.9 m away" in text, "its number would be taken for that of an object"


def every_other_pair(folder: Path, first: int, *, days: int = 0, east_m: float = 0.0, north_m: float = 0.0) -> Path:
    """Every other frame pair of the street along its cones, by links, some days later and with all GNSS positions shifted."""
    folder.mkdir()
    for calibration in KITTI.glob("calib_*.txt"):
        (folder / calibration.name).symlink_to(calibration)
    (folder / "oxts" / "data").mkdir(parents=True)
    for side in ("image_02", "image_03"):
        (folder / side / "data").mkdir(parents=True)
        for image in sorted((KITTI / side / "data").iterdir())[40 + first : 124 : 2]:
            (folder / side / "data" / image.name).symlink_to(image)
    for times in KITTI.glob("*/timestamps.txt"):
        if (folder / times.parent.name).is_dir():
            moved = (
                str(np.datetime64(line) + np.timedelta64(days, "D")) for line in times.read_text().split("\n") if line
            )
            (folder / times.parent.name / "timestamps.txt").write_text("\n".join(moved).replace("T", " ") + "\n")
    for record in sorted((KITTI / "oxts" / "data").iterdir())[40 + first : 124 : 2]:
        lat, lon, *rest = record.read_text().split()
        lat_deg = float(lat) + north_m / 111_195.0
        lon_deg = float(lon) + east_m / (111_320.0 * np.cos(np.radians(lat_deg)))
        (folder / "oxts" / "data" / record.name).write_text(f"{lat_deg:.12f} {lon_deg:.12f} {' '.join(rest)}\n")
    return folder


@pytest.mark.release
@pytest.mark.skipif(
    not KITTI.is_dir(), reason=f"{KITTI} is not there: the real street is tested where the shared data lie"
)
def test_the_other_half_of_the_real_street_a_day_later_and_half_a_metre_aside_doubles_and_moves_nothing(
    desk: Desk, tmp_path: Path
) -> None:
    even = every_other_pair(tmp_path / "even", 0)
    odd = every_other_pair(tmp_path / "odd", 1, days=1, east_m=0.4, north_m=-0.3)
    counts = [{kind: n for kind, n in desk.ingest(drive).counts.items() if n} for drive in (even, odd)]
    assert counts[0] == {"added": 4}
    # One of them is hardly more likely a cone than not in the odd pairs: enough to confirm it, not to found it.
    assert counts[1] == {"confirmed": 4}, "none doubled, none moved, none removed"
    features = desk.features()
    assert len(features) == 4
    assert all(feature["seen_count"] == 2 for feature in features)
    desk.ask("db", "audit")


def test_the_plan_of_a_drive_shows_its_lane_markings(desk: Desk, small_drive: Path) -> None:
    drawn: list[CommittedDrive] = []
    drawing = step("draw")(lambda committed, *_: drawn.append(committed))
    params = IngestParams(detection=DetectionParams(categories=(CONE, LANE_MARKING)))
    report = ingest(small_drive, params, desk.settings, publish_new=drawing)
    lines = [delta for delta in drawn[0].deltas if delta.is_line]
    assert len(lines) == report.line_counts[DeltaKind.ADDED] > 0
    assert len(report.changes) == report.counts[DeltaKind.ADDED] > 0, "the table of changes is of objects only"


def test_a_watched_drive_is_replaced_by_its_ingest_which_writes_its_report(
    desk: Desk, small_drive: Path, tmp_path: Path
) -> None:
    """Watched through the command line, then ingested; the page lies where the flow says, and comes again from the database.
    The versions of the map's work zones are stored, too."""
    name = "<b>small</b> drive"
    (small_drive / "drive.yaml").write_text(f"drive_id: {name}\n")
    (small_drive / "COMPLETE").touch()
    watched = json.loads(desk.ask("watch", small_drive, "--json"))
    assert watched["frame_pairs"] == 16 and watched["provisional_features"] >= 2
    with closing(connect(desk.environment["CONETL_DATABASE_URL"])) as conn:
        shown = read_provisional(conn, map_name="default")
        assert {row["drive_id"] for row in shown} == {name}
        assert len(shown) == watched["provisional_features"]
        assert execute(conn, "select * from conetl.map") == []  # no part of the map
        conn.rollback()
        done = desk.run("ingest", small_drive, "--json")
        assert done.returncode == 0, done.stderr
        assert read_provisional(conn, map_name="default") == []
        conn.rollback()
        again, _ = drive_page(conn, list_changesets(conn)[0], map_name="default")
    [report] = json.loads(done.stdout)
    [zone] = json.loads(desk.ask("zones", "history", "--json"))
    assert (zone["version"], zone["event"]) == (1, "began") and zone["state"]["work_zone_id"] == zone["zone_id"]
    reports = Path(desk.environment["CONETL_HOME"]) / "exports" / "reports" / "default"
    assert (reports / "_b_small__b__drive.png").read_bytes().startswith(b"\x89PNG")
    page = (reports / "000001-_b_small__b__drive.html").read_text()
    assert name not in page and "&lt;b&gt;small&lt;/b&gt; drive" in page
    for told in ("detect", "merge", "intervals measured", report["content_sha256"], report["model_sha256"]):
        assert told in page, told
    assert page.count("<figure>") == report["counts"]["added"]
    made = re.compile(r"at [0-9: -]+ UTC\. To write")
    assert made.sub("", again) == made.sub("", page)
