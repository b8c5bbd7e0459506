"""The map as files, every night."""

from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from prefect import State, flow
from prefect.artifacts import create_table_artifact
from prefect.states import Completed
from pydantic import Field

from conetl.io.db import Connection, connect
from conetl.io.exports.csv_table import export_csv
from conetl.io.exports.geojson import export_geojson
from conetl.io.map_store import find_map
from flows.drive_job import MapName, alive, settings_for


@flow(name="publish-map", flow_run_name="publish map")
def publish_map(
    map_name: MapName = None,
    folder: Annotated[
        Path | None, Field(description="Where the files go; `exports` of CONETL_HOME unless given.")
    ] = None,
) -> State[Any]:
    """Write the map as it stands in all formats."""
    settings = settings_for(map_name)
    with alive(settings) as url, closing(connect(url)) as conn:
        if find_map(conn, settings.map_name) is None:
            return Completed(name="NothingToPublish", message=f"the map {settings.map_name} is empty")
        files = export_map(conn, settings.map_name, folder or settings.exports_folder)
    rows = [{"file": str(path), "kB": round(path.stat().st_size / 1000, 1)} for path in files]
    create_table_artifact(
        rows, key="exports", description=f"Map {settings.map_name}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    )
    return Completed(message=f"{len(files)} files in {files[0].parent}")


def export_map(conn: Connection, map_name: str, folder: Path) -> list[Path]:
    """Write every format; the files. The one place to add a format."""
    folder.mkdir(parents=True, exist_ok=True)
    geojson, csv = folder / f"{map_name}.geojson", folder / f"{map_name}.csv"
    export_geojson(conn, geojson, map_name=map_name)
    export_csv(conn, csv, map_name=map_name)
    return [geojson, csv]
