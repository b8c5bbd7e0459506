"""The last arrow: tracks of one drive into the map, as one atomic changeset under the map's lock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from uuid import UUID, uuid5

from prefect import task
from prefect.context import get_run_context
from prefect.runtime import flow_run

from conetl.db.cluster.cluster import cluster_up
from conetl.db.connection import Connection, connect, migrate, transaction
from conetl.db.live_store import drop_watched_recording
from conetl.db.map.map_store import (
    find_changeset,
    find_map,
    map_transaction,
)
from conetl.db.map.replay_store import other_deliveries
from conetl.db.map.results import CommittedChangeset, RunInfo
from conetl.files.parquet_store import result_key
from conetl.model.detector_evidence import DetectorEvidence, evidence_sha256
from conetl.model.errors import MapMismatchError
from conetl.model.ingest_report import ChangeLine, IngestReport
from conetl.model.map_records import Changeset, Delta, DeltaKind, MapFeature
from conetl.model.params import IngestParams, params_sha256
from conetl.model.records import Drive, DriveRecords, Record, utc_from_ns
from conetl.model.rejections import INPUT_REASONS
from conetl.perception.model_card import read_model_card
from conetl.pipeline.code_identity import code_facts
from conetl.pipeline.replay import merge_drive
from conetl.pipeline.settings import Settings
from flows.retries import RETRY, lost_frame_pairs

_NAMESPACE = UUID("0b9b3a5e-9c1f-4d0e-8b55-2f7d9a1c6e42")


class Identity(Record):
    """What makes an ingest the same as an earlier one."""

    idempotency_key: str
    params_sha256: str
    model_sha256: str
    evidence: DetectorEvidence | None
    """What the model's sidecar says of its boxes."""


class Merged(Record):
    """What `merge_task` hands on."""

    changeset: Changeset
    untouched: tuple[MapFeature, ...]
    """Features around the path that the drive did not judge."""
    report: IngestReport


def identify(drive: Drive, params: IngestParams, settings: Settings) -> Identity:
    """Hashes of content, parameters and model with its evidence; the same on the same map are the same changeset."""
    card = read_model_card(settings.model_path)
    parameters, measured = params_sha256(params), evidence_sha256(card.evidence)
    key = result_key(
        "changeset", drive.content_sha256, parameters, card.detections_sha256, measured, str(drive.map_srid)
    )
    return Identity(idempotency_key=key, params_sha256=parameters, model_sha256=card.sha256, evidence=card.evidence)


def database_url(settings: Settings) -> str:
    """Address of the map's database; the private cluster is started where it does not run."""
    return settings.database_url.get_secret_value() if settings.database_url else cluster_up(settings.home)


@contextmanager
def open_map(settings: Settings) -> Iterator[Connection]:
    """A connection to the map's database, started and migrated where needed."""
    url = database_url(settings)
    with closing(connect(url)) as conn:
        migrate(conn)
        yield conn


def map_srid(settings: Settings) -> int | None:
    """CRS of the map as it is, None where it does not exist yet: later drives are placed in the map's own CRS."""
    with open_map(settings) as conn:
        info = find_map(conn, settings.map_name)
    return info.srid if info else None


def already_committed(drive: Drive, identity: Identity, settings: Settings) -> IngestReport | None:
    """The report 'no changes' where this very drive is on the map already."""
    with open_map(settings) as conn:
        known = find_changeset(conn, identity.idempotency_key, map_name=settings.map_name)
        if known is not None:  # it may have been watched again since
            with transaction(conn, "Provisional features cannot be removed"):
                drop_watched_recording(conn, drive, map_name=settings.map_name)
    return _no_changes(drive, identity, known, settings) if known else None


def refuse_other_delivery(drive: Drive, settings: Settings) -> None:
    """Raise MapMismatchError where the recording is on the map with other content: one drive would count as two surveys."""
    with open_map(settings) as conn, transaction(conn, "The map cannot be read"):
        numbers = other_deliveries(conn, drive, map_name=settings.map_name)
    if numbers:
        number = numbers[-1]
        raise MapMismatchError(
            f"{drive.source_path}: drive {drive.drive_id} is on the map already, with other content (changeset {number}); the "
            f"two would count as two surveys. Take that back with `conetl map revert {number}` and ingest the drive again, or "
            "give it a drive_id of its own in drive.yaml if it is another drive. Nothing was written."
        )


@task(name="merge", **RETRY)
def merge_task(
    records: DriveRecords,
    identity: Identity,
    settings: Settings,
    params: IngestParams,
    told: dict[str, str],
) -> Merged:
    """Compare the tracks with the map and commit the differences: all of them, or none."""
    drive = records.drive
    run = RunInfo(
        run_id=UUID(str(get_run_context().task_run.id)),  # type: ignore[union-attr]
        started_at=datetime.now(UTC),
        params=params.model_dump(mode="json"),
        flow_run_id=flow_run.get_id(),
        facts={**told, **code_facts()},
    )
    with open_map(settings) as conn, map_transaction(conn, settings.map_name):
        known = find_changeset(conn, identity.idempotency_key, map_name=settings.map_name)
        if known is not None:  # another ingest of the same drive was faster
            changeset = _changeset(drive, settings.map_name, identity, ())
            return Merged(changeset=changeset, untouched=(), report=_no_changes(drive, identity, known, settings))
        merged = merge_drive(
            conn,
            records,
            _changeset(drive, settings.map_name, identity, ()),
            params,
            map_name=settings.map_name,
            evidence=identity.evidence,
            run=run,
        )
    deltas = merged.changeset.deltas
    return Merged(
        changeset=merged.changeset,
        untouched=tuple(merged.extension.untouched),
        report=IngestReport(
            drive_id=drive.drive_id,
            status="committed",
            changeset_id=merged.changeset.changeset_id,
            captured_from=drive.captured_from,
            captured_to=drive.captured_to,
            map_name=settings.map_name,
            map_srid=drive.map_srid,
            frame_pairs=len(drive.frame_pairs),
            frame_pairs_rejected=len(lost_frame_pairs(records.rejections, INPUT_REASONS)),
            detections=len(records.detections),
            matches=len(records.matches),
            positions=len(records.positions),
            tracks=len(records.tracks),
            counts={kind: sum(d.kind == kind for d in deltas) for kind in DeltaKind},
            changes=tuple(_line(delta) for delta in deltas),
            rejections=dict(sorted(Counter(r.reason for r in records.rejections).items())),
            params_sha256=identity.params_sha256,
            model_sha256=identity.model_sha256,
            content_sha256=drive.content_sha256,
            seconds=0.0,
            committed_at=None,
            replayed_drives=merged.replayed,
        ),
    )


def _changeset(drive: Drive, map_name: str, identity: Identity, deltas: tuple[Delta, ...]) -> Changeset:
    return Changeset(
        changeset_id=uuid5(_NAMESPACE, f"{map_name}/{identity.idempotency_key}"),
        drive_id=drive.drive_id,
        idempotency_key=identity.idempotency_key,
        params_sha256=identity.params_sha256,
        model_sha256=identity.model_sha256,
        code_version=version("conetl"),
        deltas=deltas,
    )


def _line(delta: Delta) -> ChangeLine:
    feature = delta.new or delta.old
    if feature is None:
        raise ValueError("a delta has an old or a new side")
    return ChangeLine(
        kind=delta.kind,
        feature_id=delta.feature_id,
        xyz_m=feature.xyz_m,
        cone_height_m=feature.cone_height_m,
        sigma_horizontal_m=((feature.cov_m2[0] + feature.cov_m2[3]) / 2) ** 0.5,
        existence_probability=delta.evidence.existence_probability if delta.evidence else feature.existence_probability,
        observation_count=feature.observation_count,
        shift_m=delta.shift_m,
    )


def _no_changes(drive: Drive, identity: Identity, known: CommittedChangeset, settings: Settings) -> IngestReport:
    report = report_of(
        known,
        map_name=settings.map_name,
        map_srid=drive.map_srid,
        content_sha256=drive.content_sha256,
        expected_frame_count=drive.expected_frame_count,
    )
    return report.model_copy(update={"model_sha256": identity.model_sha256})


def report_of(
    known: CommittedChangeset, *, map_name: str, map_srid: int, content_sha256: str, expected_frame_count: int
) -> IngestReport:
    """The report of a drive that is on the map already, whether the drive itself is at hand or not."""
    return IngestReport(
        drive_id=known.drive_id,
        status="no changes",
        changeset_id=known.changeset_id,
        captured_from=utc_from_ns(known.captured_from_ns),
        captured_to=utc_from_ns(known.captured_to_ns),
        map_name=map_name,
        map_srid=map_srid,
        frame_pairs=known.frame_pair_count,
        frame_pairs_rejected=expected_frame_count - known.frame_pair_count,
        detections=known.detection_count,
        matches=known.match_count,
        positions=known.position_count,
        tracks=known.track_count,
        counts={kind: getattr(known, f"{kind.value}_count") for kind in DeltaKind},
        changes=(),
        rejections={},
        params_sha256=known.params_sha256,
        model_sha256=known.model_sha256,
        content_sha256=content_sha256,
        seconds=0.0,
        committed_at=known.committed_at,
        counts_on_map=known.counts,
    )
