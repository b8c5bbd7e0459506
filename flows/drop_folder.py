"""New drives from the folder where they arrive: each complete one is ingested once.

A drive is complete when its folder holds a file named COMPLETE, or when nothing in it has changed for `drop_quiet_minutes`
(CONETL_DROP_QUIET_MINUTES, default 10), by the time of the inode change, which copying tools cannot set back.
"""

import time
from pathlib import Path
from typing import Annotated, Any

from prefect import State, flow
from prefect.artifacts import create_table_artifact
from prefect.states import Completed
from pydantic import Field

from conetl.files.names import as_markdown
from conetl.model.params import IngestParams
from conetl.pipeline.backfill_plan import plan_drives
from conetl.pipeline.publish import catch_up_all
from conetl.readers.drives.header import MARKER, find_drives, quiet_since
from flows.artifacts import send_events
from flows.backfill import Parallel, run_batch
from flows.runs import MapName, MapSrid, alive, recover, settings_for


@flow(name="ingest-drop-folder", flow_run_name="new drives")
def ingest_drop_folder(
    folder: Annotated[
        Path | None, Field(description="Where drives arrive; CONETL_DROP_FOLDER of the worker unless given.")
    ] = None,
    quiet_minutes: Annotated[
        float | None, Field(ge=0, description="Minutes without a change after which a drive counts as complete.")
    ] = None,
    max_parallel: Parallel = None,
    map_name: MapName = None,
    map_srid: MapSrid = None,
    params: Annotated[IngestParams, Field(description="Parameters of all steps.")] = IngestParams(),  # noqa: B008 -- frozen
) -> State[Any]:
    """Ingest new drives. One that failed is skipped until it changes, or a person runs a backfill."""
    settings = settings_for(map_name)
    inbox = (folder or settings.inbox).absolute()
    settings.require_readable(inbox)
    quiet_s = 60.0 * (settings.drop_quiet_minutes if quiet_minutes is None else quiet_minutes)
    with alive(settings) as database:
        recover(database)
        catch_up_all(settings, database, send_events)
        complete, arriving = split_by_completeness(inbox, quiet_s)
        with database.connection() as conn:
            plan = plan_drives(conn, inbox, settings=settings, params=params, once=True, folders=complete)
        if arriving:
            rows = [
                {"drive": as_markdown(path.name), "quiet for s": round(quiet, 1), "needed s": quiet_s}
                for path, quiet in arriving
            ]
            create_table_artifact(
                rows, key="arriving", description=f"Still arriving: neither {MARKER} nor quiet for long enough"
            )
        if not plan.todo:
            message = (
                f"nothing new: {len(complete)} complete drives are done, {len(arriving)} still arriving in {inbox}"
            )
            return Completed(name="NothingNew", message=message)
        return run_batch(database, plan, settings, params, map_srid=map_srid, max_parallel=max_parallel, where="auto")


def split_by_completeness(inbox: Path, quiet_s: float) -> tuple[list[Path], list[tuple[Path, float]]]:
    """Complete drives; and those that still arrive, with the seconds since their last change. Raises DriveFolderError."""
    complete: list[Path] = []
    arriving: list[tuple[Path, float]] = []
    for folder in find_drives(inbox):
        changed_at = quiet_since(folder)
        quiet = None if changed_at is None else time.time() - changed_at
        if quiet is None or quiet >= quiet_s:
            complete.append(folder)
        else:
            arriving.append((folder, quiet))
    return complete, arriving
