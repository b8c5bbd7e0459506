"""A desk's day with the real things: `conetl up`, workers, a schedule, a backfill, a killed worker.

And what the desk sees of it, Prefect's own pages in Chromium where there is one, and what strangers do not see.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any

import httpx
import psutil
import pytest

from conetl.db.cluster.cluster import cluster_status
from conetl.db.connection import connect, execute
from conetl.exports import FORMATS
from conetl.files.home import VIEW_TOKEN
from conetl.services.processes import TOKEN, read_services
from tests import command
from tests.chromium import CHROMIUM, HTML_NAME, chromium, nothing_of_html_happens
from tests.clusters import remove_cluster
from tests.command import conetl, free_port
from tests.integration.small_drives import SAMPLES, cut_drive, processes_with
from tests.integration.strangers import (
    AUTH,
    WORD,
    arguments_with,
    files_with,
    nobody_reads,
    pages_of_other_origins_learn_nothing,
    prefect_refuses_strangers,
    view_refuses_strangers,
)

#: Loopback, but none of the addresses that need no password.
HOST = "127.0.0.2"
#: Of the drives of a backfill, as a stranger might name them: a picture or a link where a page takes it for HTML or Markdown.
SMALL = f"_small {HTML_NAME}`](elsewhere)**"
#: The last one, so that it fails once: what failed is tried again when the backfill is taken up.
POISONED = f"2026-04-02{SMALL}"
#: Longer than any drive takes here.
until = partial(command.until, patience_s=600, every_s=1.0)
DROP_FOLDER = "ingest-drop-folder/ingest-drop-folder"
RECOVER = "recover/recover"


@dataclass(frozen=True)
class Desk:
    """One home folder with everything up."""

    home: Path
    environment: dict[str, str]
    port: int
    view_port: int
    api: httpx.Client

    def run(self, *arguments: object, code: int | None = 0) -> Any:
        """A command with --json; its output."""
        done = conetl(*arguments, "--json", **self.environment)
        assert code is None or done.returncode == code, f"{arguments}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return json.loads(done.stdout) if done.stdout.strip() else None

    def up(self) -> Any:
        return self.run("up", "--workers", 2, "--host", HOST, "--port", self.port, "--view-port", self.view_port)

    def post(self, path: str, body: Any) -> Any:
        answer = self.api.post(path, json=body)
        answer.raise_for_status()
        return answer.json()

    def get(self, path: str) -> Any:
        answer = self.api.get(path)
        answer.raise_for_status()
        return answer.json()

    def pause(self, deployment: str) -> None:
        """Pause a deployment's schedules as the switch in Prefect's UI does."""
        found = self.get(f"/deployments/name/{deployment}")
        self.api.patch(f"/deployments/{found['id']}", json={"paused": True}).raise_for_status()

    def automations(self) -> list[Any]:
        return list(self.post("/automations/filter", {}))

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

    def processes_of(self, service: str) -> set[int]:
        return processes_with(TOKEN, read_services(self.home)[service].token)

    def kill_service(self, name: str) -> None:
        """What a power cut does to a worker: kill -9, its runs included. Waits until they are gone, and their ports free."""
        killed = self.processes_of(name)
        for pid in killed:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        until(lambda: not any(map(psutil.pid_exists, killed)), f"the end of {name}")

    def kill_postgresql(self) -> None:
        """The cluster of this home: its first process, then those that it started."""
        first = cluster_status(self.home).pid
        assert first is not None
        children = Path(f"/proc/{first}/task/{first}/children").read_text().split()
        for pid in (first, *map(int, children)):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def desk(services_home: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    home, scratch = services_home, services_home / "tmp"
    scratch.mkdir(parents=True)
    environment = {
        "CONETL_HOME": str(home), "CONETL_DROP_FOLDER": str(tmp_path_factory.mktemp("arrivals")),
        "CONETL_DRIVE_ROOTS": tempfile.gettempdir(), "PREFECT_SERVER_API_AUTH_STRING": AUTH, "PREFECT_WORKER_QUERY_SECONDS": "2",
        "CONETL_DROP_QUIET_MINUTES": "1000",  # a busy machine needs more than the usual 10 for this file
        "TMPDIR": str(scratch),  # a run that is killed leaves its working folder
    }  # fmt: skip
    port = free_port(HOST)
    api = httpx.Client(
        base_url=f"http://{HOST}:{port}/api", timeout=60, trust_env=False, auth=httpx.BasicAuth(*AUTH.split(":"))
    )
    found = Desk(home, environment, port, free_port(), api)
    try:
        assert found.up()["deployments_registered"]
        # The real schedule might fire in between, and take the drive or the only place from the test's own run.
        found.pause(DROP_FOLDER)
        found.pause(RECOVER)
        yield found
    finally:
        api.close()
        found.run("down", code=None)
        remove_cluster(home)
        left = processes_with("CONETL_HOME", home)
        shutil.rmtree(home)
    assert left == set()


def test_a_complete_drive_in_the_drop_folder_is_taken_although_the_server_restarts(desk: Desk) -> None:
    assert {d["name"] for d in desk.post("/deployments/filter", {})} == {
        "ingest-drop-folder", "ingest-drive", "backfill", "publish-map", "audit", "recover",
    }  # fmt: skip
    arrivals = Path(desk.environment["CONETL_DROP_FOLDER"])
    complete = cut_drive(SAMPLES[0], arrivals / "2026-03-20_dropped", "2026-03-20")
    (complete / "COMPLETE").touch()
    cut_drive(SAMPLES[1], arrivals / "2026-03-21_arriving", "2026-03-21")
    run = desk.ended(desk.start(DROP_FOLDER, {}))
    assert run["state_type"] == "COMPLETED", run["state"]["message"]
    until(lambda: worker_at_work(desk), "a drive in work")
    desk.kill_service("prefect")
    assert desk.up()["up"]
    (drive,) = desk.post("/flow_runs/filter", {"flows": {"name": {"any_": ["ingest-drive"]}}})
    drive = desk.ended(drive["id"])
    assert (drive["state_type"], drive["run_count"]) == ("COMPLETED", 1), (
        "nothing crashes when only the server restarts"
    )
    assert desk.receipts() == {"2026-03-20_dropped": ("committed", "")}
    nothing_starts_without_the_password(desk, arrivals)
    strangers_learn_nothing(desk)


def test_the_schedules_of_prefect_yaml_come_to_pass(desk: Desk) -> None:
    """Prefect's scheduler makes runs ahead. With another SQLAlchemy it failed at every look, and told nobody."""
    wanted = {
        "deployments": {"name": {"any_": ["publish-map"]}},
        "flow_runs": {"state": {"type": {"any_": ["SCHEDULED"]}}},
    }
    deadline = time.monotonic() + 180
    while not (runs := desk.post("/flow_runs/filter", wanted)):
        log = (desk.home / "logs" / "prefect.log").read_text()
        assert time.monotonic() < deadline, f"no run of the schedule was made:\n{log[-3000:]}"
        time.sleep(1)
    assert all(run["auto_scheduled"] for run in runs)


@pytest.mark.release
def test_a_backfill_survives_a_killed_worker_and_a_poisoned_drive(desk: Desk, tmp_path: Path) -> None:
    for number in (1, 2):
        day = f"2026-04-{number:02d}"
        cut_drive(SAMPLES[number % 3], tmp_path / f"{day}{SMALL}", day, poisoned=f"{day}{SMALL}" == POISONED)
    run_id = desk.start("backfill/backfill", {"root": str(tmp_path), "max_parallel": 2})
    small = lambda: {name: state for name, state in desk.receipts().items() if name.endswith(SMALL)}  # noqa: E731
    busy = until(lambda: worker_at_work(desk), "a drive in work")
    before = {name: service.pid for name, service in read_services(desk.home).items()}
    assert set(before) == {"prefect", "view", "desk", "drives-1", "drives-2"}
    desk.kill_service(busy)
    desk.kill_service("desk")
    status = without_the_password(desk).run("status", code=3)
    assert {s["name"] for s in status["services"] if s["state"] == "ended"} == {busy, "desk"}
    # Recovery leaves a run alone for its first 30 s.
    until(lambda: _old_enough(desk, run_id), "the grace of a run that just started")
    up = desk.up()
    assert up["up"]
    assert run_id in up["runs_recovered"]
    assert not up["deployments_registered"]
    assert desk.get(f"/deployments/name/{DROP_FOLDER}")["paused"], "what a person set stays"
    after = {name: service.pid for name, service in read_services(desk.home).items()}
    assert {name for name, pid in after.items() if pid != before[name]} == {busy, "desk"}
    run = desk.ended(run_id)
    assert (run["state_type"], run["state_name"]) == ("FAILED", "SomeFailed"), run["state"]["message"]
    receipts = small()
    state, reason = receipts.pop(POISONED)
    assert state == "failed"
    assert "no usable pose" in reason
    assert receipts.keys() == {f"2026-04-01{SMALL}"} and next(iter(receipts.values()))[0] in ("committed", "known")
    on_map = desk.rows("select d.drive_id from conetl.changeset c join conetl.drive d using (drive_uuid) order by 1")
    assert [row["drive_id"] for row in on_map] == ["2026-03-20_dropped", *sorted(receipts)]
    queues = {queue["name"]: queue["priority"] for queue in desk.post("/work_pools/conetl/queues/filter", {})}
    assert queues["drives"] < queues["backfill"], "the drop folder's drives come first"
    of_flow = {"flows": {"name": {"any_": ["ingest-drive"]}}}
    by_queue = {(run["work_queue_name"], SMALL in run["name"]) for run in desk.post("/flow_runs/filter", of_flow)}
    assert by_queue == {("drives", False), ("backfill", True)}
    assert desk.rows("select count(*) as cones from conetl.feature_version")[0]["cones"] > 0
    tasks = desk.post("/task_runs/filter", {"task_runs": {"name": {"like_": "detect"}}})
    assert tasks and not any(task["tags"] for task in tasks), "each tag of a task costs a request before it begins"
    assert all(re.search(r"^detect .+ \d+ to \d+, part \d$", task["name"]) for task in tasks), tasks[0]["name"]
    kept = [json.loads(p.read_text())["drive_id"] for p in (desk.home / "receipts" / "default").glob("2026-04-*.json")]
    assert sorted(kept) == [f"2026-04-{n:02d}{SMALL}" for n in (1, 2)]


@pytest.mark.release
def test_a_run_that_prefect_says_crashed_is_started_again(desk: Desk, tmp_path: Path) -> None:
    """Prefect crashes a run whose lease it lost, and never starts it again."""
    shutil.copytree(
        Path(desk.environment["CONETL_DROP_FOLDER"]) / "2026-03-20_dropped", tmp_path / "2026-03-20_dropped"
    )
    backfill = desk.get("/deployments/name/backfill/backfill")
    crashed = {"parameters": {"root": str(tmp_path)}, "state": {"type": "CRASHED", "message": "lease not found"}}
    run_id = str(desk.post(f"/deployments/{backfill['id']}/create_flow_run", crashed)["id"])

    def is_taken_up() -> bool:
        assert desk.ended(desk.start(RECOVER, {}))["state_type"] == "COMPLETED"
        return bool(desk.get(f"/flow_runs/{run_id}")["state_type"] != "CRASHED")

    until(is_taken_up, "a second start of the crashed run")
    assert desk.ended(run_id)["state_name"] == "NothingNew"


@pytest.mark.release
def test_a_drive_whose_worker_died_with_everything_is_started_again_by_the_schedules(desk: Desk) -> None:
    name = "2026-06-02_dropped"
    (cut_drive(SAMPLES[0], Path(desk.environment["CONETL_DROP_FOLDER"]) / name, name[:10]) / "COMPLETE").touch()
    assert desk.ended(desk.start(DROP_FOLDER, {}))["state"]["message"].startswith("queued: 1;")
    busy = until(lambda: worker_at_work(desk), "a drive in work")
    for service in ("prefect", "desk", busy):
        desk.kill_service(service)
    assert desk.up()["up"]
    of_drive = {"flows": {"name": {"any_": ["ingest-drive"]}}, "flow_runs": {"name": {"like_": name}}}
    [run] = desk.post("/flow_runs/filter", of_drive)
    until(lambda: _old_enough(desk, run["id"]), "the grace of a run that just started")

    def is_started_again() -> bool:
        for deployment in (RECOVER, DROP_FOLDER):
            desk.ended(desk.start(deployment, {}))
        return bool(desk.get(f"/flow_runs/{run['id']}")["run_count"] > 1)

    until(is_started_again, f"a second start of drive {name}")
    run = desk.ended(run["id"])
    assert (run["state_type"], run["run_count"]) == ("COMPLETED", 2), run
    assert desk.receipts()[name][0] in ("committed", "known")


def worker_at_work(desk: Desk) -> str | None:
    """A worker that has a drive in work, by its receipt and its process."""
    for row in desk.rows("select flow_run_id from conetl.latest_receipt where state = 'started'"):
        pids = processes_with("PREFECT__FLOW_RUN_ID", row["flow_run_id"])
        for name in ("drives-1", "drives-2"):
            if pids & desk.processes_of(name):
                return name
    return None


def without_the_password(desk: Desk) -> Desk:
    others = {name: value for name, value in desk.environment.items() if name != "PREFECT_SERVER_API_AUTH_STRING"}
    return replace(desk, environment=others)


def nothing_starts_without_the_password(desk: Desk, drives: Path) -> None:
    """Commands without it, or with another one, name the variable and end."""
    others = without_the_password(desk).environment
    guessed = others | {"PREFECT_SERVER_API_AUTH_STRING": "desk:guessed"}
    up = ("up", "--host", HOST, "--port", desk.port, "--view-port", desk.view_port)
    for environment, words in ((guessed, ("backfill", drives)), (others, up)):
        refused = conetl(*words, "--json", **environment)
        assert refused.returncode == 3, (words, refused.stdout, refused.stderr)
        assert "set PREFECT_SERVER_API_AUTH_STRING" in refused.stderr
        assert "Traceback" not in refused.stderr


def strangers_learn_nothing(desk: Desk) -> None:
    api, view = f"http://{HOST}:{desk.port}/api", f"http://127.0.0.1:{desk.view_port}"
    assert arguments_with(WORD) == []
    prefect_refuses_strangers(api)
    view_refuses_strangers(view, (desk.home / VIEW_TOKEN).read_text().strip())
    if CHROMIUM:
        pages_of_other_origins_learn_nothing(f"{api}/deployments/filter", f"{view}/api/maps")


def _old_enough(desk: Desk, run_id: str) -> bool:
    return float(desk.get(f"/flow_runs/{run_id}")["estimated_run_time"]) > 31


@pytest.mark.release
def test_a_backfill_without_postgresql_ends_with_code_3_and_goes_on_later(desk: Desk, tmp_path: Path) -> None:
    """PostgreSQL is killed while a worker has a drive, so Prefect loses its database as well."""
    cut_drive(SAMPLES[1], tmp_path / "2026-05-01_cut", "2026-05-01")
    command = ("backfill", tmp_path, "--max-parallel", "1", "--json")
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(conetl, *command, **desk.environment)
        until(lambda: "2026-05-01_cut" in desk.receipts() or running.done(), "a drive in work")
        desk.kill_postgresql()
        done = running.result()
    desk.up()
    assert done.returncode == 3, f"{done.returncode}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    assert "PostgreSQL" in done.stderr.partition("conetl: ")[2], done.stderr
    found = desk.run(*command[:-1])
    assert {drive["state"] for drive in found["drives"]} <= {"committed", "known"}
    on_map = desk.rows("select d.drive_id from conetl.changeset c join conetl.drive d using (drive_uuid) order by 1")
    assert "2026-05-01_cut" in {row["drive_id"] for row in on_map}


@pytest.mark.release
def test_the_map_is_published_and_audited_and_no_drive_is_taken_again(desk: Desk) -> None:
    started = {name: desk.start(name, {}) for name in ("publish-map/publish-map", "audit/audit", DROP_FOLDER)}
    ended = {name: desk.ended(run_id) for name, run_id in started.items()}
    messages = {name: run["state"]["message"] for name, run in ended.items()}
    assert ended["audit/audit"]["state_type"] == ended[DROP_FOLDER]["state_type"] == "COMPLETED", messages
    published = ended["publish-map/publish-map"]
    assert (published["state_type"], published["state_name"]) == ("FAILED", "DrivesFailed"), messages
    assert POISONED in messages["publish-map/publish-map"], "what failed on an earlier night is still said"
    latest = desk.home / "exports" / "latest"
    files = {name: latest / f"default{chosen.suffix}" for name, chosen in FORMATS.items()}
    assert [name for name, path in files.items() if not path.is_file()] == []
    assert json.loads((latest / "publication.json").read_text())["map"] == "default"
    assert ended[DROP_FOLDER]["state_name"] == "NothingNew"
    assert ended[DROP_FOLDER]["state"]["message"].endswith(": 1")


def test_every_changeset_is_an_event(desk: Desk) -> None:
    def found() -> list[Any]:
        events = {"filter": {"event": {"prefix": ["conetl.changeset.committed"]}}, "limit": 50}
        return list(desk.post("/events/filter", events)["events"])

    committed = len(desk.rows("select 1 from conetl.changeset"))
    events = until(lambda: found() if len(found()) >= committed else None, "an event of each changeset")
    assert len(events) == committed
    assert {"conetl.added", "conetl.removed", "conetl.map"} <= set(events[0]["resource"])


@pytest.mark.release
def test_a_folder_that_is_no_drive_notifies_a_person_once(desk: Desk) -> None:
    """The drop folder's run fails, and Prefect sends what the automation says with the block of the operator."""
    told: SimpleQueue[dict[str, Any]] = SimpleQueue()
    with webhook(told) as url:
        kind = desk.get("/block_types/slug/custom-webhook")
        schema = desk.post("/block_schemas/filter", {"block_schemas": {"block_type_id": {"any_": [kind["id"]]}}})[0]
        message = {"subject": "{{subject}}", "body": "{{body}}"}
        data = {"name": "operations", "url": url, "method": "POST", "json_data": message}
        block = {"name": "operations", "data": data, "block_type_id": kind["id"], "block_schema_id": schema["id"]}
        desk.post("/block_documents/", block)
        paused = next(one for one in desk.automations() if one["name"].endswith("crashed"))
        desk.api.patch(f"/automations/{paused['id']}", json={"enabled": False}).raise_for_status()
        with_block = replace(
            desk, environment=desk.environment | {"CONETL_NOTIFICATION_BLOCK": "custom-webhook/operations"}
        )
        assert with_block.up()["deployments_registered"]
        automations = desk.automations()
        assert {one["actions"][0]["type"] for one in automations} == {"send-notification"}
        assert [one["name"] for one in automations if not one["enabled"]] == [paused["name"]], (
            "what a person paused stays"
        )
        folder = Path(desk.environment["CONETL_DROP_FOLDER"]) / f"half{HTML_NAME}"
        shutil.copytree(SAMPLES[0], folder)
        (folder / "drive.yaml").write_text("rigg: rig.yaml\n")
        (folder / "COMPLETE").touch()
        runs = [desk.ended(desk.start(DROP_FOLDER, {})) for _ in range(2)]
        # A scheduled run may have been the first to find it.
        assert runs[0]["state_name"] in ("NotRecognised", "NeedsAttention"), runs[0]["state"]["message"]
        assert runs[1]["state_name"] == "NeedsAttention", runs[1]["state"]["message"]
        heard = [told.get(timeout=60), told.get(timeout=60)]
    by_subject = {one["subject"]: one["body"] for one in heard}
    assert set(by_subject) == {"conetl: a folder was not recognised", "conetl: a run failed"}
    assert all("rigg" in body for body in by_subject.values()), by_subject
    assert told.empty()


@contextmanager
def webhook(told: SimpleQueue[dict[str, Any]]) -> Iterator[str]:
    """A server that receives notifications; its address."""

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            told.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.end_headers()

    with ThreadingHTTPServer(("127.0.0.1", 0), Receiver) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.release
def test_the_desk_sees_it_in_prefect(desk: Desk) -> None:
    images = os.environ.get("CONETL_SCREENSHOTS")
    runs = desk.post("/flow_runs/filter", {"sort": "START_TIME_DESC", "limit": 100})
    backfill = next(run for run in runs if run["deployment_id"] and run["state_name"] == "SomeFailed")
    on_map = desk.rows(
        "select * from conetl.receipt where state = 'committed' and drive_id like '2026-04%' order by at"
    )
    drive = desk.get(f"/flow_runs/{on_map[-1]['flow_run_id']}")
    day = on_map[-1]["drive_id"].removesuffix(SMALL)
    assert drive["name"].startswith(f"{day}{SMALL} ({day} ")
    assert {f"drive:{day}{SMALL}", f"day:{day}", "map:default"} <= set(drive["tags"])
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        page.set_default_timeout(120_000)
        page.goto(f"http://{HOST}:{desk.port}")
        page.locator("input").fill(AUTH)
        page.keyboard.press("Enter")
        page.get_by_text("Flow Runs").first.wait_for()
        for name, run, words in (
            ("backfill", backfill, ["batch-progress"]),
            ("drive", drive, ["Plan view of drive", "frame pairs with the largest residuals"]),
        ):
            go_to(page, f"/runs/flow-run/{run['id']}", run["name"])
            page.get_by_text("Artifacts").first.click()
            for word in words:
                page.get_by_text(word).first.wait_for()
            if images:
                page.screenshot(path=f"{images}/prefect-{name}.png", full_page=True)
            for artifact in desk.post("/artifacts/filter", {"artifacts": {"flow_run_id": {"any_": [run["id"]]}}}):
                if artifact["key"] in ("summary", "plan-view", "qa-report"):
                    with nothing_of_html_happens(page):
                        go_to(page, f"/artifacts/artifact/{artifact['id']}", artifact["key"])
                        page.get_by_text(HTML_NAME).first.wait_for()
                        if images:
                            page.screenshot(path=f"{images}/prefect-{name}-{artifact['key']}.png", full_page=True)
                    assert page.locator("a[href$=elsewhere]").count() == 0


def go_to(page: Any, path: str, title: str) -> None:
    """Another page of Prefect's, as a link there shows it: without loading everything again."""
    page.evaluate("path => { history.pushState({}, '', path); dispatchEvent(new PopStateEvent('popstate')) }", path)
    page.wait_for_function("title => document.title.includes(title)", arg=title)


def test_a_given_password_is_written_nowhere_and_nobody_else_reads_the_home(desk: Desk) -> None:
    """Last, since it stops the services: what was still in memory is on disk then, Prefect's database included."""
    assert arguments_with(WORD) == []
    nobody_reads(desk.home)
    desk.run("down")
    # Prefect's worker hands a run its environment in a file in TMPDIR, which a worker that is killed leaves there.
    assert {path.name for path in files_with(desk.home, WORD)} <= {"workspace.json"}
