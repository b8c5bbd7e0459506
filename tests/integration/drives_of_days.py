"""Drives over one synthetic road on several days, by the real steps, ready to be merged; and the map as lines to compare."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache
from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from conetl.db.connection import Connection, execute
from conetl.db.map.map_store import drive_transaction
from conetl.db.schema import AuditResult, run_audits
from conetl.geometry.calibration.covariance import with_covariance
from conetl.model.detector_evidence import DetectorEvidence
from conetl.model.drive import Drive, DriveRecords
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.health import HealthCheck, Verdict
from conetl.model.map_records import Changeset
from conetl.model.params import DetectionParams, IngestParams
from conetl.model.rig import CalibrationCovariance, Rig
from conetl.pipeline.replay import MergeResult, merge_drive
from tests.synthetic.world import START_NS, Cone, detect, fuse_logged, locate, make_path, make_rig, shifted

DAY_NS = 86_400_000_000_000
RIG = make_rig()
#: With a covariance of the calibration, which its drives share.
CALIBRATED = with_covariance(
    RIG,
    CalibrationCovariance(
        names=("left.fx_px", "right.cx_px", "relative.ry_rad"),
        matrix=((1.0, 0.0, 0.0), (0.0, 0.25, 0.0), (0.0, 0.0, 2.5e-7)),
    ),
)
#: Calibrated another time, with more parameters open.
AGAIN = with_covariance(
    RIG,
    CalibrationCovariance(
        names=("left.fx_px", "right.cx_px", "relative.ry_rad", "relative.tx_m"),
        matrix=np.diag([1.0, 0.25, 2.5e-7, 1e-6]).tolist(),
    ),
)
#: Of each day, where drives have errors of their calibrations in common.
RIGS = (CALIBRATED, CALIBRATED, AGAIN, RIG)
SIGN = "traffic_sign"
#: Drives with lane markings searched for them, and for signs.
PAINTED = IngestParams(detection=DetectionParams(categories=(CONE, SIGN, LANE_MARKING)))
ROW = [Cone((14.0 + 5.0 * k, 3.6 - 0.4 * k, 0.0), height_m=0.7 if k % 2 else 0.5) for k in range(7)]
#: Cones on the road per day: one is moved, one taken away and one set up; then one is moved back, and one comes again.
DAYS = [
    ROW,
    [*ROW[:1], Cone((19.5, 4.6, 0.0), height_m=0.7), *ROW[2:4], *ROW[5:]],
    [*ROW[:4], *ROW[5:], Cone((26.0, -4.0, 0.0), height_m=0.7)],
    [*ROW[:2], *ROW[3:], Cone((26.0, -4.0, 0.0), height_m=0.7)],
]


#: One drive and its results.
Survey = DriveRecords


@cache
def survey(
    day: int,
    *,
    frames: int = 40,
    start_m: float = 0.0,
    after_ns: int = 0,
    name: str = "",
    content: str = "",
    rig: Rig = RIG,
) -> Survey:
    """The drive of one day, with noise and a GNSS offset of its own; `after_ns` later than the day's hour."""
    name = name or f"day_{day}_{frames}_{start_m}_{after_ns}"
    rng = np.random.default_rng(abs(hash((day, frames, start_m, after_ns))) % 2**32)
    first_ns = START_NS + day * DAY_NS + after_ns
    return survey_of(DAYS[day], rng, name, frames=frames, start_m=start_m, first_ns=first_ns, content=content, rig=rig)


def survey_of(
    cones: Sequence[Cone],
    rng: np.random.Generator,
    name: str,
    *,
    frames: int,
    start_m: float,
    first_ns: int,
    content: str = "",
    rig: Rig = RIG,
    signs: Sequence[Cone] = (),
) -> Survey:
    """A drive past cones and signs, with noise and a GNSS offset of its own."""
    true = make_path(frames, start_m=start_m, first_ns=first_ns, sigma_m=0.3)
    first = shifted(true[0], (*rng.normal(0, 0.2, 2), 0.0))
    offset = np.subtract(first.pose.map_t_body_m, true[0].pose.map_t_body_m)
    logged = [shifted(pair, offset) for pair in true]
    boxes = detect(cones, true, rig, noise_px=0.5, rng=rng)
    for key, plates in detect(signs, true, rig, noise_px=0.5, rng=rng).items():
        numbered = ({"category": SIGN, "detection_index": len(boxes[key]) + k} for k in range(len(plates)))
        boxes[key] += [box.model_copy(update=update) for box, update in zip(plates, numbered, strict=True)]
    found, matches, positions = locate(boxes, logged, rig)
    tracks, _ = fuse_logged(logged, rig, found, matches, positions)
    sha256 = content or hashlib.sha256(name.encode()).hexdigest()
    drive = Drive(
        drive_id=name, source_path=name, rig=rig, map_srid=32632, content_sha256=sha256, frame_pairs=tuple(logged),
        expected_frame_count=frames,
    )  # fmt: skip
    return Survey(drive, found, matches, positions, tracks)


def key_of(survey: Survey, params: IngestParams) -> str:
    return hashlib.sha256(f"{survey.drive.content_sha256} {params.model_dump_json()}".encode()).hexdigest()


def merge(
    conn: Connection,
    survey: Survey,
    *,
    map_name: str = "default",
    params: IngestParams | None = None,
    hold: str | None = None,
    evidence: DetectorEvidence | None = None,
) -> MergeResult | None:
    """Merge as the last step of an ingest does; None where the drive is already on the map."""
    params = params or (PAINTED if survey.markings else IngestParams())
    key = key_of(survey, params)
    changeset = Changeset(
        changeset_id=uuid5(NAMESPACE_URL, f"{map_name} {key}"), drive_id=survey.drive.drive_id, idempotency_key=key,
        params_sha256="cd" * 32, model_sha256="ef" * 32, code_version="0", deltas=(),
    )  # fmt: skip
    with drive_transaction(conn, map_name):
        merged = merge_drive(conn, survey, changeset, params, map_name=map_name, evidence=evidence, hold=held_for(hold))
    return merged if isinstance(merged, MergeResult) else None


def held_for(reason: str | None) -> tuple[HealthCheck, ...]:
    """The check that holds a recording, if there is a reason."""
    if reason is None:
        return ()
    figures = {"value": 5.0, "sigma": 0.1, "limit": 0.1, "unit": "m"}
    return (HealthCheck(name="jumps of the poses", verdict=Verdict.HOLD, detail=reason, **figures),)


def failed_audits(conn: Connection) -> list[AuditResult]:
    """The audits that find a row."""
    return [result for result in run_audits(conn) if not result.passed]


def valid_time_map(conn: Connection, map_name: str = "default") -> dict[str, list[str]]:
    """The current database state: versions with their periods and sources, and deltas; without cells."""
    lines = {
        "versions": "select (to_jsonb(v) - 'version_row_id' - 'system_period' - 'map_id' - 'cell')::text as line "
        "from conetl.feature_version v join conetl.map m using (map_id) "
        "where upper_inf(v.system_period) and m.map_name = %(map_name)s order by 1",
        "deltas": "select (to_jsonb(x) - 'delta_row_id' - 'system_period' - 'cell')::text as line "
        "from conetl.delta x join conetl.changeset c using (changeset_id) join conetl.map m using (map_id) "
        "where upper_inf(x.system_period) and m.map_name = %(map_name)s order by 1",
    }
    found = {name: [row["line"] for row in execute(conn, sql, {"map_name": map_name})] for name, sql in lines.items()}
    conn.rollback()
    return found


def known_maps(conn: Connection, map_name: str = "default", days: Sequence[int] = range(len(DAYS))) -> dict[Any, Any]:
    """The map of every day, in the database state after each write."""
    times = execute(
        conn,
        "select distinct lower(system_period) as t from conetl.feature_version v join conetl.map m using (map_id) "
        "where m.map_name = %(map_name)s order by 1",
        {"map_name": map_name},
    )
    sql = (
        "select (to_jsonb(s) - 'version_row_id' - 'system_period' - 'system_to')::text as line "
        "from conetl.feature_states(%(map_name)s, to_timestamp(%(at)s), %(known)s) s order by 1"
    )
    found = {}
    for row in times:
        for day in days:
            values = {"map_name": map_name, "at": (START_NS + day * DAY_NS) / 1e9 + 3600, "known": row["t"]}
            found[row["t"], day] = [line["line"] for line in execute(conn, sql, values)]
    conn.rollback()
    return found
