"""What a person judges by: the frame pairs that show a position, the sentence for each change, and what waits for a decision."""

from __future__ import annotations

import json
from collections import Counter

import pytest
from pydantic import SecretStr

from conetl.db.connection import execute
from conetl.db.map.drive_store import read_view
from conetl.db.map.map_store import list_changesets
from conetl.db.serve_store import read_feature_history
from conetl.pipeline.settings import Settings
from conetl.reports import drive_passes
from conetl.reports.drive_page import write_drive_page
from conetl.reports.drive_passes import reasons_of
from conetl.web.decisions import Writer
from tests.integration.conftest import command_line
from tests.integration.drives_of_days import DAY_NS, failed_audits, merge, survey
from tests.view_map import OWN, view_of

TOKEN = "a-token-that-nobody-guesses"
MAP = "/api/maps/default"
BY = {"decided_by": "Ada", "reason": "seen in the images"}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def client(module_conn, module_database_url, home):
    """Two days of a road, and a drive on hold."""
    for day in (0, 1):
        merge(module_conn, survey(day))
    merge(module_conn, survey(2), hold="GNSS/INS jumps by 5.0 m.")
    writer = Writer(SecretStr(TOKEN), module_database_url, Settings(home=home))
    with view_of(module_database_url, writer=writer) as test_client:
        yield test_client
    assert failed_audits(module_conn) == []


def get(client, path):
    answer = client.get(f"{MAP}/{path}")
    assert answer.status_code == 200, answer.text
    return answer.json()


def decide(client, request, status=201):
    headers = {"Authorization": f"Bearer {TOKEN}", "Origin": OWN}
    answer = client.post(f"{MAP}/decisions", json=request | BY, headers=headers)
    assert answer.status_code == status, answer.text
    return answer.json()


def changes(client, kind):
    return [c for c in get(client, "changes/view?changeset_no=2")["changes"] if c["kind"] == kind]


def test_the_empty_frame_pairs_are_those_that_removed_the_cone(client):
    [removed] = changes(client, "removed")
    last = get(client, f"features/{removed['feature_id']}")["history"][-1]
    assert (last["kind"], last["seen_count"], last["missed_count"]) == ("removed", 1, 1)
    found = get(client, f"features/{removed['feature_id']}/passes")["passes"]
    by_drive = {one["drive_uuid"]: one for one in found}
    frames = by_drive[last["drive_uuid"]]["frames"]
    empty = [f for f in frames if f["state"] == "empty"]
    assert abs(len(empty) - last["frames_empty"]) <= 1  # the drive's offset is not stored
    near, far = (f"{pick(f['range_m'] for f in empty):.0f}" for pick in (min, max))
    visible = f"the position was visible in {last['frames_empty']} frame pairs"
    assert last["why"].startswith(
        f"Removed: drive {last['drive_id']} passed at {near}–{far} m, {visible}, none showed a cone"
    )
    observed = {f["state"] for one in found if one["kind"] == "added" for f in one["frames"]}
    assert "observed" in observed and "empty" not in observed
    assert [one["counts"] for one in found if one["kind"] is None] == [
        False
    ]  # on hold: its images can be seen all the same


def test_the_sentence_is_the_same_everywhere(client, module_database_url, home):
    [removed] = changes(client, "removed")
    sentences = [h["why"] for h in get(client, f"features/{removed['feature_id']}")["history"]]
    conetl = command_line(home, module_database_url)
    logged = conetl("map", "log", removed["feature_id"])
    assert [line for line in logged.splitlines() if line in sentences] == sentences
    assert [entry["why"] for entry in json.loads(conetl("map", "log", removed["feature_id"], "--json"))] == sentences
    assert sentences[-1] in client.get(f"{MAP}/changesets/2/report").text


def test_each_drive_is_read_once_for_all_it_did_not_observe(client, module_conn, monkeypatch):
    """The sentences are those of each change by itself, as if both drives had missed all cones."""
    ids = [change["feature_id"] for change in get(client, "changes/view?changeset_no=2")["changes"]]
    found = [row for one in ids for row in read_feature_history(module_conn, "default", one)]
    rows = [row | {"kind": "missed", "track_index": None} for row in found]
    alone = [reasons_of(module_conn, [row])[0] for row in rows]
    read = []

    def counted(conn, header, near):
        read.append(header["drive_uuid"])
        return read_view(conn, header, near)

    monkeypatch.setattr(drive_passes, "read_view", counted)
    assert reasons_of(module_conn, rows) == alone and len({*alone}) > len(ids)
    assert sorted(read) == sorted({row["drive_uuid"] for row in rows}) and len(rows) > len(read) == 2
    module_conn.rollback()


def test_the_history_is_that_of_an_instant_of_the_database(client):
    first, second = get(client, "timeline")["changesets"][:2]
    [moved] = changes(client, "moved")
    then = get(client, f"features/{moved['feature_id']}?known_at={first['committed_at'].replace('+00:00', 'Z')}")
    now = get(client, f"features/{moved['feature_id']}")
    assert [h["kind"] for h in then["history"]] == ["added"]
    assert [h["kind"] for h in now["history"]] == ["added", "moved"] and second["changeset_no"] == 2


def test_a_frame_projects_onto_its_boxes(client):
    """The cameras of a frame pair put the position of each sighting at the foot of its box."""
    feature = get(client, "tiles/0/0/5")["features"][0]
    for sighting in get(client, f"features/{feature['feature_id']}/sightings")["sightings"][::5]:
        frame = get(client, f"drives/{sighting['drive_uuid']}/frames/{sighting['frame_index']}")
        for side in ("left", "right"):
            view = frame[side]
            [box] = [b for b in view["boxes"] if b["match_index"] == sighting["match_index"]]
            d = [a - b for a, b in zip(sighting["xyz_m"], view["xyz_m"], strict=True)]
            x, y, z = (sum(view["map_R_camera"][i][k] * d[i] for i in range(3)) for k in range(3))
            u, v = view["cx_px"] + view["fx_px"] * x / z, view["cy_px"] + view["fy_px"] * y / z
            assert abs(u - box["x_px"] - box["w_px"] / 2) < 5 and abs(v - box["y_px"] - box["h_px"]) < 5
            assert "is missing" in view["problem"]
    path = f"drives/{sighting['drive_uuid']}/frames/999999"
    assert client.get(f"{MAP}/{path}").status_code == client.get(f"{MAP}/{path}/left.jpg").status_code == 404


def test_the_queue_is_paged_and_what_is_decided_leaves_it(client, module_conn, home):
    """Last in this file: it decides. An accepted drive's report on disk is written again."""
    whole = get(client, "review?limit=100")
    kinds = [item["kind"] for item in whole["items"]]
    order = ["held", "removal", "move", "doubtful"]
    assert kinds == sorted(kinds, key=order.index) and kinds[:2] == ["held", "removal"] and "move" in kinds
    assert {kind: kinds.count(kind) for kind in order} == whole["counts"]
    pages = [get(client, f"review?limit=1&offset={k}")["items"] for k in range(len(kinds) + 1)]
    assert [item for page in pages for item in page] == whole["items"] and pages[-1] == []
    held = whole["items"][0]
    assert held["checks"] == [
        {"name": "jumps of the poses", "figures": "5.00 +- 0.10 m (limit 0.1)", "detail": held["why"]}
    ]

    settings = Settings(home=home)
    report = settings.drive_report_path(held["drive_id"], held["changeset_no"])
    known = {c.changeset_no: c for c in list_changesets(module_conn)}
    write_drive_page(module_conn, known[held["changeset_no"]], report, map_name="default")
    module_conn.rollback()
    assert "is on hold" in report.read_text()
    done = decide(client, {"kind": "accept", "changeset_id": held["changeset_id"]})
    assert done["report_problem"] is None and f"Released: drive {held['drive_id']}" in done["hold_changes"][0]
    assert "is on hold" not in report.read_text() and "accepted by Ada" in report.read_text()
    assert get(client, "review")["counts"]["held"] == 0
    accepted = get(client, "timeline")["changesets"][-1]
    made = get(client, f"changes/view?changeset_no={held['changeset_no']}")["changes"]
    assert accepted["change_counts"]["points"] == Counter(c["kind"] for c in made) != {}, (
        "its changes are those of its release"
    )
    assert accepted["effective_at"] == done["decided_at"] > accepted["committed_at"]

    now = next(item for item in get(client, "review")["items"] if item["kind"] == "removal")
    pin = {"kind": "pin", "feature_id": now["feature_id"], "expected_version": now["version"]}
    decide(client, pin)
    assert now["feature_id"] in {f["feature_id"] for f in get(client, "tiles/0/0/5")["features"]}
    assert now["feature_id"] not in {item["feature_id"] for item in get(client, "review?limit=100")["items"]}


def test_the_least_certain_are_reviewed_first(client, module_conn, samples):
    """Between 0.3 and 0.7; on a map of their own."""
    chances = (0.29, 0.35, 0.49, 0.62, 0.7, 0.71)
    cones = [samples.feature(str(one), existence_probability=one) for one in chances]
    samples.commit(module_conn, *map(samples.added, cones), key="d", map_name="doubtful")
    found = client.get("/api/maps/doubtful/review").json()
    assert [(item["kind"], item["existence_probability"]) for item in found["items"]] == [
        ("doubtful", one) for one in (0.49, 0.62, 0.35, 0.7)
    ]


def test_an_approval_holds_until_the_next_change_and_can_be_withdrawn(client, module_conn):
    """Last in this file: it decides, and merges another day."""
    moves = [item for item in get(client, "review?limit=100")["items"] if item["kind"] == "move"]
    one = {"feature_id": moves[0]["feature_id"], "expected_version": moves[0]["version"]}
    standing = get(client, "tiles/0/0/5")["features"]

    def waiting() -> set[str]:
        found = get(client, "review?limit=100")["items"]
        return {item["feature_id"] for item in found if item["kind"] == "move"}

    done = decide(client, {"kind": "approve"} | one)
    assert (done["versions_written"], done["replayed"]) == (0, 0)
    assert get(client, "tiles/0/0/5")["features"] == standing, "the map is unchanged"
    assert one["feature_id"] not in waiting()
    listed = get(client, "decisions")["decisions"][0]
    assert (listed["kind"], listed["feature_id"], listed["decided_by"]) == ("approve", one["feature_id"], "Ada")
    again = decide(client, {"kind": "approve"} | one, status=409)
    assert "already approved" in again["detail"]
    older = decide(client, {"kind": "approve"} | one | {"expected_version": 99}, status=409)
    assert older["now"]["version"] == moves[0]["version"]

    decide(client, {"kind": "withdraw", "decision_id": done["decision_id"]})
    assert one["feature_id"] in waiting()
    decide(client, {"kind": "approve"} | one)
    for drive, due in ((survey(3), False), (survey(1, after_ns=3 * DAY_NS), True)):  # the first moves nothing of it
        merge(module_conn, drive)
        module_conn.commit()
        assert (one["feature_id"] in waiting()) == due
    merge(module_conn, survey(1, after_ns=DAY_NS // 2))  # late: what the released drive did after it is replaced
    module_conn.commit()
    [released] = [entry for entry in get(client, "timeline")["changesets"] if entry["changeset_no"] == 3]
    made = get(client, "changes/view?changeset_no=3")["changes"]
    counts = {kind: count for kind, count in released["change_counts"]["points"].items() if kind != "missed"}
    assert counts == Counter(c["kind"] for c in made) != {}
    replaced = (
        "select distinct feature_id from conetl.delta where not upper_inf(system_period) and track_index is not null"
    )
    for row in execute(module_conn, replaced):
        found = get(client, f"features/{row['feature_id']}/sightings")["sightings"]
        pairs = [(one["drive_uuid"], one["frame_index"]) for one in found]
        assert len(pairs) == len(set(pairs)) > 0
    module_conn.rollback()


def test_a_class_is_corrected_from_the_web(client):
    one = get(client, "tiles/0/0/5")["features"][-1]
    about = {"feature_id": one["feature_id"], "expected_version": one["version"]}
    decide(client, {"kind": "classify", "category": "drum"} | about)
    [now] = [f for f in get(client, "tiles/0/0/5")["features"] if f["feature_id"] == one["feature_id"]]
    assert now["category"] == "drum"
