"""The row of a changeset: the same for a drive and for an imported map."""

from __future__ import annotations

from collections import Counter
from datetime import datetime
from uuid import UUID

from conetl.db.connection import Connection, execute
from conetl.db.copy_binary import json_text
from conetl.db.map.results import MapInfo, RecordCounts, RunInfo
from conetl.db.statements import load_sql
from conetl.model.map_records import Changeset, DeltaKind


def insert_changeset(
    conn: Connection,
    info: MapInfo,
    drive_uuid: UUID,
    changeset: Changeset,
    counts: RecordCounts,
    run: RunInfo | None,
    committed_at: datetime,
) -> None:
    """Write a changeset's own row, and the run that it came from; not its deltas."""
    if run is not None:
        _insert_run(conn, run, committed_at)
    kinds = Counter(delta.kind for delta in changeset.deltas)
    execute(
        conn,
        load_sql("commit.insert_changeset"),
        {
            "changeset_id": changeset.changeset_id,
            "map_id": info.map_id,
            "drive_uuid": drive_uuid,
            "run_id": run.run_id if run else None,
            "idempotency_key": changeset.idempotency_key,
            "params_sha256": changeset.params_sha256,
            "model_sha256": changeset.model_sha256,
            "code_version": changeset.code_version,
            "committed_at": committed_at,
            **{f"{kind.value}_count": kinds[kind] for kind in DeltaKind},
            **counts._asdict(),
        },
    )


def _insert_run(conn: Connection, run: RunInfo, finished_at: datetime) -> None:
    """Keep the parameters of a run that ends in a changeset; does not commit."""
    parameters = {
        "run_id": run.run_id,
        "started_at": run.started_at,
        "finished_at": finished_at,
        "params": json_text(dict(run.params)),
        "flow_run_id": run.flow_run_id,
        "facts": None if run.facts is None else json_text(dict(run.facts)),
    }
    execute(conn, load_sql("commit.insert_run"), parameters)
