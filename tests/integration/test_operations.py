"""A desk's day with the real things: `conetl up`, workers, a schedule, a backfill, a killed worker.

And what the desk sees of it: Prefect's own pages in Chromium, where there is one.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

from conetl.io.cluster import cluster_remove, cluster_status
from conetl.io.db import connect, execute
from conetl.io.exports import FORMATS
from conetl.io.services import TOKEN, read_services

pytestmark = pytest.mark.xdist_group("operations")
ROOT = Path(__file__).resolve().parents[2]
SAMPLES = sorted((ROOT / "data" / "drives").iterdir())
#: Pairs of a small drive: enough to see cones.
FRAMES = range(14, 18)
POISONED = "2026-04-04_small"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PATIENCE_S = 600


def cut_drive(sample: Path, folder: Path, day: str, *, poisoned: bool = False) -> Path:
    """A few frame pairs of a sample drive, as if recorded on another day; poisoned: without one usable pose."""
    for side in ("image_02", "image_03"):
        (folder / side / "data").mkdir(parents=True)
        for number in FRAMES:
            shutil.copy(sample / side / "data" / f"{number:010d}.jpg", folder / side / "data")
    (folder / "oxts" / "data").mkdir(parents=True)
    for number in FRAMES:
        text = (sample / "oxts" / "data" / f"{number:010d}.txt").read_text()
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text("nan nan" if poisoned else text)
    for name in ("image_02", "image_03", "oxts"):
        stamps = (sample / name / "timestamps.txt").read_text()
        (folder / name / "timestamps.txt").write_text(stamps.replace(stamps[:10], day))
    for path in sample.glob("calib*.txt"):
        shutil.copy(path, folder)
    return folder


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    deadline = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.5)
    return found


@dataclass(frozen=True)
class Desk:
    """One home folder with everything up."""

    home: Path
    environment: dict[str, str]
    port: int
    view_port: int

    def run(self, *arguments: object, code: int | None = 0) -> Any:
        """A command with --json; its output."""
        done = subprocess.run(
            [sys.executable, "-c", "from conetl.cli import main; main()", *map(str, arguments), "--json"],
            env=self.environment, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        assert code is None or done.returncode == code, f"{arguments}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return json.loads(done.stdout) if done.stdout.strip() else None

    def up(self) -> Any:
        return self.run("up", "--port", self.port, "--view-port", self.view_port)

    def post(self, path: str, body: Any) -> Any:
        answer = httpx.post(f"http://127.0.0.1:{self.port}/api{path}", json=body, timeout=60, trust_env=False)
        answer.raise_for_status()
        return answer.json()

    def get(self, path: str) -> Any:
        answer = httpx.get(f"http://127.0.0.1:{self.port}/api{path}", timeout=60, trust_env=False)
        answer.raise_for_status()
        return answer.json()

    def start(self, deployment: str, parameters: dict[str, Any]) -> str:
        """Start a deployment as the form in Prefect's UI does; the run's id."""
        found = self.get(f"/deployments/name/{deployment}")
        return str(self.post(f"/deployments/{found['id']}/create_flow_run", {"parameters": parameters})["id"])

    def ended(self, run_id: str) -> Any:
        def final() -> Any:
            run = self.get(f"/flow_runs/{run_id}")
            return run if run["state_type"] in {"COMPLETED", "FAILED", "CRASHED", "CANCELLED"} else None

        return until(final, f"the end of run {run_id}")

    def rows(self, sql: str) -> list[dict[str, Any]]:
        url = cluster_status(self.home).url
        assert url is not None
        with closing(connect(url)) as conn:
            return execute(conn, sql)

    def receipts(self) -> dict[str, tuple[str, str]]:
        return {r["drive_id"]: (r["state"], r["reason"]) for r in self.rows("select * from conetl.latest_receipt")}

    def kill_service(self, name: str) -> None:
        """What a power cut does to a worker: kill -9, its runs included."""
        service = read_services(self.home)[name]
        mark = f"{TOKEN}={service.token}".encode()
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit() and int(entry.name) != os.getpid():
                try:
                    if mark in (entry / "environ").read_bytes().split(b"\0"):
                        os.kill(int(entry.name), signal.SIGKILL)
                except (OSError, ProcessLookupError):
                    continue


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    home = tmp_path_factory.mktemp("desk") / "home"
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "CONETL_"))}
    environment |= {
        "CONETL_HOME": str(home), "CONETL_DROP_FOLDER": str(home.parent / "arrivals"), "PREFECT_WORKER_QUERY_SECONDS": "1",
    }  # fmt: skip
    found = Desk(home, environment, free_port(), free_port())
    found.up()
    yield found
    found.run("down", code=None)
    cluster_remove(home)


def test_up_again_starts_nothing_and_status_says_what_runs(desk: Desk) -> None:
    before = {name: service.pid for name, service in read_services(desk.home).items()}
    assert set(before) == {"prefect", "view", "desk", "drives-1"}
    again = desk.up()
    assert again["deployments_registered"] is False
    assert {name: service.pid for name, service in read_services(desk.home).items()} == before
    status = desk.run("status")
    assert status["up"] is True
    assert {s["state"] for s in status["services"]} == {"running"}
    names = {d["name"] for d in desk.post("/deployments/filter", {})}
    assert names == {"ingest-drop-folder", "ingest-drive", "backfill", "publish-map", "audit"}


def test_the_form_of_a_deployment_refuses_what_cannot_be(desk: Desk) -> None:
    found = desk.get("/deployments/name/ingest-drive/ingest-drive")
    assert found["enforce_parameter_schema"]
    assert "params" in found["parameter_openapi_schema"]["properties"]
    for wrong in ({"drive": "/d", "map_name": "Not A Name"}, {"drive": "/d", "map_srid": -1}, {"map_name": "a"}):
        with pytest.raises(httpx.HTTPStatusError, match="409"):
            desk.start("ingest-drive/ingest-drive", wrong)


def test_a_complete_drive_in_the_drop_folder_is_taken_once(desk: Desk) -> None:
    arrivals = Path(desk.environment["CONETL_DROP_FOLDER"])
    complete = cut_drive(SAMPLES[0], arrivals / "2026-03-20_dropped", "2026-03-20")
    (complete / "COMPLETE").touch()
    cut_drive(SAMPLES[1], arrivals / "2026-03-21_arriving", "2026-03-21")
    run = desk.ended(desk.start("ingest-drop-folder/ingest-drop-folder", {}))
    assert run["state_type"] == "COMPLETED", run["state"]["message"]
    assert desk.receipts() == {"2026-03-20_dropped": ("committed", "")}
    again = desk.ended(desk.start("ingest-drop-folder/ingest-drop-folder", {}))
    assert again["state_name"] == "NothingNew"
    assert "1 still arriving" in again["state"]["message"]


def test_a_backfill_survives_a_killed_worker_and_a_poisoned_drive(desk: Desk, tmp_path: Path) -> None:
    for number in range(1, 7):
        day = f"2026-04-{number:02d}"
        cut_drive(SAMPLES[number % 3], tmp_path / f"{day}_small", day, poisoned=f"{day}_small" == POISONED)
    run_id = desk.start("backfill/backfill", {"root": str(tmp_path), "max_parallel": 2})
    small = lambda: {name: state for name, state in desk.receipts().items() if name.endswith("_small")}  # noqa: E731
    until(lambda: any(state == "committed" for state, _ in small().values()), "the first drive on the map")
    until(lambda: any(state == "started" for state, _ in small().values()), "a drive in work")
    desk.kill_service("drives-1")
    desk.kill_service("desk")
    assert desk.run("status", code=3)["up"] is False
    until(lambda: _old_enough(desk, run_id), "the grace of a run that just started")
    up = desk.up()
    assert run_id in up["runs_recovered"]
    run = desk.ended(run_id)
    assert run["state_name"] == "SomeFailed", run["state"]["message"]
    receipts = small()
    state, reason = receipts.pop(POISONED)
    assert state == "failed"
    assert "not one usable pose" in reason
    assert sorted(receipts) == [f"2026-04-{n:02d}_small" for n in (1, 2, 3, 5, 6)]
    assert {state for state, _ in receipts.values()} <= {"committed", "known"}
    on_map = desk.rows("select d.drive_id from conetl.changeset c join conetl.drive d using (drive_uuid) order by 1")
    assert [row["drive_id"] for row in on_map] == ["2026-03-20_dropped", *sorted(receipts)]
    kept = [json.loads(p.read_text())["drive_id"] for p in (desk.home / "receipts" / "default").glob("2026-04-*.json")]
    assert sorted(kept) == [f"2026-04-{n:02d}_small" for n in range(1, 7)]
    assert all(audit["row_count"] == 0 for audit in desk.run("db", "audit"))


def _old_enough(desk: Desk, run_id: str) -> bool:
    """Recovery leaves a run alone for its first 30 s."""
    return float(desk.get(f"/flow_runs/{run_id}")["estimated_run_time"]) > 31


def test_every_changeset_is_an_event(desk: Desk) -> None:
    def found() -> list[Any]:
        events = {"filter": {"event": {"prefix": ["conetl.changeset.committed"]}}, "limit": 50}
        return list(desk.post("/events/filter", events)["events"])

    committed = len(desk.rows("select 1 from conetl.changeset"))
    events = until(lambda: found() if len(found()) >= committed else None, "an event of each changeset", 60)
    assert len(events) == committed
    assert {"conetl.added", "conetl.removed", "conetl.map"} <= set(events[0]["resource"])


def test_the_map_is_published_and_audited(desk: Desk) -> None:
    published, audited = desk.start("publish-map/publish-map", {}), desk.start("audit/audit", {})
    assert desk.ended(published)["state_type"] == "COMPLETED"
    assert desk.ended(audited)["state_type"] == "COMPLETED"
    latest = desk.home / "exports" / "latest"
    files = {name: latest / f"default{chosen.suffix}" for name, chosen in FORMATS.items()}
    assert [name for name, path in files.items() if not path.is_file()] == []
    assert json.loads((latest / "publication.json").read_text())["map"] == "default"


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (Debian: apt install chromium)")
def test_the_desk_sees_it_in_prefect(desk: Desk, tmp_path: Path) -> None:
    playwright_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed (extra `dev`)")
    pictures = Path(os.environ.get("CONETL_SCREENSHOTS", tmp_path))
    address = f"http://127.0.0.1:{desk.port}"
    runs = desk.post("/flow_runs/filter", {"sort": "START_TIME_DESC", "limit": 100})
    backfill = next(run for run in runs if run["deployment_id"] and run["name"].startswith("backfill"))
    drive = next(run for run in runs if run["name"].startswith("2026-04-06_small") and run["state_type"] == "COMPLETED")
    assert {"drive:2026-04-06_small", "day:2026-04-06", "map:default"} <= set(drive["tags"])
    with playwright_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-quic"])
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        page.set_default_timeout(120_000)
        for name, path, words in (
            ("runs", "/runs", ["2026-04-06_small (2026-04-06"]),
            ("backfill", f"/runs/flow-run/{backfill['id']}", ["batch-progress", "batch-summary", "6 drives"]),
            (
                "drive",
                f"/runs/flow-run/{drive['id']}",
                ["Plan view of drive", "the pairs whose rays fit worst"],
            ),
            ("deployments", "/deployments", ["ingest-drop-folder", "publish-map"]),
        ):
            page.goto(f"{address}{path}")
            if "/flow-run/" in path:
                page.get_by_text("Artifacts").first.click()
            for word in words:
                page.get_by_text(word).first.wait_for()
            page.wait_for_timeout(500)
            page.screenshot(path=pictures / f"prefect-{name}.png", full_page=True)
        browser.close()
