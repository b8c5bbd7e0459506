"""Nothing in a drop folder or below the folder of a backfill disappears: one row each in plan, run, report and --json."""

from __future__ import annotations

import json
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from conetl.db.connection import connect, execute
from conetl.files.names import printable
from conetl.pipeline import entries
from flows import dispatch
from flows.scheduled import ingest_drop_folder
from tests.integration.conftest import command_line, conetl_process
from tests.integration.kinds_of_entries import Expected, make_kinds


@dataclass
class Office:
    """The folder, what is expected of it, and the commands of its owner."""

    root: Path
    expected: dict[str, Expected]
    environment: dict[str, str]

    @property
    def person(self) -> set[str]:
        return {n for n, want in self.expected.items() if want.action in ("refuse", "needs init", "not recognised")}

    @property
    def good(self) -> list[str]:
        return [name for name, want in self.expected.items() if want.action == "ingest"]

    def run(self, *arguments: object) -> tuple[int, Any]:
        database_url = self.environment["CONETL_DATABASE_URL"]
        home = Path(self.environment["CONETL_HOME"])
        done = conetl_process(home, database_url, *arguments, folder=home.parent, **self.environment)
        assert done.stdout, done.stderr
        assert "\x1b" not in done.stdout + done.stderr
        return done.returncode, json.loads(done.stdout)

    def say(self, *arguments: object) -> Any:
        """What a command that needs a person prints; it runs in this process."""
        here = command_line(Path(self.environment["CONETL_HOME"]), self.environment["CONETL_DATABASE_URL"])
        return json.loads(here(*arguments, "--json", code=1))

    def named(self, path: str, name: str) -> str:
        """An entry as `make_kinds` names it."""
        return name if name.endswith("*.jpg") else path.removeprefix(f"{printable(self.root)}/")


@pytest.mark.usefixtures("prefect_here")
def test_every_entry_ends_as_one_row(tmp_path: Path, database_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "arrivals"
    expected = {printable(name): line for name, line in make_kinds(root, tmp_path / "outside").items()}
    (root / "arriving.zip").touch()
    expected["arriving.zip"] = Expected("not recognised", "an archive", "unzip")
    assert len(expected) >= 40
    environment = {
        "CONETL_HOME": str(tmp_path / "home"), "CONETL_DATABASE_URL": database_url, "CONETL_DRIVE_ROOTS": str(root),
        "CONETL_DROP_FOLDER": str(root), "CONETL_DROP_QUIET_MINUTES": "0", "CONETL_WORKERS": "1",
    }  # fmt: skip
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    office = Office(root, expected, environment)
    shown = planned(office)
    dropped(office, monkeypatch)
    backfilled(office)
    reported(office, shown)
    assert office.say("backfill", root, "--dry-run")["plan"]["to_ingest"] == 0


def planned(office: Office) -> dict[str, str]:
    """The plan has a line for each entry; ids by names."""
    said = office.say("backfill", office.root, "--dry-run")
    lines = {office.named(line["drive"], line["drive_id"]): line for line in said["plan"]["lines"]}
    assert len(lines) == len(said["plan"]["lines"])
    assert lines.keys() == office.expected.keys()
    found = {name: (line["action"], line["why"], line["command"] or "") for name, line in lines.items()}
    wrong = {
        name: (found[name], want)
        for name, want in office.expected.items()
        if found[name][0] != want.action or want.why not in found[name][1] or want.command not in found[name][2]
    }
    assert wrong == {}
    assert {name for name, line in lines.items() if line["needs_attention"]} == office.person
    assert said["plan"]["need_attention"] == len(office.person)
    assert "root:x" not in json.dumps(said)
    return {name: line["drive_id"] for name, line in lines.items()}


def dropped(office: Office, monkeypatch: pytest.MonkeyPatch) -> None:
    """The flow of the drop folder queues each good drive once, and reports each other entry once."""
    queued: list[str] = []
    monkeypatch.setattr(dispatch, "started_with", lambda keys: {key for key in keys if key in queued})
    monkeypatch.setattr(dispatch, "missing_workers", lambda: None)
    monkeypatch.setattr(dispatch, "start_on_worker", lambda *of_drive: queued.append(of_drive[4]))
    true = entries.quiet_since
    monkeypatch.setattr(entries, "quiet_since", lambda p: time.time() + 3600 if p.name == "arriving.zip" else true(p))
    state = ingest_drop_folder(office.root, return_state=True)
    assert (state.type, state.name) == ("FAILED", "NotRecognised")
    assert len(queued) == len(office.good)
    assert "still arriving" in state.message and ": 1; need attention: " in state.message
    initial = sum(want.action == "needs init" for want in office.expected.values())
    assert f"{initial} needs init" in state.message
    again = ingest_drop_folder(office.root, return_state=True)
    assert (again.type, again.name) == ("COMPLETED", "NeedsAttention")
    assert "not recognised" in again.message
    with closing(connect(office.environment["CONETL_DATABASE_URL"])) as conn:
        receipts = execute(conn, "select drive_path, drive_id from conetl.receipt where state = 'failed'")
    told = [office.named(row["drive_path"], row["drive_id"]) for row in receipts]
    assert sorted(told) == sorted(office.person - {"arriving.zip"}), "each once"


def backfilled(office: Office) -> None:
    """A stray changes nothing for the others."""
    code, said = office.run("backfill", office.root, "--here")
    assert code == 2, "damaged drives would fail again"
    states = {office.named(drive["drive_path"], ""): drive["state"] for drive in said["drives"]}
    wanted = {name: "held" if name.endswith("held") else "committed" for name in office.good}
    assert {name: states[name] for name in office.good} == wanted
    strays = {office.named(one["drive_path"], one["drive_id"]) for one in said["not_drives"]}
    assert strays | {name for name, one in states.items() if one == "failed"} == office.person


def reported(office: Office, shown: dict[str, str]) -> None:
    """The report of the night has a row for each but hidden ones and second deliveries."""
    said = office.say("report", "night")
    rows = {row["drive_id"]: row["state"] for row in said["entries"]}
    hidden = {name for name, want in office.expected.items() if want.why == "hidden"}
    assert {name for name in office.expected.keys() - hidden if shown[name] not in rows} == set()
    assert set(rows.values()) == {"committed", "held", "failed", "needs init", "not recognised"}
    assert all(row["reason"] for row in said["entries"] if row["state"] != "committed")
    page = Path(said["written"]).read_text(encoding="utf-8")
    assert "\x1b" not in page and "<img src=x>" not in page
    assert "conetl init" in page and "unzip" in page and "root:x" not in page
