"""Where drives are worked on, and what is said when nobody is there to do it. Prefect's answers are made up."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import pytest
from prefect.client.schemas.objects import WorkerStatus
from prefect.exceptions import ObjectNotFound
from prefect.states import Crashed, Running

from conetl.model.errors import ServiceError
from flows import artifacts, dispatch, runs
from flows.dispatch import POOL, WORKERS_GONE_S, missing_workers, resolve_where


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A server with the deployment and two workers that take drives; `workers`, `silent_s` and `deployed` may be changed."""
    made = SimpleNamespace(deployed=True, workers=["drives-1", "drives-2", "desk"], silent_s=(0.0,) * 3)

    class Api:
        def read_deployment_by_name(self, name: str) -> Any:
            if not made.deployed:
                raise ObjectNotFound(Exception(name))
            return SimpleNamespace(work_pool_name=POOL)

        def read_workers_for_work_pool(self, pool: str) -> list[Any]:
            beats = [datetime.now(UTC) - timedelta(seconds=silent_s) for silent_s in made.silent_s]
            return [
                SimpleNamespace(name=name, status=WorkerStatus.ONLINE, last_heartbeat_time=beat)
                for name, beat in zip(made.workers, beats, strict=False)
            ]

    @contextmanager
    def client() -> Iterator[Api]:
        yield Api()

    monkeypatch.setattr(dispatch, "client", client)
    return made


def test_drives_go_to_workers_only_where_one_is_online(server: SimpleNamespace) -> None:
    assert resolve_where("auto") == "workers"
    assert resolve_where("here") == "here"
    server.workers = ["desk"]
    assert resolve_where("auto") == "here", "nobody would ever take them"
    assert resolve_where("workers") == "workers", "a person knows that they will come"
    server.deployed = False
    assert resolve_where("auto") == "here"
    with pytest.raises(ServiceError, match="conetl up"):
        resolve_where("workers")


def test_workers_that_are_gone_are_missed_after_a_while(server: SimpleNamespace) -> None:
    """They are restarted, and a heartbeat may be late."""
    assert missing_workers() is None
    fresh_s, gone_s = WORKERS_GONE_S - 10, WORKERS_GONE_S + 10
    for server.silent_s in ((fresh_s, fresh_s, 0.0), (gone_s, fresh_s, 0.0), (fresh_s, gone_s, 0.0)):
        assert missing_workers() is None, "one is enough"
    server.silent_s = gone_s, gone_s, 0.0
    assert "conetl status" in (missing_workers() or "")
    server.workers, server.silent_s = ["desk"], (0.0,)
    assert "conetl status" in (missing_workers() or "")


@pytest.mark.parametrize(("crashes", "again"), [(1, True), (runs.MAX_CRASHES - 1, True), (runs.MAX_CRASHES, False)])
def test_a_dead_run_is_started_again_until_it_crashed_too_often(
    crashes: int, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = Running(timestamp=datetime.now(UTC) - timedelta(hours=1))
    dead = SimpleNamespace(id=uuid4(), state=begun, deployment_id=uuid4(), work_queue_name="default")
    given: list[str] = []
    answers = iter([[dead], []])

    @contextmanager
    def client() -> Iterator[Any]:
        yield SimpleNamespace(
            read_flow_runs=lambda **_: next(answers),
            read_flow_run_states=lambda _: [begun] + [Crashed()] * crashes,
            set_flow_run_state=lambda _, state, **__: given.append(state.type.value),
        )

    monkeypatch.setattr(runs, "client", client)
    monkeypatch.setattr(runs, "held_locks", lambda *_: set())
    assert runs.recover_runs(SimpleNamespace(connection=client)) == [dead]  # type: ignore[arg-type]
    assert given == ["CRASHED"] + ["SCHEDULED"] * again


def test_progress_is_shown_in_percent(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[float] = []
    monkeypatch.setattr(artifacts.artifacts, "create_progress_artifact", lambda *_, **__: uuid4())
    monkeypatch.setattr(artifacts.artifacts, "update_progress_artifact", lambda _, share: told.append(share))
    monkeypatch.setattr(artifacts, "_SHOWN_EVERY_S", 0.0)
    show = artifacts.progress_artifact("drive")
    for done in (0, 3, 4):
        show(done, 4)
    assert told == [75.0, 100.0]
