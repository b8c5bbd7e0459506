"""Drives while they are recorded: pairs as they arrive become provisional features, and the ingest replaces them."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.cli.watch import latency, report_as_dict
from conetl.db.connection import connect, execute
from conetl.db.live_store import WatchedDrive, drop_watched_recording, read_provisional, watch_lock, write_live
from conetl.db.map.map_store import find_map, map_transaction
from conetl.db.receipt_store import try_lock
from conetl.db.schema import run_audits
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.pipeline.analysis import analyse
from conetl.pipeline.settings import Settings
from conetl.pipeline.watch import WatchReport, pause_s, watch_drive
from conetl.readers.drives import read_drive
from conetl.readers.recording import ArrivingPair, ArrivingPlain
from tests.arriving_drives import FRAMES, SAMPLE, append, begin, image, row, write_images

#: A busy machine must not make a test fail: nothing is too old, and what is written late is waited for.
PATIENT = {"max_behind_s": 600.0, "patience_s": 600.0}


@pytest.fixture
def settings(database_url: str, tmp_path: Path) -> Settings:
    return Settings(database_url=database_url, home=tmp_path / "home", map_name="default")  # type: ignore[arg-type]


def watch(folder: Path, settings: Settings, **options: Any) -> WatchReport:
    return watch_drive(folder, settings, IngestParams(), stop=threading.Event(), **PATIENT | options)


@contextmanager
def recorder(write: Callable[[], None]) -> Any:
    """Something that writes beside the watch."""
    thread = threading.Thread(target=write)
    thread.start()
    yield
    thread.join()


def test_pairs_become_provisional_features_as_they_arrive(settings: Settings, conn: Any, tmp_path: Path) -> None:
    """Half an image, half a line, and a pose that comes after everything else: all are waited for."""
    folder = begin(tmp_path / "drive")
    ready, seen, tried = threading.Event(), threading.Event(), threading.Event()

    def write() -> None:
        ready.wait(60)
        for number in FRAMES:
            if number == 14:  # the right image in two pieces
                data, name = image(number, "right")
                (folder / "left" / name).write_bytes(image(number, "left")[0])
                (folder / "right" / name).write_bytes(data[: len(data) // 2])
                append(folder, row(number))
                tried.wait(60)
                time.sleep(0.3)  # the watch has nothing else to do: it looks at the half
                with (folder / "right" / name).open("ab") as file:
                    file.write(data[len(data) // 2 :])
            elif number == 16:  # the pose late, and in two pieces
                write_images(folder, number)
                line = row(number)
                append(folder, line[:20])
                time.sleep(0.3)
                append(folder, line[20:])
            else:
                append(folder, row(number))
                write_images(folder, number)
        assert seen.wait(60)  # the features are there before the drive has ended
        (folder / "COMPLETE").touch()

    def tell(report: WatchReport) -> None:
        ready.set()
        if len(report.pairs) == FRAMES.index(14):
            tried.set()
        if report.standing and len(report.pairs) >= len(FRAMES) - 2:
            seen.set()

    with recorder(write):
        report = watch(folder, settings, progress=tell)
    assert [p.frame_index for p in report.pairs] == list(range(len(FRAMES)))  # rows of trajectory.csv, in order
    assert (report.ended_by, report.left_out, dict(report.refused)) == ("COMPLETE", 0, {})
    assert all(p.total_s > 0 and p.waited_s < p.total_s for p in report.pairs)
    rows = read_provisional(conn, map_name="default")
    assert {r["feature_index"] for r in rows} == set(report.standing)
    assert len(rows) >= 2
    assert all(r["ended_at"] is not None and r["near_feature_id"] is None for r in rows)
    truth = np.loadtxt(SAMPLE / "truth.csv", delimiter=",", skiprows=1, usecols=(1, 2), dtype=float, encoding="utf-8")
    for found in rows:
        assert np.hypot(*(truth - (found["easting_m"], found["northing_m"])).T).min() < 0.3
        assert found["cov_xx"] ** 0.5 < 0.9  # the calibration states no errors: 0.7 px are 0.8 m at 20 m
    # They are near the cones of the whole drive.
    ingested = np.array([track.xyz_m for track in analyse(read_drive(folder)[0], settings=settings).tracks])
    for track in report.standing.values():
        assert np.linalg.norm(ingested - track.xyz_m, axis=1).min() < 0.2
    assert len(ingested) == len(report.standing)
    # They are no part of the map.
    assert find_map(conn, "default") is None
    assert execute(conn, "select count(*) as n from feature_version")[0]["n"] == 0
    assert all(audit.passed for audit in run_audits(conn))


def test_what_cannot_be_used_costs_its_pair(settings: Settings, tmp_path: Path) -> None:
    folder = begin(tmp_path / "drive")
    for number in FRAMES[:7]:
        wrong = {12: {"lat_deg": 95}, 14: {"lon_deg": 9.5}}.get(number, {})
        append(folder, row(number, **wrong) if number != 15 else "")
        write_images(folder, number)
    data, name = image(13, "left")
    (folder / "left" / name).write_bytes(data[:500])
    (folder / "COMPLETE").touch()
    report = watch(folder, settings, patience_s=1.0)
    # 12: no such latitude; 13: half an image for ever; 14: far away; 15: never a row.
    assert report.refused == {"pose_invalid": 2, "image_truncated": 1}
    assert report.left_out == 1
    assert len(report.pairs) == 3


def test_old_pairs_are_left_out_only_while_newer_ones_wait(settings: Settings, tmp_path: Path) -> None:
    """A machine that is too slow stays near the present; what lay there before the watch is taken all the same."""
    folder = begin(tmp_path / "drive")
    for number in FRAMES[:3]:
        append(folder, row(number))
        write_images(folder, number)

    def tell(report: WatchReport) -> None:
        if len(report.pairs) == 3:  # during the work on the third pair four more arrive
            for number in FRAMES[3:7]:
                append(folder, row(number))
                write_images(folder, number)
            (folder / "COMPLETE").touch()
            time.sleep(0.3)  # so that the system reports all of them at once

    report = watch(folder, settings, progress=tell, max_behind_s=1e-9)
    assert [p.frame_index for p in report.pairs[:3]] == [0, 1, 2]
    assert all(p.backlog for p in report.pairs[:3]) and not any(p.backlog for p in report.pairs[3:])
    assert report.pairs[-1].frame_index == 6  # the newest is always taken
    assert report.left_out == 7 - len(report.pairs) > 0
    assert set(latency(report.pairs)) and latency(report.pairs[:3]) == {}
    assert report_as_dict(report)["live_frame_pairs"] == len(report.pairs) - 3


def test_a_watch_ends_when_nothing_comes(settings: Settings, tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    assert watch(tmp_path / "drive", settings, idle_s=0.3).ended_by == "nothing came for 0.3 s"
    with pytest.raises(InputError, match="no such folder"):
        watch(tmp_path / "typo", settings)


def test_a_folder_that_never_becomes_a_drive_is_an_error(
    database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CONETL_DATABASE_URL", database_url)
    monkeypatch.setenv("CONETL_HOME", str(tmp_path / "home"))
    (tmp_path / "drive").mkdir()
    result = CliRunner().invoke(app, ["watch", str(tmp_path / "drive"), "--idle-seconds", "0.3"])
    assert isinstance(result.exception, InputError)
    assert "no drive was recorded here" in str(result.exception)


def test_the_next_step_after_a_watch_is_of_the_same_map(monkeypatch: pytest.MonkeyPatch) -> None:
    report = WatchReport("drive", "east")
    monkeypatch.setattr("conetl.pipeline.watch.watch_drive", lambda *_, **__: report)
    said = CliRunner().invoke(app, ["watch", "my drives/today", "--map", "east"]).stdout
    assert said.endswith("Next: conetl ingest --map east 'my drives/today'\n")


def test_a_pair_is_asked_for_its_place_until_it_has_one(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not at every look: with 36,000 pairs of an hour waiting that took 9 ms for each that was taken."""
    folder = begin(tmp_path / "drive")
    for number in FRAMES:
        write_images(folder, number)
    append(folder, "".join(row(number) for number in FRAMES[:3]))
    asked: Counter[str] = Counter()
    order = ArrivingPlain.order

    def counted(source: ArrivingPlain, pair: ArrivingPair) -> tuple[int, str]:
        asked[pair.key] += 1
        return order(source, pair)

    monkeypatch.setattr(ArrivingPlain, "order", counted)
    report = watch(folder, settings, idle_s=1.0)
    assert [p.frame_index for p in report.pairs] == [0, 1, 2]
    assert report.left_out == len(FRAMES) - 3
    assert [asked[f"{number:06d}"] for number in FRAMES[:3]] == [1, 1, 1]
    assert min(asked[f"{number:06d}"] for number in FRAMES[3:]) > 1, "their rows may still come"


def test_looks_at_all_files_are_rarer_the_longer_they_take() -> None:
    """On a long drive they must not be what makes pairs too old."""
    assert pause_s(0.001) == pause_s(0.01) == 1.0
    assert [look_s / (look_s + pause_s(look_s)) < 0.05 for look_s in (0.05, 0.5, 5.0)] == [True] * 3


def live_row(conn: Any, samples: Any, drive_id: str, at_ns: int, **changes: Any) -> WatchedDrive:
    drive = WatchedDrive(uuid4(), "default", samples.SRID, drive_id, f"drives/{drive_id}")
    write_live(
        conn, drive, captured_ns=(at_ns, at_ns + 10**9), frame_pair_count=3, tracks={0: samples.track(**changes)},
        taken_back=(), least_reach_m=0.5,
    )  # fmt: skip
    return drive


def names(conn: Any) -> list[str]:
    return sorted(row["drive_id"] for row in read_provisional(conn, map_name="default"))


def test_what_a_dead_watch_left_goes_and_a_living_one_is_left_alone(
    settings: Settings, conn: Any, samples: Any, tmp_path: Path, database_url: str
) -> None:
    for name in ("dead", "alive", "drive"):
        live_row(conn, samples, name, samples.START_NS)
    with closing(connect(database_url)) as other, try_lock(other, watch_lock("default", "alive")):
        folder = begin(tmp_path / "drive")
        (folder / "COMPLETE").touch()
        assert watch(folder, settings).cleared == 2
        assert names(conn) == ["alive"]
        with pytest.raises(InputError, match="is being watched already"):
            watch(begin(tmp_path / "alive"), settings)


def test_the_commit_of_a_drive_removes_what_was_shown_of_it(conn: Any, samples: Any, own_view: TestClient) -> None:
    """The same recording, not another one of its name; and a feature of the map is named where one is near."""
    live_row(conn, samples, "drive_1", samples.START_NS)
    live_row(conn, samples, "drive_1", samples.START_NS + samples.DAY_NS)
    live_row(conn, samples, "drive_2", samples.START_NS)
    feature = samples.feature()
    samples.commit(conn, samples.added(feature), key="1")
    assert names(conn) == ["drive_1", "drive_2"]
    live_row(conn, samples, "drive_3", samples.START_NS)
    near = {row["drive_id"]: row["near_feature_id"] for row in read_provisional(conn, map_name="default")}
    assert near == {"drive_1": None, "drive_2": None, "drive_3": feature.feature_id}
    told = own_view.get("/api/maps/default/provisional").json()
    assert [f["drive_id"] for f in told["features"]] == ["drive_1", "drive_2", "drive_3"]
    assert told["features"][2]["near_feature_id"] == str(feature.feature_id) and told["features"][2]["is_watched"]
    x, y, z = feature.xyz_m
    sigma_m = np.linalg.eigvalsh([samples.COV_M2[:2], (samples.COV_M2[1], samples.COV_M2[3])])[-1] ** 0.5
    for name, reach_m, found in (("near", 0.49, feature.feature_id), ("far", 0.51, None)):
        live_row(conn, samples, name, samples.START_NS, **samples.standing_at((x + reach_m + 3 * sigma_m, y, z)))
        near = {row["drive_id"]: row["near_feature_id"] for row in read_provisional(conn, map_name="default")}
        assert near[name] == found
    with map_transaction(conn):
        assert drop_watched_recording(conn, samples.drive("drive_3"), map_name="other") == 0
        assert drop_watched_recording(conn, samples.drive("drive_3"), map_name="default") == 1


def test_the_writer_may_watch_and_the_reader_may_look(conn: Any, samples: Any) -> None:
    execute(conn, "set session authorization conetl_writer")
    conn.commit()
    drive = live_row(conn, samples, "drive_1", samples.START_NS)
    write_live(
        conn, drive, captured_ns=(samples.START_NS, samples.START_NS + 2 * 10**9), frame_pair_count=4, tracks={},
        taken_back=[0], least_reach_m=0.5,
    )  # fmt: skip
    assert names(conn) == []
    execute(conn, "set session authorization default")
    execute(conn, "set role conetl_reader")
    assert names(conn) == []
