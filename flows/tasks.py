"""The steps of the pipeline as Prefect tasks, on threads, processes or a Dask cluster. The results are the same."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from typing import Any
from uuid import uuid4

from prefect import State, Task, task
from prefect.cache_policies import NO_CACHE
from prefect.context import FlowRunContext
from prefect.futures import PrefectFuture
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from conetl.db.receipt_store import StepTime
from conetl.model.errors import InputError, is_storage_error
from conetl.pipeline.executor import StepClock, name_of
from conetl.pipeline.settings import Settings

#: How often Dask profiles itself. By default it samples every worker's stack 100 times a second, and a worker that only waits
#: takes 3.4 % of a core; with these settings 0.7 %.
DASK_CONFIG = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
}


class PrefectExecutor:
    """Runs steps as tasks of the present flow run, with retries.

    Prefect draws an edge where a task is given another one's future, which sealed arguments hide: each task waits for those that
    the workflow waited for before it.
    """

    def __init__(self) -> None:
        context = FlowRunContext.get()
        runner = context and context.task_runner
        self.shares_memory = isinstance(runner, ThreadPoolTaskRunner)
        # Prefect's process pool waits for futures only, not for states.
        self._has_edges = not isinstance(runner, ProcessPoolTaskRunner)
        self._clock = StepClock()
        self._tasks: dict[Callable[..., Any], Task[..., Any]] = {}
        self._before: list[State[Any]] = []
        self._beside: list[PrefectFuture[Any]] = []
        """Submitted since the last step in the caller's thread."""

    def run(self, step: Callable[..., Any], *arguments: Any) -> Any:
        state: Any = self._task(step)(
            *map(_sealed, arguments), wait_for=[*self._before, *self._beside], return_state=True
        )
        result = state.result()
        # Without the result, which would be sent along with each task; Prefect fails where there is no data.
        self._before, self._beside = [state.model_copy(update={"data": "done"})], []
        return result

    def submit(self, step: Callable[..., Any], *arguments: Any) -> PrefectFuture[Any]:
        before = self._before if self._has_edges else []
        self._beside.append(self._task(step).submit(*map(_sealed, arguments), wait_for=before))
        return self._beside[-1]

    def times(self) -> list[StepTime]:
        """Steps that ran in processes of their own are missing: their clock is a copy."""
        return self._clock.times()

    def _task(self, step: Callable[..., Any]) -> Task[..., Any]:
        if step not in self._tasks:
            name = name_of(step)
            self._tasks[step] = task(
                _unsealing(step), name=name.step, task_run_name=partial(_run_name, name.run), retries=2,
                retry_delay_seconds=[1, 5], retry_condition_fn=_may_pass, on_completion=[partial(_note, self._clock)],
                cache_policy=NO_CACHE,  # results are kept by content in Parquet files, see files/parquet_store.py
            )  # fmt: skip
        return self._tasks[step]


class _Sealed:
    """An argument that Prefect does not search for futures and states: with the records of a drive that takes seconds per task.

    Prefect's own `quote` does the same for threads, but Dask's runner searches it all the same, and pickling wraps it twice.
    """

    def __init__(self, value: Any) -> None:
        self.value = value

    def __dask_tokenize__(self) -> str:
        return uuid4().hex  # Dask must not take two tasks for one


def _sealed(argument: Any) -> Any:
    return argument if isinstance(argument, PrefectFuture) else _Sealed(argument)


def _opened(argument: Any) -> Any:
    return argument.value if isinstance(argument, _Sealed) else argument


def _unsealing(step: Callable[..., Any]) -> Callable[..., Any]:
    """The step for sealed arguments, and for results of other tasks, which are not."""

    @wraps(step)
    def unsealed(*arguments: Any, **named: Any) -> Any:
        return step(*map(_opened, arguments), **{name: _opened(each) for name, each in named.items()})

    return unsealed


def _run_name(template: str, parameters: dict[str, Any]) -> str:
    return template.format(**{name: _opened(each) for name, each in parameters.items()})


def _may_pass(_task: Any, _run: Any, state: Any) -> bool:
    """Errors of disk, network and database may be temporary; errors of the input are not."""
    try:
        state.result()
    except InputError as error:
        return is_storage_error(error.__cause__)
    except Exception:
        return True
    return False


def _note(clock: StepClock, step: Any, run: Any, _state: Any) -> None:
    """Prefect calls this when a task has completed."""
    if run.start_time is not None and run.end_time is not None:
        clock.note(step.name, run.start_time, run.end_time)


def task_runner(settings: Settings) -> TaskRunner[Any]:
    """What CONETL_TASK_RUNNER names, not yet started. Raises InputError where it is unavailable.

    Threads or processes: `workers` of them. Dask: the cluster at CONETL_DASK_ADDRESS, else `workers` processes of this machine
    for the time of one run, on loopback only.
    """
    if settings.dask_address and settings.task_runner != "dask":
        raise InputError(
            f"CONETL_DASK_ADDRESS is {settings.dask_address}, but CONETL_TASK_RUNNER is {settings.task_runner}: set it to "
            "dask, or remove the address"
        )
    match settings.task_runner:
        case "threads":
            return ThreadPoolTaskRunner(max_workers=settings.workers)
        case "processes":
            return ProcessPoolTaskRunner(max_workers=settings.workers)
        case "dask":
            return _dask(settings)


def _dask(settings: Settings) -> TaskRunner[Any]:
    try:
        import dask.config
        from prefect_dask.task_runners import DaskTaskRunner
    except ImportError as error:
        raise InputError("CONETL_TASK_RUNNER is dask, which is not installed: pip install 'conetl[dask]'") from error
    if settings.dask_address:
        return DaskTaskRunner(address=settings.dask_address)
    dask.config.set(DASK_CONFIG)
    here = {
        "n_workers": settings.workers,
        "threads_per_worker": 1,
        "host": "127.0.0.1",
        "dashboard_address": "127.0.0.1:0",
    }
    return DaskTaskRunner(cluster_class="distributed.LocalCluster", cluster_kwargs=here)
