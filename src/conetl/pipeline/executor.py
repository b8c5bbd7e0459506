"""Running the steps of an analysis, in the caller's thread or beside it, and measuring their time."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Protocol, TypeVar

from conetl.db.receipt_store import StepTime

F = TypeVar("F", bound=Callable[..., Any])
#: Called with the number of images and motions that are done, and of all of them.
Progress = Callable[[int, int], None]
#: Called with the number of images and motions that were done since the last call.
Tick = Callable[[int], None]


@dataclass(frozen=True)
class StepName:
    """What a step is called in reports and in Prefect."""

    step: str
    run: str
    """Of one run of it, with its arguments: "detect {chunk.frames}"."""


def step(name: str, run_name: str | None = None) -> Callable[[F], F]:
    """Mark a function as a step of the workflow. A step that Prefect runs is a task; flows/tasks.py has its retries and cache."""

    def mark(function: F) -> F:
        function.__dict__["step_name"] = StepName(name, run_name or name)
        return function

    return mark


def name_of(function: Callable[..., Any]) -> StepName:
    """The name of a step. Raises TypeError for a function that is not marked as one."""
    name = function.__dict__.get("step_name")
    if not isinstance(name, StepName):
        raise TypeError(f"{function.__qualname__} is not marked as a step")
    return name


class Submitted(Protocol):
    """A step that runs in parallel to the caller."""

    def result(self) -> Any: ...
    def add_done_callback(self, fn: Callable[[Any], Any]) -> None: ...


class Executor(Protocol):
    """Runs steps: functions that are marked by `step`. Results of `submit` may be used as arguments."""

    shares_memory: bool
    """Whether submitted steps run in this process, where they can call back."""

    def run(self, step: Callable[..., Any], *arguments: Any) -> Any:
        """Run a step in the caller's thread and return its result."""

    def submit(self, step: Callable[..., Any], *arguments: Any) -> Submitted:
        """Run a step in parallel to the caller."""

    def times(self) -> list[StepTime]:
        """The finished steps, in the order in which they began."""


class StepClock:
    """Begin and end of every step of one run."""

    def __init__(self) -> None:
        self._spans: list[tuple[str, datetime, datetime]] = []

    def note(self, step: str, began: datetime, ended: datetime) -> None:
        self._spans.append((step, began, ended))

    def times(self) -> list[StepTime]:
        """The finished steps, in the order in which they began."""
        spans: dict[str, list[tuple[float, float]]] = defaultdict(list)
        zero = min((began for _, began, _ in self._spans), default=datetime.now(UTC))
        for step, began, ended in self._spans:
            spans[step].append(((began - zero).total_seconds(), (ended - zero).total_seconds()))
        found = [
            StepTime(
                step, len(parts), sum(max(end - start, 0.0) for start, end in parts),
                min(start for start, _ in parts), max(end for _, end in parts),
            )
            for step, parts in spans.items()
        ]  # fmt: skip
        return sorted(found, key=lambda time: time.started_s)


class ThreadExecutor(StepClock):
    """Steps as plain calls; submitted ones run on a pool of threads. No server, no other process."""

    shares_memory = True

    def __init__(self, workers: int) -> None:
        super().__init__()
        self._pool = ThreadPoolExecutor(workers)

    def __enter__(self) -> ThreadExecutor:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        self._pool.shutdown(cancel_futures=error is not None)

    def run(self, step: Callable[..., Any], *arguments: Any) -> Any:
        name, given = name_of(step), [arg.result() if isinstance(arg, Future) else arg for arg in arguments]
        began = datetime.now(UTC)
        result = step(*given)
        self.note(name.step, began, datetime.now(UTC))
        return result

    def submit(self, step: Callable[..., Any], *arguments: Any) -> Future[Any]:
        # What a step waits for was submitted before it, so a pool of any size makes progress.
        return self._pool.submit(self.run, step, *arguments)


class ProgressCount:
    """Counts finished images and motions of one drive, from any thread, and calls `progress` one call at a time."""

    def __init__(self, executor: Executor, total: int, progress: Progress | None) -> None:
        self._total, self._done = total, 0
        self._progress = progress or (lambda *_: None)
        self._lock = threading.Lock()
        self.tick: Tick = self.add if executor.shares_memory else no_tick
        """For steps to call as they go on; steps in other processes are counted when they are done."""
        self.add(0)

    def add(self, count: int) -> None:
        with self._lock:
            self._done += count
            self._progress(self._done, self._total)

    def follow(self, step: Submitted, count: int) -> None:
        """Count a step of another process when it is done."""
        if self.tick is no_tick:
            step.add_done_callback(lambda _: self.add(count))


def no_tick(_: int) -> None:
    """A tick that counts nothing."""


def results(steps: Sequence[Submitted]) -> list[Any]:
    """Results of submitted steps, in order."""
    return [step.result() for step in steps]
