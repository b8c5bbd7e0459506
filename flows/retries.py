"""What all tasks share: when to try again, what is handed to them whole, and which frame pairs were lost."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar, cast

import httpx
from prefect.cache_policies import NO_CACHE
from prefect.context import FlowRunContext
from prefect.task_runners import ProcessPoolTaskRunner, ThreadPoolTaskRunner
from prefect.utilities.annotations import opaque

from conetl.model.errors import InputError, ServiceError, is_of_storage, storage_failed
from conetl.model.rejections import Rejection, RejectionReason
from flows.timing import note_time


def _may_pass(_task: Any, _run: Any, state: Any) -> bool:
    """Disk, network and database may be better in a second; bad input stays bad."""
    try:
        state.result()
    except InputError as error:
        return is_of_storage(error.__cause__)
    except Exception:
        return True
    return False


def as_known(error: Exception) -> Exception:
    """A service or a storage that failed under a library's or the system's own name, as conetl's error; others as they are."""
    refused = isinstance(error, PermissionError) or (is_of_storage(error) and not isinstance(error, ConnectionError))
    if isinstance(error, OSError) and refused:
        return storage_failed(error)
    if isinstance(error, httpx.HTTPError):
        return ServiceError(
            f"Prefect does not answer ({type(error).__name__}: {error}): see whether its server runs (`conetl status`, "
            "PREFECT_API_URL), and run the same command again."
        )
    return error


RETRY: dict[str, Any] = {
    "retries": 2,
    "retry_delay_seconds": [1, 5],
    "retry_condition_fn": _may_pass,
    "on_completion": [note_time],
    "cache_policy": NO_CACHE,  # results are kept by content in the Parquet store, see files/parquet_store.py
}


_T = TypeVar("_T")


def whole(value: _T) -> _T:
    """A task's argument that Prefect hands on as it is.

    Prefect looks for futures and states inside of all arguments, twice for each task: every number of every record of a list.
    With a chunk of 128 frame pairs that costs many times what the task's run itself costs, with the records of a drive seconds.
    Dask makes a plain tuple of Prefect's mark, so there it looks.
    """
    context = FlowRunContext.get()
    marks = context is None or isinstance(context.task_runner, ThreadPoolTaskRunner | ProcessPoolTaskRunner)
    return cast(_T, opaque(value)) if marks else value


def lost_frame_pairs(rejections: Iterable[Rejection], reasons: frozenset[RejectionReason]) -> set[str]:
    """Frame pairs that were refused for one of the reasons, each once even where both its images are bad."""
    return {rejection.record for rejection in rejections if rejection.reason in reasons}
