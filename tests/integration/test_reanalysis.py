"""A better release corrects the map that an older one made."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import SecretStr

from conetl.db.connection import Connection
from conetl.db.map.decision_store import list_decisions
from conetl.db.map.map_store import read_current_features
from conetl.model.params import IngestParams
from conetl.pipeline import analysis, chunks
from conetl.pipeline.analysis import analyse
from conetl.pipeline.backfill_plan import Plan, plan_drives
from conetl.pipeline.ingest import ingest
from conetl.pipeline.maps.decisions import decide_location
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from tests.integration.drives_of_days import failed_audits, valid_time_map
from tests.integration.small_drives import SAMPLES, cut_drive, unpublished

#: Of the first sample drive: counts of records, and number of positions, position, height and sigmas (m) of every track.
RECORDS = Path(__file__).with_name("records_of_a_sample_drive.json")


def test_results_change_only_with_the_analysis_version(sample_settings: Settings) -> None:
    """If it fails, increment ANALYSIS_VERSION: users then see that `conetl backfill --reanalyse` corrects their maps. What it
    prints are the new records."""
    drive, rejections = read_drive(SAMPLES[0])
    records = analyse(drive, rejections=rejections, settings=sample_settings).records
    found = {
        "counts": [len(records.detections), len(records.matches), len(records.positions), len(records.rejections)],
        "tracks": [
            [
                len(one.members),
                *one.xyz_m,
                one.object_height_m,
                *(sigma2**0.5 for sigma2 in (one.cov_m2[0], one.cov_m2[5])),
            ]
            for one in records.tracks
        ],
    }
    rounded = [[round(value, 5) for value in track] for track in found["tracks"]]
    print(json.dumps({"version": chunks.ANALYSIS_VERSION, **found, "tracks": rounded}))
    expected = json.loads(RECORDS.read_text())
    assert (expected["version"], expected["counts"]) == (chunks.ANALYSIS_VERSION, found["counts"])
    # Processors differ by some micrometres.
    assert np.array(found["tracks"]) == pytest.approx(np.array(expected["tracks"]), abs=2e-4)


def test_reanalysis_makes_the_map_of_an_older_version_that_of_this_one(
    conn: Connection,
    database_url: str,
    another_database: Callable[[], Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    root, params = tmp_path / "drives", IngestParams()
    days = [f"2026-03-{day:02d}" for day in range(2, 2 + len(SAMPLES))]
    drives = [cut_drive(sample, root / day, day) for sample, day in zip(SAMPLES, days, strict=True)]
    settings = Settings(home=tmp_path / "home", database_url=database_url)

    def plan(*, reanalyse: bool) -> Plan:
        conn.rollback()
        return plan_drives(conn, root, settings=settings, params=params, reanalyse=reanalyse)

    fuse = analysis.fuse_tracks
    with monkeypatch.context() as older:  # which lost an object of each drive
        older.setattr(chunks, "ANALYSIS_VERSION", "an older one")
        older.setattr(analysis, "fuse_tracks", lambda *data: (fuse(*data)[0][1:], fuse(*data)[1]))
        for drive in drives:
            ingest(drive, params, settings, publish_new=unpublished)
    made = read_current_features(conn)
    conn.rollback()
    decide_location(conn, "suppress", str(made[0].feature_id), map_name="default", note="a bollard")
    assert [(line.action, line.why.partition(":")[0]) for line in plan(reanalyse=False).lines] == [
        ("skip", "analysed by another version")
    ] * len(drives)
    for left in (3, 2, 1):  # each time as if the one before had been killed
        lines = [line for line in plan(reanalyse=True).lines if line.action == "ingest"]
        assert len(lines) == left
        assert {line.why.partition(":")[0] for line in lines} == {"analysed by another version"}
        ingest(lines[0].header.path, params, settings, publish_new=unpublished)
    assert plan(reanalyse=True).todo == []
    assert failed_audits(conn) == []
    with another_database() as fresh:
        for drive in drives:
            in_fresh = settings.model_copy(update={"database_url": SecretStr(fresh.dsn)})
            ingest(drive, params, in_fresh, publish_new=unpublished)
        decide_location(fresh, "suppress", str(made[0].feature_id), map_name="default", note="a bollard")
        assert valid_time_map(conn) == valid_time_map(fresh)
    assert len(read_current_features(conn)) > len(made)
    assert [one.kind for one in list_decisions(conn, map_name="default")] == ["suppress"]
