"""The map against its own rules, as a scheduled run."""

from contextlib import closing
from typing import Any

from prefect import State, flow
from prefect.artifacts import create_table_artifact
from prefect.states import Completed, Failed

from conetl.db.audits import run_audits
from conetl.db.connection import connect
from conetl.pipeline.settings import read_settings
from flows.drive_job import alive
from flows.recovery import recover


@flow(name="audit", flow_run_name="audit")
def audit() -> State[Any]:
    """Run all audits over all maps of the database; failed where one of them finds a row."""
    with alive(read_settings()) as url, closing(connect(url)) as conn:
        recover(conn)
        results = run_audits(conn)
    rows = [
        {"audit": r.name, "result": "passed" if r.passed else f"{r.row_count} rows", "what": r.purpose} for r in results
    ]
    create_table_artifact(rows, key="audit", description="The map against its own rules")
    broken = [result for result in results if not result.passed]
    if broken:
        found = [{"audit": r.name, **{k: str(v) for k, v in row.items()}} for r in broken for row in r.rows[:20]]
        create_table_artifact(found, key="audit-rows", description="Rows that must not be; the first 20 of each audit")
        return Failed(message=f"{', '.join(r.name for r in broken)}: rows that must not be; see `conetl db audit`")
    return Completed(message=f"{len(results)} audits passed")
