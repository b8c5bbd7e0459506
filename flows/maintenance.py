"""The map as files for others, every night, and against its own rules, every week."""

from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from prefect import State, flow
from prefect.artifacts import create_link_artifact, create_table_artifact
from prefect.states import Completed, Failed
from pydantic import Field

from conetl.db.map.decision_store import held_drives
from conetl.db.map.map_store import find_map
from conetl.db.schema import run_audits
from conetl.exports import FORMATS
from conetl.files.names import as_markdown
from conetl.pipeline.nightly_publication import REPORT, write_publication
from conetl.pipeline.settings import read_settings
from flows.runs import MapName, alive, recover, settings_for


@flow(name="publish-map", flow_run_name="publish map")
def publish_map(
    map_name: MapName = None,
    formats: Annotated[
        list[str] | None, Field(description=f"Some of {', '.join(FORMATS)}; all of them unless given.")
    ] = None,
    folder: Annotated[
        Path | None, Field(description="Where publications go; `exports` of CONETL_HOME unless given.")
    ] = None,
    as_of: Annotated[datetime | None, Field(description="Instant on the road; the latest map unless given.")] = None,
) -> State[Any]:
    """Write the map in several formats to a new folder, and point `latest` at it.

    All files show the same state of the map; `report.html` covers the last 24 hours. Fails for an unknown format or a folder that
    cannot be written; the last publication stays then.
    """
    settings = settings_for(map_name)
    with alive(settings) as database:
        with database.connection() as conn:
            if find_map(conn, settings.map_name) is None:
                return Completed(name="NothingToPublish", message=f"the map {settings.map_name} is empty")
        wanted = list(FORMATS) if formats is None else formats
        published, manifests = write_publication(
            settings, wanted, folder or settings.exports_folder, as_of, database=database
        )
        with database.connection() as conn:
            held = held_drives(conn, map_name=settings.map_name)
    create_table_artifact(
        [{name: manifest[name] for name in ("file", "rows", "bytes", "sha256")} for manifest in manifests],
        key="publication",
        description=f"Map {settings.map_name} -> {as_markdown(published)}",
    )
    page = published / REPORT
    create_link_artifact(
        page.resolve().as_uri(),
        key="qa-report-night",
        link_text="QA report of the last 24 hours",
        description=f"The file: {as_markdown(page)}",
    )
    message = f"{len(manifests)} files in {published}"
    if held:
        message = f"{len(held)} drives on hold; {message}. {held[0].drive_id}: {held[0].reason}"
        return Completed(name="DrivesOnHold", message=message)
    return Completed(message=message)


@flow(name="audit", flow_run_name="audit")
def audit() -> State[Any]:
    """Run all audits over all maps of the database; failed where one of them finds a row."""
    with alive(read_settings()) as database:
        recover(database)
        with database.connection() as conn:
            results = run_audits(conn)
    rows = [
        {"audit": r.name, "result": "passed" if r.passed else f"{r.row_count} rows", "what": r.purpose} for r in results
    ]
    create_table_artifact(rows, key="audit", description="The map against its own rules")
    broken = [result for result in results if not result.passed]
    if broken:
        found = [
            {"audit": r.name, **{k: as_markdown(str(v)) for k, v in row.items()}} for r in broken for row in r.rows[:20]
        ]
        create_table_artifact(found, key="audit-rows", description="Rows that must not be; the first 20 of each audit")
        return Failed(message=f"{', '.join(r.name for r in broken)}: rows that must not be; see `conetl db audit`")
    return Completed(message=f"{len(results)} audits passed")
