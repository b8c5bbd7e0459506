"""Logins of people: what each role may see and decide, on every route, and the log of whole images."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import SecretStr

from conetl.files.people import IMAGE_LOG, PEOPLE, people_of, read_people, remove_person
from conetl.model.errors import InputError
from conetl.pipeline.settings import Settings
from conetl.web.decisions import Writer
from tests.integration.conftest import command_line
from tests.integration.drives_of_days import merge, survey
from tests.view_map import OWN, view_of, with_images

SHARED, WRITER = "the-token-of-the-view-itself", "the-token-of-the-writers"
MAP = "/api/maps/default"
ROLES = ("read", "review", "admin")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def conetl(home: Path, module_database_url: str) -> Any:
    return command_line(home, module_database_url)


@pytest.fixture(scope="module")
def tokens(conetl: Any) -> dict[str, str]:
    """By role, of people added by the command."""
    return {role: json.loads(conetl("user", "add", f"Ada {role}", "--role", role, "--json"))["token"] for role in ROLES}


@pytest.fixture(scope="module")
def client(
    module_conn: Any, module_database_url: str, home: Path, tokens: dict[str, str], tmp_path_factory: Any
) -> Any:
    images = tmp_path_factory.mktemp("images")
    for day in (0, 1):
        found = survey(day)
        merge(module_conn, found._replace(drive=with_images(found.drive, found.detections, images / f"day_{day}")))
    merge(module_conn, survey(2), hold="GNSS/INS jumps by 5.0 m.")
    module_conn.commit()
    with view_of(
        module_database_url, writer=Writer(SecretStr(WRITER), module_database_url, Settings(home=home)),
        reader_token=SecretStr(SHARED), find_person=people_of(home), image_log=home / "logs" / IMAGE_LOG,
    ) as test_client:  # fmt: skip
        yield test_client


def as_(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}", "Origin": OWN}


def decide(client: Any, token: str, status: int, **request: Any) -> dict[str, Any]:
    body = {"decided_by": "somebody else", "reason": "seen in the images", **request}
    answer = client.post(f"{MAP}/decisions", json=body, headers=as_(token))
    assert answer.status_code == status, answer.text
    return answer.json()


def test_the_file_holds_no_token_and_is_the_owners(home, tokens, conetl):
    path = home / PEOPLE
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert not any(token in path.read_text() for token in tokens.values())
    assert json.loads(conetl("user", "list", "--json")) == [{"name": f"Ada {role}", "role": role} for role in ROLES]
    assert "there is already a user Ada read" in conetl("user", "add", "Ada read", code=2)
    path.chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        read_people(home)
    assert people_of(home)(tokens["read"]) is None, "an open file admits nobody"
    path.chmod(0o600)


def test_every_route_requires_a_login_and_every_role_may_read(client, tokens):
    paths = client.get("/api/openapi.json", headers=as_(SHARED)).json()["paths"]
    known = {"map_name": "default", "changeset_no": "1", "zoom": "0", "x": "0", "y": "5"}
    tried = 0
    for path, methods in paths.items():
        for method in methods:
            target = path
            for part in [p.strip("{}") for p in path.split("/") if "{" in p]:
                target = target.replace(f"{{{part}}}", known.get(part, "0"))
            if path.endswith("/events"):
                continue
            tried += 1
            assert client.request(method, target).status_code == 401, target
            assert client.request(method, target, headers=as_("not-a-token-of-anybody")).status_code == 401, target
            for token in (tokens["read"], tokens["admin"]):
                status = client.request(method, target, headers=as_(token)).status_code
                assert method == "post" or status not in (401, 403), (target, status)
    assert tried > 15
    for path in ("/", "/assets/index.js", "/ogc/collections"):
        assert client.get(path).status_code == 401
        assert client.get(path, headers=as_(tokens["read"])).status_code == 200


def test_roles_decide_about_features_and_drives(client, tokens, module_conn):
    features = client.get(f"{MAP}/tiles/0/0/5", headers=as_(SHARED)).json()["features"]
    about = {"kind": "pin", "feature_id": features[0]["feature_id"], "expected_version": features[0]["version"]}
    held = next(i for i in client.get(f"{MAP}/review", headers=as_(SHARED)).json()["items"] if i["kind"] == "held")
    drive = {"kind": "accept", "changeset_id": held["changeset_id"]}
    for request in (about, drive):
        decide(client, tokens["read"], 403, **request)
        decide(client, SHARED, 401, **request)
    pinned = decide(client, tokens["review"], 201, **about)
    assert "role admin" in decide(client, tokens["review"], 403, **drive)["detail"]
    accepted = decide(client, tokens["admin"], 201, **drive)
    decide(client, tokens["review"], 403, kind="withdraw", decision_id=accepted["decision_id"])
    decide(client, tokens["review"], 201, kind="withdraw", decision_id=pinned["decision_id"])
    other = client.post(
        f"{MAP}/decisions", json=drive, headers=as_(tokens["admin"]) | {"Origin": "https://elsewhere.example"}
    )
    assert other.status_code == 403
    rights = {}
    for role, token in tokens.items():
        answer = client.get(f"{MAP}/decisions", headers=as_(token)).json()
        rights[role] = (answer["person"], answer["writable"], answer["decides_drives"])
        assert [d["decided_by"] for d in answer["decisions"]] == ["Ada admin"], "the name is that of the login"
    assert rights == {
        "read": ("Ada read", False, False),
        "review": ("Ada review", True, False),
        "admin": ("Ada admin", True, True),
    }
    decide(client, WRITER, 201, kind="withdraw", decision_id=accepted["decision_id"])


def test_every_whole_image_is_logged(client, tokens, home):
    feature = client.get(f"{MAP}/tiles/0/0/5", headers=as_(SHARED)).json()["features"][0]["feature_id"]
    seen = client.get(f"{MAP}/features/{feature}/sightings", headers=as_(SHARED)).json()["sightings"][0]
    frame = f"{MAP}/drives/{seen['drive_uuid']}/frames/{seen['frame_index']}"
    crop = (
        f"{MAP}/drives/{seen['drive_uuid']}/pictures/{seen['frame_index']}/{seen['match_index']}/left.jpg?context=100"
    )
    log = home / "logs" / IMAGE_LOG
    images = {}
    for name, token in {"shared": SHARED, **tokens}.items():
        pixelated = client.get(frame, headers=as_(token)).json()["pixelated"]
        answers = [client.get(path, headers=as_(token)) for path in (f"{frame}/left.jpg", crop)]
        assert {a.headers["Cache-Control"] for a in answers} == {"private, max-age=3600" if pixelated else "no-store"}
        assert pixelated == (name in ("shared", "read"))
        images[name] = answers[0].content
    assert images["shared"] == images["read"] and images["review"] == images["admin"]
    decoded = cv2.imdecode(np.frombuffer(images["admin"], np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None and images["admin"] != images["read"]
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(one["name"], one["side"]) for one in lines] == [("Ada review", "left")] * 2 + [("Ada admin", "left")] * 2
    assert {(one["map"], one["frame_index"]) for one in lines} == {("default", seen["frame_index"])}
    assert stat.S_IMODE(log.stat().st_mode) == 0o600
    log.rename(log.with_suffix(".old"))
    log.mkdir()  # it cannot be written: no image is shown
    assert client.get(f"{frame}/left.jpg", headers=as_(tokens["admin"])).status_code in (404, 503)
    log.rmdir()


def test_who_is_removed_is_out_at_once(client, tokens, home):
    """Last in this file. The cookie of a login is refused too."""
    login = client.get("/", params={"token": tokens["review"]}, follow_redirects=False)
    assert login.status_code == 303 and "token" not in login.headers["location"]
    assert client.get(f"{MAP}/decisions").json()["person"] == "Ada review"
    remove_person(home, "Ada review")
    assert client.get(f"{MAP}/decisions").status_code == 401
    assert client.get(f"{MAP}/decisions", headers=as_(tokens["review"])).status_code == 401
    assert client.get(f"{MAP}/decisions", headers=as_(tokens["admin"])).status_code == 200
    client.cookies.clear()
