"""QA reports from a real PostGIS: their content, that everything is escaped, and that a page loads nothing."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import UUID, uuid4

import numpy as np
import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.connection import execute
from conetl.db.map.map_store import list_changesets
from conetl.db.map.results import CommittedChangeset
from conetl.db.receipt_store import Receipt, StepTime, write_receipt, write_run_steps
from conetl.model.errors import InputError
from conetl.model.map_records import DeltaKind
from conetl.model.params import IngestParams
from conetl.model.rejections import RejectionReason
from conetl.reports import drive_facts
from conetl.reports.drive_facts import read_drive_facts
from conetl.reports.drive_page import _residual_rows, _trajectory_rows, alerts, drive_page, images_of, write_drive_page
from conetl.reports.night_page import night_page, read_night, write_night_page
from tests.chromium import chromium
from tests.integration.drives_of_days import merge, survey
from tests.view_map import two_drives, view_of

EVIL = "<img src=x onerror=alert(1)>"
#: Width of an A4 sheet without the margins of `base.html.j2`, at 96 px per inch.
A4_PX = 703


@pytest.fixture(scope="module")
def shown(module_conn: Any, samples: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A map of two drives with images; the second one with everything that a report may show."""
    conn = module_conn
    two_drives(conn, samples, tmp_path_factory.mktemp("images"))
    latest = list_changesets(conn)[0]
    run_id = uuid4()
    execute(
        conn,
        "insert into run values (%(id)s, now(), now(), %(params)s, null, %(facts)s)",
        {
            "id": run_id,
            "params": IngestParams().model_dump_json(),
            "facts": '{"trajectory": "poses moved by up to 0.07 m", "trajectory_outcome": "not_converged", '
            '"calibration": "<b>turned</b>", "calibration_outcome": "applied", "code_sha256": "abc", '
            '"python": "3.11", "libraries": {"numpy": "2.1"}, "health": [{"name": "blurred parts of the lenses", '
            '"verdict": "warn", "value": 0.3, "limit": 0.1, "detail": "Clean <b>the lens</b>."}]}',
        },
    )
    values = {"r": run_id, "c": latest.changeset_id, "name": EVIL, "d": latest.drive_uuid}
    execute(conn, "update changeset set run_id = %(r)s where changeset_id = %(c)s", values)
    execute(conn, "update drive set drive_id = %(name)s where drive_uuid = %(d)s", values)
    for reason in (RejectionReason.NEVER_NEAR, RejectionReason.NEVER_NEAR, RejectionReason.IMAGE_TRUNCATED):
        execute(
            conn,
            "insert into quarantine (changeset_id, step, reason, record, detail, payload) "
            "values (%(c)s, 'tracks', %(reason)s, 'a record', %(detail)s, '{}')",
            {"c": latest.changeset_id, "reason": reason, "detail": EVIL},
        )
    conn.commit()
    steps = [StepTime("detect", 2, 3.0, 0.0, 2.0), StepTime("merge", 1, 0.25, 2.0, 2.25)]
    for _ in range(2):  # a task that is tried again writes them once
        write_run_steps(conn, latest.changeset_id, steps)
    return conn


@pytest.fixture
def latest(shown: Any) -> CommittedChangeset:
    return list_changesets(shown)[0]


def assert_loads_nothing(page: str) -> None:
    """No script, and nothing that a browser would fetch."""
    assert EVIL not in page
    assert not re.search(r"<(script|iframe|link|object|embed)\b", page)
    assert not re.search(r"\bon\w+\s*=\s*[\"']", page)
    assert all(source.startswith("data:image/") for source in re.findall(r"\bsrc=\"([^\"]*)", page))
    assert "@import" not in page and "url(" not in page


def test_the_report_of_a_drive(shown: Any, latest: CommittedChangeset, samples: Any, tmp_path: Path) -> None:
    path = write_drive_page(shown, latest, tmp_path / "reports" / "drive.html", map_name="default")
    page = path.read_text()
    assert_loads_nothing(page)
    assert page.count(">sigma horiz. m</th>") == page.count(">sigma height m</th>") == 2
    assert "&lt;img src=x onerror=alert(1)&gt;" in page
    facts = read_drive_facts(shown, latest, map_name="default")
    assert [c["number"] for c in facts.changes] == [1, 2, 3, 4]
    kinds = [c["kind"] for c in facts.changes]
    assert kinds == [DeltaKind.REMOVED, DeltaKind.MOVED, DeltaKind.ADDED, DeltaKind.CONFIRMED]
    for told in (
        latest.model_sha256, latest.params_sha256, latest.content_sha256, "abc", "numpy 2.1",
        "poses moved by up to 0.07 m",
        "&lt;b&gt;turned&lt;/b&gt;", "never near", "image truncated", "changeset 2", "merge",
        *(str(c["feature_id"]) for c in facts.changes),
    ):  # fmt: skip
        assert told in page, told
    assert [(line["reason"], line["count"]) for line in facts.rejections] == [("never_near", 2), ("image_truncated", 1)]
    assert [(s["step"], s["busy_s"]) for s in facts.header["steps"]] == [("detect", 3.0), ("merge", 0.25)]
    # moved: before and after; added: this drive; each with a left and a right crop
    images = images_of(shown, facts)
    assert {facts.changes[n - 1]["kind"]: [len(p.crops) for p in pairs] for n, pairs in images.items()} == {
        DeltaKind.REMOVED: [2, 0], DeltaKind.MOVED: [2, 2], DeltaKind.ADDED: [2],
    }  # fmt: skip
    assert images[1][1].missing  # its place was in no image of the second drive
    assert [pairs[0].title.split(",")[0] for number, pairs in images.items() if number < 3] == ["before: drive_1"] * 2


def test_a_missing_image_is_left_out(shown: Any, latest: CommittedChangeset) -> None:
    facts = read_drive_facts(shown, latest, map_name="default")
    gone = replace(facts, header=facts.header | {"source_path": "/nowhere"})
    assert "no image" in drive_page(shown, latest, map_name="default")[0]  # of the cone that is gone
    assert images_of(shown, gone)[2][0].crops  # the drive before still has its own


def test_alerts(shown: Any, latest: CommittedChangeset) -> None:
    facts = read_drive_facts(shown, latest, map_name="default")
    told = " ".join(f.text for f in alerts(facts))
    assert "1 cone removed from the map: no. 1" in told
    assert "The trajectory was not refined" in told and "Calibration: <b>turned</b>" in told
    assert "Clean <b>the lens</b>." in told
    confirmed = tuple(c for c in facts.changes if c["kind"] is DeltaKind.CONFIRMED)
    calm = replace(facts, header=facts.header | {"facts": {}}, changes=confirmed, checks=())
    assert alerts(calm) == []
    lossy = replace(calm, changeset=latest.model_copy(update={"expected_frame_count": 100}))
    assert [f.serious for f in alerts(lossy)] == [True]
    blurred = replace(calm, residual_px=calm.residual_px + 3.0)
    assert [f.serious for f in alerts(blurred)] == [True]
    reverted = replace(calm, changeset=latest.model_copy(update={"counts": False}))
    assert "not in effect" in alerts(reverted)[0].text
    for missed, observed, serious in ((4, 3, True), (3, 0, False), (9, 9, False), (9, 8, True)):
        points = Counter({DeltaKind.MISSED: missed, DeltaKind.CONFIRMED: observed})
        counts = latest.change_counts.model_copy(update={"points": points})
        told = alerts(replace(calm, changeset=latest.model_copy(update={"change_counts": counts})))
        assert any("another road" in f.text for f in told) == serious, (missed, observed)


def test_residuals_are_of_their_ranges_and_sigmas_of_their_axes(shown: Any, latest: CommittedChangeset) -> None:
    facts = read_drive_facts(shown, latest, map_name="default")
    pose = facts.frame_pairs[0].pose.model_copy(update={"sigma_enu_m": (0.1, 0.2, 0.5)})
    pairs = [pair.model_copy(update={"pose": pose}) for pair in facts.frame_pairs]
    ranges_m = np.array([9.9, 10.0, 19.9, 20.0])
    made = replace(facts, frame_pairs=pairs, range_m=ranges_m, residual_px=np.array([1.0, 2.0, 3.0, 9.0]))
    shown_px = [(count, largest) for _, count, _, _, largest in _residual_rows(made)[:4]]
    assert shown_px == [("4", "9.00"), ("1", "1.00"), ("2", "3.00"), ("1", "9.00")]
    rows = dict(_trajectory_rows(made))
    assert rows["horizontal sigma of the poses"] == "median 0.200 m, largest 0.200 m"
    assert rows["vertical sigma of the poses"] == "median 0.500 m, largest 0.500 m"


def test_the_page_of_a_drive_fits_a_sheet(shown: Any, latest: CommittedChangeset, tmp_path: Path) -> None:
    path = tmp_path / "drive.html"
    write_drive_page(shown, latest, path, map_name="default")
    with chromium() as browser:
        tab = browser.new_page(viewport={"width": A4_PX, "height": 1000})
        tab.emulate_media(media="print")
        tab.goto(path.as_uri())
        right_px = tab.evaluate("[...document.querySelectorAll('table')].map((t) => t.getBoundingClientRect().right)")
    assert len(right_px) > 3 and max(right_px) <= A4_PX


def test_wide_tables_are_scrolled_by_keys_on_a_phone(shown: Any, latest: CommittedChangeset, tmp_path: Path) -> None:
    path = tmp_path / "drive.html"
    write_drive_page(shown, latest, path, map_name="default")
    with chromium() as browser:
        tab = browser.new_page(viewport={"width": 390, "height": 844})
        tab.goto(path.as_uri())
        assert tab.evaluate("document.scrollingElement.scrollWidth") <= 390
        wide = "[...document.querySelectorAll('table')].filter((t) => t.scrollWidth > t.clientWidth)"
        focusable = tab.evaluate(f"{wide}.map((t) => t.tabIndex)")
        assert len(focusable) > 1 and set(focusable) == {0}
        # A screen reader jumps to the content by its landmark.
        assert tab.evaluate("[...document.body.children].map((e) => e.tagName)") == ["MAIN"]


def test_a_long_name_of_a_drive_has_a_line_of_its_own(shown: Any, tmp_path: Path) -> None:
    night = read_night(shown, map_name="default", since=datetime(2000, 1, 1, tzinfo=UTC), until=datetime.now(UTC))
    name = "BAB8_KM214_Richtungsfahrbahn_Sued_Fruehschicht_Fahrzeug03_20260302_104107"
    drives = [row | {"drive_id": name} for row in night.drives]
    (tmp_path / "night.html").write_text(night_page(replace(night, drives=drives)))
    with chromium() as browser:
        tab = browser.new_page(viewport={"width": A4_PX, "height": 1000})
        tab.emulate_media(media="print")
        tab.goto((tmp_path / "night.html").as_uri())
        table = tab.locator("h2:text-is('Drives') ~ table").first
        rights_px, heights_px = (
            table.evaluate(f"t => [...t.querySelectorAll('b')].map(b => b.getBoundingClientRect().{side})")
            for side in ("right", "height")
        )
        assert table.evaluate("t => t.getBoundingClientRect().right") <= A4_PX
    assert len(rights_px) == len(drives) and max(rights_px) <= A4_PX and max(heights_px) < 20


def test_an_empty_drive_has_a_report(shown: Any, samples: Any) -> None:
    """Committed without the flow, without positions and images."""
    samples.commit(shown, key="abcd", map_name="bare")
    bare = list_changesets(shown, map_name="bare")[0]
    page, _ = drive_page(shown, bare, map_name="bare")
    assert_loads_nothing(page)
    assert "Not stored for this changeset" in page and "this drive did not change the map" in page
    execute(shown, "update drive set pruned_at = now() where drive_uuid = %(d)s", {"d": bare.drive_uuid})
    execute(shown, "delete from position where drive_uuid = %(d)s", {"d": bare.drive_uuid})
    assert "were pruned on" in drive_page(shown, bare, map_name="bare")[0]
    shown.rollback()


def failed(drive: str, state: str, *, attempt: int = 1, header: str = "", **values: Any) -> Receipt:
    return Receipt(
        attempt_id=UUID(int=100 * int(drive) + attempt), map_name="default", drive_path=f"/in/{EVIL}",
        drive_id=f"{EVIL} {drive}", header_sha256=(header or drive) * 64, analysis_sha256="0" * 64, frame_pairs=10,
        flow_run_id=None, host="here", state=state, **values,
    )  # fmt: skip


def test_the_report_of_a_night(shown: Any, latest: CommittedChangeset, tmp_path: Path) -> None:
    for receipt in (
        failed("1", "started"), failed("1", "failed", reason=f"no usable pose {EVIL}"), failed("2", "started"),
        failed("3", "failed", reason="it will pass"), failed("3", "started", attempt=2),
        failed("3", "committed", attempt=2, changeset_id=latest.changeset_id, seconds=12.0, content_sha256="0" * 64),
        failed("4", "failed", reason="no calibration"), failed("4", "failed", attempt=2, reason="no calibration"),
        failed("5", "failed", reason="no calibration"),  # it was repaired
        failed("5", "known", attempt=2, header="6", changeset_id=latest.changeset_id, content_sha256="0" * 64),
    ):  # fmt: skip
        write_receipt(shown, receipt, tmp_path)
    until = datetime.now(UTC) + timedelta(hours=1)
    since = datetime(2000, 1, 1, tzinfo=UTC)
    facts = write_night_page(shown, tmp_path / "night.html", map_name="default", since=since, until=until)
    page = (tmp_path / "night.html").read_text()
    assert_loads_nothing(page)
    assert [row["drive_id"] for row in facts.drives][-1] == EVIL
    assert [(row["state"], row["attempts"]) for row in facts.failures] == [("failed", 1), ("started", 1), ("failed", 2)]
    assert facts.drives[-1]["seconds"] == 12.0
    assert [row["kind"] for row in facts.changes if row["number"] <= row["gone"]] == ["removed"]
    counted = sum(
        row["change_counts"].points[kind]
        for row in facts.drives
        for kind in ("added", "moved", "removed", "split", "merged")
    )
    assert {row["total"] for row in facts.changes} == {len(facts.changes)} == {counted}
    assert all(0 < row["sigma_m"] < 1 for row in facts.changes)
    assert {row["reason"]: row["count"] for row in facts.rejections} == {"never_near": 2, "image_truncated": 1}
    now = execute(shown, "select count(*) as n from current_feature where map_name = 'default'")[0]["n"]
    assert [count for _, count in facts.sizes][-1] == facts.size_at(until) == now
    assert facts.size_at(since) == 0
    assert [row["notes"] for row in facts.drives] == [None, ["Clean <b>the lens</b>."]]
    for told in (
        "3 drives or other entries failed", "no usable pose", "1 object was removed", "removed",
        "Clean &lt;b&gt;the lens&lt;/b&gt;.",
    ):  # fmt: skip
        assert told in page
    write_receipt(shown, replace(failed("7", "failed", reason="no calibration"), drive_path=str(tmp_path)), tmp_path)
    next_night = read_night(shown, map_name="default", since=until, until=until + timedelta(days=1))
    assert [row["drive_path"] for row in next_night.failed] == [str(tmp_path)], "the others' folders are gone"


def test_of_several_analyses_of_a_drive_that_in_effect_is_found(
    shown: Any, latest: CommittedChangeset, monkeypatch: pytest.MonkeyPatch
) -> None:
    reverted = latest.model_copy(update={"counts": False, "changeset_no": 9})
    for known, found in (([reverted, latest], latest), ([reverted], reverted)):
        monkeypatch.setattr(drive_facts, "list_changesets", lambda *_, known=known, **__: known)
        assert drive_facts.find_drive(shown, latest.drive_id, map_name="default") == found


def test_lane_markings_are_in_the_plan_and_not_in_the_size_of_a_map(shown: Any, samples: Any) -> None:
    vertices_m = [(458_000.0 + k, 5_428_000.0, 114.5) for k in range(3)]
    line = samples.line_feature(samples.marking(vertices_m, pattern="dashed", dash_m=1.0, gap_m=2.0, colour="yellow"))
    samples.commit(shown, samples.added(samples.feature()), samples.added(line), key="abce", map_name="painted")
    night = read_night(
        shown, map_name="painted", since=datetime(2000, 1, 1, tzinfo=UTC), until=datetime.now(UTC) + timedelta(hours=1)
    )
    assert [count for _, count in night.sizes] == [1]
    [paint] = read_drive_facts(shown, list_changesets(shown, map_name="painted")[0], map_name="painted").markings
    assert np.allclose(paint.line_m, vertices_m)
    assert paint[1:] == ("yellow", 1.0, 2.0, DeltaKind.ADDED, None)


def test_a_night_ends_before_the_next_one_begins(shown: Any) -> None:
    second, first = list_changesets(shown)
    for since, until, drives in (
        (first.committed_at, second.committed_at, [first]),
        (second.committed_at, datetime.now(UTC), [second]),
    ):
        night = read_night(shown, map_name="default", since=since, until=until)
        assert [row["drive_id"] for row in night.drives] == [drive.drive_id for drive in drives]


def test_an_empty_and_an_invalid_night(shown: Any) -> None:
    begin = datetime(2001, 1, 1, tzinfo=UTC)
    quiet = read_night(shown, map_name="default", since=begin, until=begin + timedelta(days=1))
    assert (quiet.drives, quiet.failures, quiet.changes) == ([], [], [])
    assert "No drive was added to the map" in night_page(quiet)
    page = night_page(replace(quiet, markings=[{"kind": "missed", "count": 2, "length_m": 12.0}]))
    assert ">not observed</td><td>2</td>" in page and ">missed<" not in page
    with pytest.raises(InputError, match="before it begins"):
        read_night(shown, map_name="default", since=begin, until=begin)
    with pytest.raises(InputError, match="no map named nowhere"):
        read_night(shown, map_name="nowhere", since=begin, until=begin + timedelta(days=1))


def test_entries_are_reported_before_the_first_drive_is_on_the_map(shown: Any) -> None:
    begin = datetime(2001, 1, 1, tzinfo=UTC)
    stray = {"drive_id": "a.zip", "drive_path": "/in/a.zip", "state": "not recognised", "reason": "an archive"}
    night = read_night(shown, map_name="new", since=begin, until=begin + timedelta(days=1), drop_folder=[stray])
    assert night.entries == [stray] and "an archive" in night_page(night)


def test_the_web_view_serves_the_report(shown: Any) -> None:
    with view_of(shown.dsn) as client:
        answer = client.get("/api/maps/default/changesets/2/report")
        assert answer.status_code == 200
        assert_loads_nothing(answer.text)
        assert (
            "default-src 'none'; img-src data:; style-src 'unsafe-inline'" in answer.headers["content-security-policy"]
        )
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert client.get("/api/maps/default/changesets/77/report").status_code == 404


def test_the_commands(shown: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`conetl report drive` and `night`, in this process."""
    for name, value in (("DATABASE_URL", shown.dsn), ("HOME", str(tmp_path)), ("MAP_NAME", "default")):
        monkeypatch.setenv(f"CONETL_{name}", value)
    runner = CliRunner()
    one = runner.invoke(app, ["report", "drive", "1", "--json"])
    assert one.exit_code == 0, one.output
    assert json.loads(one.stdout)["changeset_no"] == 1
    assert (tmp_path / "exports" / "reports" / "default" / "000001-drive_1.html").is_file()
    last_day = runner.invoke(app, ["report", "night", "9999-12-31"])
    assert isinstance(last_day.exception, InputError)
    night = runner.invoke(app, ["report", "night", "2026-03-01", "--out", str(tmp_path / "night.html"), "--json"])
    assert json.loads(night.stdout)["since"] == "2026-03-01T00:00:00Z"
    assert json.loads(night.stdout)["drives"] == 1
    said = [runner.invoke(app, ["report", "night", day]).stdout for day in ("2026-03-01", "2026-02-01")]
    assert said[0].startswith("1 drive processed from 2026-03-01 00:00 to 2026-03-02 00:00 UTC.")
    assert said[1].startswith(
        "No drives processed from 2026-02-01 00:00 to 2026-02-02 00:00 UTC. Drives are listed by the time"
    )
    assert "Drives are listed by the time" not in said[0]


def test_drives_on_hold_are_named_first_and_their_pages_follow_decisions(
    conetl: Callable[..., str], conn: Any, tmp_path: Path
) -> None:
    """In the report of the night, the log of the map and the drive's own page."""
    first, held = survey(0), survey(1)
    merge(conn, first)
    merge(conn, held, hold=f"GNSS/INS jumps {EVIL}.")
    conn.commit()
    night = json.loads(conetl("report", "night", "--out", tmp_path / "night.html", "--json", code=1))
    assert [(one["drive_id"], one["checks"][0]["value"]) for one in night["held"]] == [(held.drive.drive_id, 5.0)]
    page = (tmp_path / "night.html").read_text()
    assert_loads_nothing(page)
    assert "<b>1</b><span>drives added</span>" in page, "a drive on hold is not counted"
    assert "1 drive is on hold: accept or revert" in page and "All drives are on the map" not in page
    for said in (
        "jumps of the poses",
        "5.00 +- 0.10 m (limit 0.1)",
        "conetl drive accept 2 --map default --note REASON",
    ):
        assert said in page, said
    conetl("report", "drive", "2")
    [path] = (tmp_path / "home" / "exports" / "reports" / "default").glob("*2-*.html")
    assert "the drive is on hold. GNSS/INS jumps" in path.read_text()
    assert "Released: drive" in conetl("drive", "accept", held.drive.drive_id, "--note", "seen", "--by", "Ada")
    page = path.read_text()
    assert_loads_nothing(page)
    assert "The drive was on hold, and was accepted by Ada: seen" in page and "not in effect" not in page
    assert "Holds and releases" in page
    assert json.loads(conetl("report", "night", "--out", tmp_path / "night.html", "--json"))["held"] == []
    conn.rollback()
    night = read_night(conn, map_name="default", since=datetime(2000, 1, 1, tzinfo=UTC), until=datetime.now(UTC))
    logged = list_changesets(conn)[0]
    assert night.drives[1]["counts"] and logged.change_counts.points[DeltaKind.CONFIRMED]
    assert night.drives[1]["change_counts"] == logged.change_counts
    events = [read_drive_facts(conn, one, map_name="default").hold_events for one in list_changesets(conn)]
    conn.rollback()
    assert ([event.what for event in events[0]], events[1]) == (["on hold", "accepted"], ())
    log = [line.split()[-1] for line in conetl("map", "log").splitlines()[1:]]
    assert log[0] == "seen" and len(log) == 4
    [decision] = json.loads(conetl("map", "decisions", "--json"))
    assert "On hold now: drive" in conetl("map", "revert", decision["decision_id"])
    assert "the drive is on hold. GNSS/INS jumps" in path.read_text()
