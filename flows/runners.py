"""Where the chunks of a drive are worked on: threads, processes or a Dask cluster. The results are the same."""

from __future__ import annotations

from typing import Any

from prefect import Flow
from prefect.context import FlowRunContext
from prefect.futures import PrefectFuture
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from conetl.model.errors import InputError
from conetl.model.ingest_report import IngestReport
from conetl.pipeline.progress import tell_progress
from conetl.pipeline.settings import Settings


def task_runner(settings: Settings) -> TaskRunner[Any]:
    """What CONETL_TASK_RUNNER names, not yet started. Raises InputError where it cannot be had.

    Threads or processes: `workers` of them. Dask: the cluster at CONETL_DASK_ADDRESS, else `workers` processes of this machine
    for the time of one run, on loopback only.
    """
    if settings.dask_address and settings.task_runner != "dask":
        raise InputError(
            f"CONETL_DASK_ADDRESS is {settings.dask_address}, but CONETL_TASK_RUNNER is {settings.task_runner}: set it to "
            "dask, or take the address away"
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
        from prefect_dask.task_runners import DaskTaskRunner
    except ImportError as error:
        raise InputError("CONETL_TASK_RUNNER is dask, which is not installed: pip install 'conetl[dask]'") from error
    if settings.dask_address:
        return DaskTaskRunner(address=settings.dask_address)
    here = {
        "n_workers": settings.workers,
        "threads_per_worker": 1,
        "host": "127.0.0.1",
        "dashboard_address": "127.0.0.1:0",
    }
    return DaskTaskRunner(cluster_class="distributed.LocalCluster", cluster_kwargs=here)


def with_runner(run: Flow[..., IngestReport], settings: Settings) -> Flow[..., IngestReport]:
    """The flow with its chunks where the settings want them."""
    return run.with_options(task_runner=task_runner(settings))


def count_when_done(future: PrefectFuture[Any], drive_id: str, steps: int) -> None:
    """Count a task that runs in another process, which cannot tell how far it is, when it is done."""
    context = FlowRunContext.get()
    if context is not None and not isinstance(context.task_runner, ThreadPoolTaskRunner):
        future.add_done_callback(lambda _: tell_progress(drive_id, steps))
