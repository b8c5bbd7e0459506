"""Where drives are worked on, and what is said when nobody is there to do it. Prefect's answers are made up."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from prefect.client.schemas.objects import WorkerStatus
from prefect.exceptions import ObjectNotFound

from conetl.model.errors import ServiceError
from flows import dispatch
from flows.dispatch import WORKERS_GONE_S, WorkerWatch, resolve_where


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A server with the deployment and two workers that take drives; `workers` and `deployed` may be changed."""
    made = SimpleNamespace(deployed=True, workers=["drives-1", "drives-2", "desk"])

    class Api:
        def read_deployment_by_name(self, name: str) -> None:
            if not made.deployed:
                raise ObjectNotFound(Exception(name))

        def read_workers_for_work_pool(self, pool: str) -> list[Any]:
            return [SimpleNamespace(name=name, status=WorkerStatus.ONLINE) for name in made.workers]

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


def test_workers_that_are_gone_are_told_once_and_name_what_to_do(server: SimpleNamespace) -> None:
    watch = WorkerWatch()
    assert watch.complaint(0.0) is None
    server.workers = ["desk"]
    assert watch.complaint(40.0) is None, "they may be starting"
    assert watch.complaint(30.0 + WORKERS_GONE_S) is None
    said = watch.complaint(75.0 + WORKERS_GONE_S)
    assert said is not None
    assert "conetl status" in said
    assert watch.complaint(1000.0 + WORKERS_GONE_S) is None, "told once"


def test_workers_that_come_back_are_not_missed(server: SimpleNamespace) -> None:
    watch = WorkerWatch()
    server.workers = []
    assert watch.complaint(0.0) is None
    server.workers = ["drives-1"]
    assert watch.complaint(40.0) is None
    server.workers = []
    assert watch.complaint(80.0) is None
    assert watch.complaint(75.0 + WORKERS_GONE_S) is None, "since 80, not since 0"
