"""Import a map that was made elsewhere: it becomes an event in the history of this one, like a drive."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import NamedTuple
from uuid import UUID, uuid5

import numpy as np
from scipy.spatial import cKDTree

from conetl.checks.verdict import judge
from conetl.db.connection import Connection
from conetl.db.map import import_store as store
from conetl.db.map.decision_store import read_decisions
from conetl.db.map.map_store import (
    find_changeset,
    find_map,
    map_for,
    map_transaction,
    read_current_features,
    read_versions,
)
from conetl.db.map.replay_store import affected_drives, superseded_drives
from conetl.db.map.results import MapInfo, RunInfo
from conetl.files.parquet_store import result_key
from conetl.geometry.geodesy import to_crs
from conetl.mapping.displacement import check_same_cones
from conetl.mapping.history import DriveEvidence, founding_key
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.feature_classes import FEATURE_CLASSES, known_classes, noun_of
from conetl.model.map_records import Changeset, DeltaKind, ImportedFeature, ImportedMap, MapFeature
from conetl.model.params import ImportParams, params_sha256
from conetl.pipeline.replay import replay_of
from conetl.readers.base_layers.georeferencing import FAR_M

_NAMESPACE = UUID("9d5b6a0c-3d0f-4b0e-8e4f-0a6f2c9b7d13")
#: No network took part.
_NO_MODEL = ""
#: Formats round coordinates to a tenth of a millimetre, times to a microsecond.
_SAME_PLACE_M, _SAME_TIME_NS = 0.001, 1_000_000
#: Objects of one class that stand on the road are wider than this, so their feet are farther apart.
_TWICE_M = 0.25


class ImportResult(NamedTuple):
    """What an import did."""

    changeset_id: UUID | None
    """None where all rows are an export of this map."""
    committed: bool
    """False where the same file with the same parameters is already on the map: nothing was written."""
    counts: dict[DeltaKind, int]
    replayed: int
    """Later drives that were compared with the map again because of it."""
    own: int = 0
    """Rows that were left out: this map exported them, so they are no evidence."""
    same_place: int = 0
    """Rows with ids of their own that stand where cones of the map stand or stood, to a millimetre."""
    far: int = 0
    """Rows that stand farther than `FAR_M` from everything on a map that was not empty."""


def import_map(
    conn: Connection, imported: ImportedMap, params: ImportParams, *, map_name: str, accept: bool = False
) -> ImportResult:
    """Compare an imported map with this one, as the drives recorded before it left it, and commit all changes, or none.

    The same file with other parameters replaces its first import. accept: import it even if its positions or heights contradict
    those of the map, or most of its objects are there twice. Raises InputError for ids that are taken, and for such files.
    """
    started_at = datetime.now(UTC)
    with map_transaction(conn, map_name):
        before = find_map(conn, map_name)
        statements = list(imported.statements)  # a reader makes each when it is asked for
        own = set() if before is None or imported.founds_ids else _own_rows(conn, before, statements)
        if len(own) == len(statements):
            return ImportResult(None, False, dict.fromkeys(DeltaKind, 0), 0, own=len(own))
        left = [i for i in range(len(statements)) if i not in own]
        written = None if imported.as_written is None else imported.as_written[left]
        imported = replace(imported, statements=[statements[i] for i in left], as_written=written)
        keys = _keys(imported, params)
        taken = [known for one in keys if (known := find_changeset(conn, one, map_name=map_name)) is not None]
        for known in taken:
            if _has_same_positions(conn, known.drive_uuid, imported):
                return ImportResult(known.changeset_id, False, dict.fromkeys(DeltaKind, 0), 0, own=len(own))
        info = map_for(conn, map_name, imported.srid, imported.name)
        key = keys[-1] if taken else keys[0]
        changeset = Changeset(
            changeset_id=uuid5(_NAMESPACE, f"{info.id_name}/{key}"),
            drive_id=imported.name,
            idempotency_key=key,
            params_sha256=params_sha256(params),
            model_sha256=_NO_MODEL,
            code_version=version("conetl"),
            deltas=(),
        )
        imported = _with_ids_of_map(imported, info.id_name)
        _refuse_taken_ids(conn, imported, params, map_name)
        if not accept:
            _refuse_doubled(imported)
            _refuse_other_crs(conn, imported, info)
            _refuse_displaced(conn, imported, params, map_name)
        far = int(store.far_from_all(conn, info, _positions_m(imported.statements), FAR_M).sum())
        drive_uuid = store.add_import(conn, info, imported, key, params.reconcile)
        evidence = DriveEvidence(
            key=(imported.stated_at_ns, imported.content_sha256, key),
            changeset_id=changeset.changeset_id,
            founding_key=founding_key(info.id_name, imported.content_sha256),
            tracks=(),
            path_m=np.array([statement.feature.xyz_m[:2] for statement in imported.statements]),
            influence_m=store.IMPORT_INFLUENCE_M,
            check_visibility=lambda feature, offset_m, others_m: None,
            params=params.reconcile,
            judge=judge,
            imported=imported.statements,
        )
        seeds = [drive_uuid, *superseded_drives(conn, drive_uuid)]
        # The cones of an earlier import of this file stand there because of it.
        same_place = _standing_at(conn, map_name, imported.statements) if imported.founds_ids and len(seeds) == 1 else 0
        later = [ref for ref in affected_drives(conn, seeds) if ref.drive_uuid not in seeds]
        aside = [*seeds, *(ref.drive_uuid for ref in later)]
        merged, replay = replay_of(conn, aside, later, read_decisions(conn, map_name=map_name), own=[evidence])
        deltas = tuple(merged.updates[changeset.changeset_id].deltas)
        changeset = changeset.model_copy(update={"deltas": deltas})
        run = RunInfo(
            run_id=uuid5(_NAMESPACE, f"run {info.id_name}/{key}"),
            started_at=started_at,
            params={
                "import": params.model_dump(mode="json"),
                "file": imported.source_path,
                "sha256": imported.content_sha256,
            },
        )
        store.commit_import(conn, info, imported, drive_uuid, changeset, replay, run)
    counts = {kind: sum(delta.kind is kind for delta in deltas) for kind in DeltaKind}
    return ImportResult(changeset.changeset_id, True, counts, len(later), len(own), same_place, far)


def _own_rows(conn: Connection, info: MapInfo, statements: Sequence[ImportedFeature]) -> set[int]:
    """Indices of the rows that this map exported: equal to one of its versions, by its number or with the same evidence."""
    known = store.versions_of_ids(conn, info, [s.stated_id for s in statements if s.stated_id is not None])

    def is_own(statement: ImportedFeature, version: MapFeature) -> bool:
        feature = statement.feature
        same_evidence = (
            feature.observation_count == version.observation_count
            and abs(feature.last_seen_ns - version.last_seen_ns) < _SAME_TIME_NS
        )
        return (
            (same_evidence or statement.stated_version == version.version)
            and feature.category == version.category
            and abs(feature.object_height_m - version.object_height_m) < _SAME_PLACE_M
            and bool(np.abs(np.subtract(feature.xyz_m, version.xyz_m)).max() < _SAME_PLACE_M)
        )

    return {
        index
        for index, statement in enumerate(statements)
        if statement.stated_id is not None
        and any(is_own(statement, version) for version in known.get(statement.stated_id, ()))
    }


def _standing_at(conn: Connection, map_name: str, statements: Sequence[ImportedFeature]) -> int:
    """Number of positions that equal those of cones, now or before, to a millimetre (drives move them after an export)."""
    standing_m = np.array([version.feature.xyz_m for version in read_versions(conn, map_name=map_name)]).reshape(-1, 3)
    if not len(standing_m):
        return 0
    distances_m, _ = cKDTree(standing_m).query(_positions_m(statements), distance_upper_bound=_SAME_PLACE_M)
    return int(np.isfinite(distances_m).sum())


def _keys(imported: ImportedMap, params: ImportParams) -> tuple[str, str]:
    """The import's own key, and the key of an import of the same file with other positions (of another `--crs`)."""
    stated = str(imported.stated_at_ns)
    key = result_key("import", imported.content_sha256, params_sha256(params), str(imported.srid), stated)
    places_mm = np.rint(_positions_m(imported.statements) * 1000).astype(np.int64)
    return key, result_key(key, hashlib.sha256(places_mm.tobytes()).hexdigest())


def _has_same_positions(conn: Connection, drive_uuid: UUID, imported: ImportedMap) -> bool:
    """Whether an earlier import of a file put its cones where this one does, to a millimetre."""
    before_m, now_m = _positions_m(store.read_statements(conn, drive_uuid)), _positions_m(imported.statements)
    return before_m.shape == now_m.shape and bool((np.abs(before_m - now_m) < 1e-3).all())


def _positions_m(statements: Sequence[ImportedFeature]) -> Floats:
    """(n, 3) in the map's CRS."""
    return np.array([statement.feature.xyz_m for statement in statements], dtype=np.float64).reshape(-1, 3)


def _with_ids_of_map(imported: ImportedMap, id_name: str) -> ImportedMap:
    """The import with new ids from this map.

    They are derived from the map's name as well: ids are unique in a database, and one file may be imported into several of its
    maps.
    """
    if not imported.founds_ids:
        return imported
    key = founding_key(id_name, imported.content_sha256)
    statements = []
    for row, statement in enumerate(imported.statements):
        feature = statement.feature.model_copy(update={"feature_id": uuid5(_NAMESPACE, f"{key}/{row}")})
        statements.append(statement.model_copy(update={"feature": feature}))
    return replace(imported, statements=statements)


def _refuse_taken_ids(conn: Connection, imported: ImportedMap, params: ImportParams, map_name: str) -> None:
    """Refuse ids of other features of the database. An id of this map may come again for the same feature."""
    features = [statement.feature for statement in imported.statements]
    taken = store.known_ids(conn, [feature.feature_id for feature in features])
    for index, feature in enumerate(features):
        known = taken.get(feature.feature_id)
        if known is None:
            continue
        where = f"{imported.source_path}, row {index + 1}: feature {feature.feature_id}"
        if known["map_name"] != map_name:
            raise InputError(
                f"{where} belongs to the map {known['map_name']} of this database already: use --new-ids; nothing was written"
            )
        if known["easting_m"] is not None:
            away_m = math.dist(feature.xyz_m[:2], (known["easting_m"], known["northing_m"]))
            if away_m > params.reconcile.moved_max_m:
                away = f"{away_m / 1000:.1f} km" if away_m > 9999 else f"{away_m:.1f} m"
                # An id that was founded can only have come with the same file before.
                remedy = (
                    "take the earlier import of this file back first (conetl map revert)"
                    if imported.founds_ids
                    else "correct the row, or use --new-ids"
                )
                raise InputError(
                    f"{where} stands {away} away on this map, farther than a cone is moved: {remedy}; nothing was written"
                )


def _refuse_doubled(imported: ImportedMap) -> None:
    """Refuse a file with most objects of a class twice, such as two surveys in one file: the second would add its own cones."""
    classes = [statement.feature.category for statement in imported.statements]
    for category in known_classes(classes):
        if not FEATURE_CLASSES[category].on_road:
            continue  # several signs may hang on one post
        of_class = [one for one, name in zip(imported.statements, classes, strict=True) if name == category]
        xy_m = _positions_m(of_class)[:, :2]
        distances_m, _ = cKDTree(xy_m).query(xy_m, k=2)
        twice = int((np.asarray(distances_m)[:, 1] < _TWICE_M).sum())
        if 2 * twice > len(of_class):
            raise InputError(
                f"{imported.source_path}: {twice} of {len(of_class)} {noun_of(category)}s are less than {_TWICE_M} m from "
                "another one of the file: if it holds two surveys, import each from a file of its own, or remove the duplicates; "
                "--accept imports them as they are; nothing was written"
            )


def _refuse_other_crs(conn: Connection, imported: ImportedMap, info: MapInfo) -> None:
    """Refuse coordinates that are far from everything in their stated CRS, but not in the map's or a neighbouring zone."""
    if (
        imported.as_written is None
        or not store.far_from_all(conn, info, _positions_m(imported.statements), FAR_M).all()
    ):
        return
    written = np.column_stack((imported.as_written, np.zeros(len(imported.as_written))))
    for srid in (info.srid, info.srid - 1, info.srid + 1):  # zones follow each other in EPSG's numbers
        try:
            places_m = to_crs(written, srid, info.srid, None)
        except InputError:  # no such CRS, or no such place in it
            continue
        if not store.far_from_all(conn, info, places_m, FAR_M).all():
            raise InputError(
                f"{imported.source_path}: its coordinates are more than {FAR_M / 1000:g} km from everything on the map "
                f"{info.map_name}; in EPSG:{srid} they would be close to it: state that CRS (--crs EPSG:{srid}), or import them "
                "as they are (--accept); nothing was written"
            )


def _refuse_displaced(conn: Connection, imported: ImportedMap, params: ImportParams, map_name: str) -> None:
    """Refuse positions of another datum, or heights of another system: each would add a second cone next to one of the map."""
    stated = [statement.feature for statement in imported.statements]
    standing = read_current_features(conn, map_name=map_name)
    found = check_same_cones(stated, standing, params.reconcile)
    if found is None or found.value is None:
        return
    where = f"{imported.source_path}: its cones are {abs(found.value):.1f} m"
    sigma = f"with a stated sigma of {found.sigma:.2f} m"
    wrong = "or revert the changeset (conetl map revert) whose"
    accept = "are wrong; --accept imports them as they are; nothing was written"
    if found.check.endswith("heights"):
        raise InputError(
            f"{where} {'higher' if found.value > 0 else 'lower'} than those of the map {map_name} at the same positions, "
            f"{sigma}: give the height system of the file (--crs EPSG:25832+7837), {wrong} heights {accept}"
        )
    raise InputError(
        f"{where} from those of the map {map_name}, which have the same arrangement, {sigma}: give the CRS and datum of the file "
        f"(--crs), {wrong} positions {accept}"
    )
