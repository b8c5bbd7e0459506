"""What drives show that are being recorded, or were and are not ingested yet: no part of the map."""

from __future__ import annotations

from datetime import datetime
from uuid import UUID

from fastapi import APIRouter

from conetl.db.live_store import read_provisional
from conetl.model.records import Vec3, utc_from_ns
from conetl.web.models import Answer
from conetl.web.parameters import MAX_FEATURES, MapName, Reader, origin_of
from conetl.web.rows import local

router = APIRouter(tags=["features"], prefix="/maps/{map_name}")


class ProvisionalFeature(Answer):
    drive_id: str
    feature_index: int
    """Number within its drive; it stays the same while the drive is watched."""
    is_watched: bool
    """False: its watch has ended, and its drive is not ingested yet."""
    xyz_m: Vec3
    cov_m2: tuple[float, float, float]
    """xx, xy, yy."""
    cone_height_m: float
    existence_probability: float
    observation_count: int
    last_seen_at: datetime
    near_feature_id: UUID | None
    """The standing feature that it may be; null where none is near."""


class ProvisionalFeatures(Answer):
    origin_m: Vec3
    features: list[ProvisionalFeature]
    truncated: bool


@router.get("/provisional")
def provisional(map_name: MapName, conn: Reader) -> ProvisionalFeatures:
    """Cones of drives that are being recorded; the ingest of a drive replaces its own."""
    origin = origin_of(conn, map_name)
    rows = read_provisional(conn, map_name=map_name)
    return ProvisionalFeatures(
        origin_m=origin,
        features=[
            ProvisionalFeature(
                drive_id=row["drive_id"], feature_index=row["feature_index"], is_watched=row["ended_at"] is None,
                xyz_m=local(row, origin), cov_m2=(row["cov_xx"], row["cov_xy"], row["cov_yy"]),
                cone_height_m=row["cone_height_m"], existence_probability=row["existence_probability"],
                observation_count=row["observation_count"], last_seen_at=utc_from_ns(row["last_seen_ns"]),
                near_feature_id=row["near_feature_id"],
            )
            for row in rows[:MAX_FEATURES]
        ],
        truncated=len(rows) > MAX_FEATURES,
    )  # fmt: skip
