"""Differences between two states of a map, as plain values that can be composed and inverted.

With maps A, B, C: compose(diff(A, B), diff(B, C)) == diff(A, C), invert(diff(A, B)) == diff(B, A), and diff(A, A) is empty (the
laws of koordinates/kart's diff structures).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from conetl.model.map_records import DeltaKind, FeatureChange, MapFeature
from conetl.model.params import ReconcileParams

#: A cone whose position differs by more was moved; one whose height differs by more belongs to another height class.
MOVED_M = ReconcileParams().min_gate_m
HEIGHT_M = ReconcileParams().moved_height_tolerance_m


def diff(before: Iterable[MapFeature], after: Iterable[MapFeature]) -> list[FeatureChange]:
    """Features that differ between both maps, by feature id."""
    old = {feature.feature_id: feature for feature in before}
    new = {feature.feature_id: feature for feature in after}
    return _existing(change(old.get(feature_id), new.get(feature_id)) for feature_id in sorted(old.keys() | new.keys()))


def change(old: MapFeature | None, new: MapFeature | None) -> FeatureChange | None:
    """The difference of one feature; None where both states are equal. Raises ValueError without any state."""
    one = new or old
    if one is None:
        raise ValueError("a feature that is on neither map cannot differ")
    if old == new:
        return None
    shift_m = None
    if old is None:
        kind = DeltaKind.ADDED
    elif new is None:
        kind = DeltaKind.REMOVED
    else:
        shift_m = float(np.hypot(new.xyz_m[0] - old.xyz_m[0], new.xyz_m[1] - old.xyz_m[1]))
        kind = _kind_of_change(old, new, shift_m)
    return FeatureChange(kind=kind, feature_id=one.feature_id, old=old, new=new, shift_m=shift_m)


def _kind_of_change(old: MapFeature, new: MapFeature, shift_m: float) -> DeltaKind:
    if shift_m > MOVED_M:
        return DeltaKind.MOVED
    if abs(new.cone_height_m - old.cone_height_m) > HEIGHT_M:
        return DeltaKind.HEIGHT_CHANGED
    # A miss lowers the existence probability of a version and changes nothing else.
    lower = new.existence_probability < old.existence_probability
    missed = lower and new == old.model_copy(update={"existence_probability": new.existence_probability})
    return DeltaKind.MISSED if missed else DeltaKind.CONFIRMED


def invert(changes: Sequence[FeatureChange]) -> list[FeatureChange]:
    """The changes in the opposite direction."""
    return _existing(change(one.new, one.old) for one in changes)


def compose(first: Sequence[FeatureChange], second: Sequence[FeatureChange]) -> list[FeatureChange]:
    """One difference for two in succession. Raises ValueError where the second does not start where the first ends."""
    ends = {one.feature_id: one for one in first}
    starts = {one.feature_id: one for one in second}
    together = []
    for feature_id in sorted(ends.keys() | starts.keys()):
        a, b = ends.get(feature_id), starts.get(feature_id)
        if a and b and a.new != b.old:
            raise ValueError(f"feature {feature_id}: the second difference does not start where the first ends")
        old = a.old if a else b.old if b else None
        new = b.new if b else a.new if a else None
        if old is not None or new is not None:
            together.append(change(old, new))
    return _existing(together)


def _existing(changes: Iterable[FeatureChange | None]) -> list[FeatureChange]:
    return [found for found in changes if found is not None]
