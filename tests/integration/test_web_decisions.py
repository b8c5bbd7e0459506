"""Decisions through the web view: only holders of the writer token write, and conflicts are reported."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from uuid import uuid4

import pytest
from pydantic import SecretStr

from conetl.cli.view import decision_writer
from conetl.db.connection import execute
from conetl.files.home import read_secret
from conetl.model.errors import InputError
from conetl.pipeline.settings import Settings
from conetl.web.decisions import Writer
from conetl.web.security import MAX_BODY_BYTES
from tests.integration.drives_of_days import failed_audits, merge, survey
from tests.view_map import OWN, shown, view_of

TOKEN = "a-token-that-nobody-guesses"
PATH = "/api/maps/default/decisions"


@pytest.fixture(scope="module")
def client(module_conn, module_database_url):
    for day in (0, 1):
        merge(module_conn, survey(day))
    with view_of(module_database_url, writer=Writer(SecretStr(TOKEN), module_database_url)) as test_client:
        yield test_client
    assert failed_audits(module_conn) == []


def post(client, request, status=201, token=TOKEN, **headers):
    answer = client.post(PATH, json=request, headers={"Authorization": f"Bearer {token}", "Origin": OWN, **headers})
    assert answer.status_code == status, answer.text
    return answer.json()


def standing(client):
    return shown(client)["features"]


def request_for(feature, kind="suppress", **changes):
    about = {"kind": kind, "feature_id": feature["feature_id"], "expected_version": feature["version"]}
    return {**about, "decided_by": "Ada Müller", "reason": "a bollard", **changes}


def withdrawn(client, decision):
    request = {"kind": "withdraw", "decision_id": decision["decision_id"], "decided_by": "Ada", "reason": "not so"}
    return post(client, request)


def test_a_suppressed_cone_is_gone_until_the_decision_is_withdrawn(client):
    before = standing(client)
    done = post(client, request_for(before[0]))
    assert done["kind"] == "suppress" and done["versions_written"] == before[0]["version"] == 2
    assert {f["feature_id"] for f in standing(client)} == {f["feature_id"] for f in before[1:]}
    answer = client.get(PATH).json()
    [listed] = answer["decisions"]
    assert answer["writable"] is True
    assert (listed["kind"], listed["decided_by"], listed["reason"]) == ("suppress", "Ada Müller", "a bollard")
    assert listed["feature_id"] == before[0]["feature_id"]
    assert listed["xy_m"] == pytest.approx(before[0]["xyz_m"][:2], abs=1e-3)
    assert withdrawn(client, done)["kind"] == "withdraw"
    assert standing(client) == before
    assert client.get(PATH).json()["decisions"] == []


def test_pin_and_unpin_every_cone_that_stands_by_the_version_of_its_history(client):
    feature = standing(client)[-1]
    history = client.get(f"/api/maps/default/features/{feature['feature_id']}").json()["history"]
    assert history[-1]["version"] == feature["version"]
    done = post(client, request_for(feature, "pin", radius_m=0.5))
    again = post(client, request_for(feature, "pin"), 409)
    assert "already" in again["detail"] and again["now"]["version"] == feature["version"]
    withdrawn(client, done)
    assert "is no longer active" in post(
        client, {"kind": "withdraw", "decision_id": done["decision_id"], "decided_by": "Ada", "reason": "again"}, 409
    )["detail"]  # fmt: skip


def test_a_pinned_cone_is_drawn_as_it_is_counted(client):
    """The counts of a drive and its changes are as known then, also after a pin has put back what it removed."""

    changes_of_second = "/api/maps/default/changes/view?changeset_no=2"

    def shown():
        second = client.get("/api/maps/default/timeline").json()["changesets"][1]
        drawn = Counter(
            change["kind"] for change in client.get("/api/maps/default/changes/view?changeset_no=2").json()["changes"]
        )
        return second["change_counts"]["points"], dict(drawn)

    counted, drawn = shown()
    assert counted == drawn and drawn["removed"] > 0
    changes = client.get(changes_of_second).json()["changes"]
    gone = next(change for change in changes if change["kind"] == "removed")
    done = post(client, request_for(gone, "pin"))
    assert gone["feature_id"] in {feature["feature_id"] for feature in standing(client)}
    assert shown() == (counted, drawn)
    withdrawn(client, done)


def test_a_conflict_reports_the_current_state_and_writes_nothing(client):
    feature = standing(client)[0]
    answer = post(client, request_for(feature, expected_version=feature["version"] + 1), 409)
    assert "has changed: you decided on version" in answer["detail"]
    assert (answer["now"]["version"], answer["now"]["xyz_m"]) == (feature["version"], feature["xyz_m"])
    assert client.get(PATH).json()["decisions"] == []


def test_a_changeset_is_reverted_and_comes_back(client):
    [first, second] = client.get("/api/maps/default/timeline").json()["changesets"]
    before = standing(client)
    request = {
        "kind": "revert",
        "changeset_id": second["changeset_id"],
        "decided_by": "Ada",
        "reason": "wrong calibration",
    }
    done = post(client, request)
    timeline = client.get("/api/maps/default/timeline").json()["changesets"]
    assert [c["counts"] for c in timeline] == [True, False]
    assert standing(client) != before
    assert client.get(PATH).json()["decisions"][0]["drive_id"] == second["drive_id"]
    assert "already been reverted" in post(client, request, 409)["detail"]
    withdrawn(client, done)
    assert standing(client) == before
    assert first["counts"]


@pytest.mark.parametrize(
    ("status", "headers"),
    [
        (401, {"Authorization": "Bearer a-token-that-nobody-guesseD"}), (401, {"Authorization": f"Basic {TOKEN}"}),
        (401, {"Authorization": "Bearer ä" * 3}), (401, {"Authorization": ""}),
        (403, {"Origin": "http://evil.example"}), (403, {"Origin": "null"}), (403, {"Origin": "http://127.0.0.1:1"}),
        (403, {"Sec-Fetch-Site": "cross-site"}),
        (415, {"Content-Type": "text/plain"}), (415, {"Content-Type": "application/x-www-form-urlencoded"}),
        (413, {"Content-Length": str(MAX_BODY_BYTES + 1)}),
    ],
)  # fmt: skip
def test_nobody_else_writes(client, module_database_url, status, headers):
    request = json.dumps(request_for(standing(client)[0])).encode()
    good = {"Authorization": f"Bearer {TOKEN}", "Origin": OWN, "Content-Type": "application/json"}
    sent = {name: value.encode() for name, value in {**good, **headers}.items()}
    answer = client.post(PATH, content=request, headers=sent)
    assert answer.status_code == status, answer.text
    assert TOKEN not in answer.text
    assert client.get(PATH).json()["decisions"] == []
    in_the_address = client.post(f"{PATH}?token={TOKEN}&access_token={TOKEN}", json=request_for(standing(client)[0]))
    assert in_the_address.status_code == 401


@pytest.mark.parametrize(
    "changes",
    [
        {"decided_by": " "}, {"reason": ""}, {"reason": "two\nlines"}, {"reason": "x" * 501}, {"radius_m": 0}, {"radius_m": 21},
        {"radius_m": "NaN"}, {"expected_version": 0}, {"feature_id": "'; drop table conetl.map --"}, {"kind": "delete"},
        {"extra": 1},
    ],
)  # fmt: skip
def test_invalid_decisions_are_refused(client, changes):
    post(client, request_for(standing(client)[0], **changes), 422)
    assert client.get(PATH).json()["decisions"] == []


def test_an_unknown_feature_is_not_found(client):
    answer = post(client, request_for({"feature_id": str(uuid4()), "version": 1}), 404)
    assert "There is no feature" in answer["detail"]


def test_a_server_without_a_token_writes_nothing(client, module_conn, module_database_url):
    with view_of(module_database_url) as reading:
        assert reading.get(PATH).json()["writable"] is False
        for token in ("", TOKEN, "None"):
            assert "is read-only" in post(reading, request_for(standing(client)[0]), 403, token=token)["detail"]
        paths = reading.get("/api/openapi.json").json()["paths"]
        writing = [
            (path, method) for path, methods in paths.items() for method in methods if method not in {"get", "head"}
        ]
        assert sorted(writing) == [
            ("/api/maps/{map_name}/decisions", "post"),
            ("/api/maps/{map_name}/differences/{difference_id}", "post"),
        ]
    assert execute(module_conn, "select count(*) as n from conetl.active_decision") == [{"n": 0}]
    module_conn.rollback()


def test_only_a_server_with_a_token_accepts_decisions_and_none_prints_it(tmp_path: Path, capfd):
    home = Settings(home=tmp_path / "home")
    assert decision_writer(home, "", on_request=False, token_file=None) is None
    assert not (tmp_path / "home").exists()
    made = decision_writer(home, "", on_request=True, token_file=None)
    in_file = read_secret(tmp_path / "home" / "writer_token")
    assert made is not None and made.token == in_file
    named = decision_writer(
        Settings(home=tmp_path, writer_token=SecretStr(TOKEN)), "", on_request=True, token_file=None
    )
    assert named is not None and named.token.get_secret_value() == TOKEN and not (tmp_path / "writer_token").exists()
    said = "".join(capfd.readouterr())
    assert "writer_token" in said and TOKEN not in said and in_file.get_secret_value() not in said
    with pytest.raises(InputError, match="CONETL_WRITER_TOKEN"):
        decision_writer(Settings(home=tmp_path, writer_token=SecretStr("short")), "", on_request=False, token_file=None)
