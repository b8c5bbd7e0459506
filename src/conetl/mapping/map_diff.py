"""Differences between two states of a map, feature by feature."""

from __future__ import annotations

from collections.abc import Iterable
from uuid import UUID

import numpy as np

from conetl.geometry.linear_reference import project
from conetl.model.map_records import DeltaKind, FeatureChange, MapFeature
from conetl.model.params import ReconcileParams

#: A cone whose position differs by more was moved, a lane marking by the second distance across its line; a cone whose height
#: differs by more belongs to another height class.
MOVED_M = ReconcileParams().min_gate_m
LINE_MOVED_M = ReconcileParams().marking_gate_m
HEIGHT_M = ReconcileParams().moved_height_tolerance_m


def diff(before: Iterable[MapFeature], after: Iterable[MapFeature]) -> list[FeatureChange]:
    """Features that differ between both maps, by feature id."""
    old = {feature.feature_id: feature for feature in before}
    new = {feature.feature_id: feature for feature in after}
    return [
        _change(feature_id, old.get(feature_id), new.get(feature_id))
        for feature_id in sorted(old.keys() | new.keys())
        if old.get(feature_id) != new.get(feature_id)
    ]


def _change(feature_id: UUID, old: MapFeature | None, new: MapFeature | None) -> FeatureChange:
    shift_m = None
    if old is None:
        kind = DeltaKind.ADDED
    elif new is None:
        kind = DeltaKind.REMOVED
    else:
        shift_m = _shift_m(old, new)
        kind = _kind_of_change(old, new, shift_m)
    return FeatureChange(kind=kind, feature_id=feature_id, old=old, new=new, shift_m=shift_m)


def _shift_m(old: MapFeature, new: MapFeature) -> float:
    """Horizontal distance of the positions; for a lane marking that from the old line (its middle vertex may be another)."""
    if old.marking is not None:
        _, aside_m = project(np.array(old.marking.vertices_m)[:, :2], np.array([new.xyz_m[:2]]))
        return abs(float(aside_m[0]))
    return float(np.hypot(new.xyz_m[0] - old.xyz_m[0], new.xyz_m[1] - old.xyz_m[1]))


def _kind_of_change(old: MapFeature, new: MapFeature, shift_m: float) -> DeltaKind:
    if shift_m > (MOVED_M if new.marking is None else LINE_MOVED_M):
        return DeltaKind.MOVED
    if abs(new.cone_height_m - old.cone_height_m) > HEIGHT_M:
        return DeltaKind.HEIGHT_CHANGED
    # A miss lowers the existence probability of a version and changes nothing else.
    lower = new.existence_probability < old.existence_probability
    missed = lower and new == old.model_copy(update={"existence_probability": new.existence_probability})
    return DeltaKind.MISSED if missed else DeltaKind.CONFIRMED
