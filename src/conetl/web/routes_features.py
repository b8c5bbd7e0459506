"""Features as of an instant, what changed, and one feature's history and sightings."""

from __future__ import annotations

from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, HTTPException, Query

from conetl.db.map.map_store import find_features
from conetl.db.serve_store import (
    read_changes_between,
    read_changeset_changes,
    read_feature_history,
    read_features,
    read_rigs,
    read_sightings,
)
from conetl.model.params import ReconcileParams
from conetl.model.records import Rig
from conetl.web import rows as to
from conetl.web.models import Changes, FeatureHistory, Features, FoundFeatures, Sightings
from conetl.web.parameters import (
    MAX_FEATURES,
    MAX_SIGHTINGS,
    ChangesetNo,
    Instant,
    MapName,
    Metres,
    Reader,
    origin_of,
)

router = APIRouter(tags=["features"], prefix="/maps/{map_name}")
_MAX_FOUND = 20
#: Nearer than this, two places are one for the pipeline too.
_MOVED_FROM_M = ReconcileParams().min_gate_m


@router.get("/features")
def features(map_name: MapName, conn: Reader, valid_at: Instant = None, known_at: Instant = None) -> Features:
    """What stood on the road at `valid_at`, as the database knew it at `known_at`."""
    origin = origin_of(conn, map_name)
    found = read_features(conn, map_name, valid_at, known_at, MAX_FEATURES + 1)
    return Features(
        origin_m=origin,
        features=[to.feature(row, origin) for row in found[:MAX_FEATURES]],
        truncated=len(found) > MAX_FEATURES,
    )


@router.get("/changes/{changeset_no}")
def changes_of_changeset(map_name: MapName, changeset_no: ChangesetNo, conn: Reader) -> Changes:
    """What one changeset did to every feature it judged."""
    origin = origin_of(conn, map_name)
    found = read_changeset_changes(conn, map_name, changeset_no)
    return Changes(origin_m=origin, changes=[to.change(row, origin) for row in found], truncated=False)


@router.get("/changes")
def changes_between(
    map_name: MapName,
    conn: Reader,
    from_valid_at: Instant = None,
    from_known_at: Instant = None,
    to_valid_at: Instant = None,
    to_known_at: Instant = None,
    moved_from_m: Metres = _MOVED_FROM_M,
) -> Changes:
    """How the map differs between two instants; a feature moved where its place changed by `moved_from_m` or more."""
    origin = origin_of(conn, map_name)
    before, after = (from_valid_at, from_known_at), (to_valid_at, to_known_at)
    found = read_changes_between(
        conn, map_name, before, after, moved_from_m=moved_from_m, max_rows=MAX_FEATURES + 1
    )  # fmt: skip
    return Changes(
        origin_m=origin,
        changes=[to.change(row, origin) for row in found[:MAX_FEATURES]],
        truncated=len(found) > MAX_FEATURES,
    )


@router.get("/find")
def find(
    map_name: MapName, conn: Reader, beginning: Annotated[str, Query(pattern=r"^[0-9a-fA-F-]{1,36}$")]
) -> FoundFeatures:
    """Features whose id begins so, standing or removed."""
    origin_of(conn, map_name)
    ids = find_features(conn, beginning, map_name=map_name, max_rows=_MAX_FOUND + 1)
    return FoundFeatures(feature_ids=ids[:_MAX_FOUND], truncated=len(ids) > _MAX_FOUND)


@router.get("/features/{feature_id}")
def feature_history(map_name: MapName, feature_id: UUID, conn: Reader) -> FeatureHistory:
    """Everything that happened to one feature."""
    origin = origin_of(conn, map_name)
    history = [to.history_item(row, origin) for row in read_feature_history(conn, map_name, feature_id)]
    if not history:
        raise HTTPException(404, f"The map {map_name} knows no feature {feature_id}.")
    return FeatureHistory(feature_id=feature_id, origin_m=origin, history=history)


@router.get("/features/{feature_id}/sightings")
def sightings(map_name: MapName, feature_id: UUID, conn: Reader) -> Sightings:
    """The frame pairs in which one feature was seen, with boxes and camera."""
    origin = origin_of(conn, map_name)
    found = read_sightings(conn, map_name, feature_id, MAX_SIGHTINGS + 1)
    shown = found[:MAX_SIGHTINGS]
    rigs = {
        drive_uuid: Rig.model_validate(rig)
        for drive_uuid, rig in read_rigs(conn, map_name, {row["drive_uuid"] for row in shown}).items()
    }
    return Sightings(
        feature_id=feature_id,
        origin_m=origin,
        sightings=[to.sighting(row, rigs[row["drive_uuid"]], origin) for row in shown],
        truncated=len(found) > MAX_SIGHTINGS,
    )
