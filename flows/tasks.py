"""The steps of the pipeline as Prefect tasks, on threads, processes or a Dask cluster. The results are the same."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from typing import Any
from uuid import uuid4

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.context import FlowRunContext
from prefect.futures import PrefectFuture
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from conetl.db.receipt_store import StepTime
from conetl.model.errors import InputError, is_storage_error
from conetl.pipeline import analysis, commit, detect, ingest, markings, odometry
from conetl.pipeline.executor import StepClock
from conetl.pipeline.settings import Settings
from conetl.tracking import standing
from flows import artifacts

#: Name of each step's task, and of its runs; the arguments are sealed.
_NAMES: dict[Callable[..., Any], tuple[str, str | None]] = {
    ingest.read: ("read drive", "read {folder.value}"),
    odometry.follow_spans: ("follow points", "follow points {piece.value.frame_pairs[0].frame_index}"),
    odometry.self_calibrate: ("self-calibrate", None),
    odometry.motions_across: ("follow points across lost pairs", None),
    odometry.refine: ("refine", None),
    detect.detect: ("detect", "detect {chunk.value.frame_pairs[0].frame_index} {part.value}"),
    detect.match: ("match", "match {chunk.value.frame_pairs[0].frame_index}"),
    analysis.locate: ("locate", None),
    analysis.fuse: ("fuse", None),
    analysis.estimate_variances: ("estimate variances", None),
    analysis.inflate_outliers: ("inflate outliers", None),
    standing.without_moving: ("reject moving objects", None),
    markings.mark: ("mark", None),
    commit.commit: ("merge", None),
    artifacts.publish_drive: ("publish", None),
    artifacts.publish_pending: ("publish what is pending", None),
}

#: How often Dask profiles itself. By default it samples every worker's stack 100 times a second, and a worker that only waits
#: takes 3.4 % of a core; with these settings 0.7 %.
DASK_CONFIG = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "10s",
}


class PrefectExecutor:
    """Runs steps as tasks of the present flow run, with retries."""

    def __init__(self) -> None:
        context = FlowRunContext.get()
        self.shares_memory = context is not None and isinstance(context.task_runner, ThreadPoolTaskRunner)
        self._clock = StepClock()
        self._tasks: dict[Callable[..., Any], Task[..., Any]] = {}

    def run(self, step: Callable[..., Any], *arguments: Any) -> Any:
        return self._task(step)(*map(_sealed, arguments))

    def submit(self, step: Callable[..., Any], *arguments: Any) -> PrefectFuture[Any]:
        return self._task(step).submit(*map(_sealed, arguments))

    def times(self) -> list[StepTime]:
        """Steps that ran in processes of their own are missing: their clock is a copy."""
        return self._clock.times()

    def _task(self, step: Callable[..., Any]) -> Task[..., Any]:
        if step not in self._tasks:
            name, run_name = _NAMES[step]
            self._tasks[step] = task(
                _unsealing(step), name=name, task_run_name=run_name, retries=2, retry_delay_seconds=[1, 5],
                retry_condition_fn=_may_pass, on_completion=[partial(_note, self._clock)],
                cache_policy=NO_CACHE,  # results are kept by content in Parquet files, see files/parquet_store.py
            )  # fmt: skip
        return self._tasks[step]


class _Sealed:
    """An argument that Prefect passes on as it is, because it does not look into objects that it does not know.

    It searches all other arguments for futures and states, twice for each task: every number of every record of a list. With a
    chunk of 128 frame pairs that costs many times what the task's run itself costs, with the records of a drive seconds.
    """

    def __init__(self, value: Any) -> None:
        self.value = value

    def __dask_tokenize__(self) -> str:
        return uuid4().hex  # Dask must not take two tasks for one


def _sealed(argument: Any) -> Any:
    return argument if isinstance(argument, PrefectFuture) else _Sealed(argument)


def _unsealing(step: Callable[..., Any]) -> Callable[..., Any]:
    """The step for sealed arguments, and for results of other tasks, which are not."""

    @wraps(step)
    def unsealed(*arguments: Any, **named: Any) -> Any:
        whole = {name: each.value if isinstance(each, _Sealed) else each for name, each in named.items()}
        return step(*(each.value if isinstance(each, _Sealed) else each for each in arguments), **whole)

    return unsealed


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
