"""What differs between two states of a map, as plain values that can be composed and inverted.

With A, B, C maps: compose(diff(A, B), diff(B, C)) == diff(A, C), invert(diff(A, B)) == diff(B, A), and the difference of a map
to itself is empty (the laws of koordinates/kart's diff structures).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from conetl.model.map_records import DeltaKind, FeatureChange, MapFeature
from conetl.model.params import ReconcileParams

#: A cone whose place differs by more was moved; by less, its place is only known better. As in the comparison of drives.
MOVED_M = ReconcileParams().min_gate_m
#: One whose height differs by more is of another class of cones.
HEIGHT_M = ReconcileParams().moved_height_tolerance_m


def diff(before: Iterable[MapFeature], after: Iterable[MapFeature]) -> list[FeatureChange]:
    """Features that are not the same on both maps, by feature id."""
    old = {feature.feature_id: feature for feature in before}
    new = {feature.feature_id: feature for feature in after}
    changes = [change(old.get(feature_id), new.get(feature_id)) for feature_id in sorted(old.keys() | new.keys())]
    return [found for found in changes if found is not None]


def change(old: MapFeature | None, new: MapFeature | None) -> FeatureChange | None:
    """The difference of one feature; None where there is none. At least one side must be there."""
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
        kind = _kind_of_standing(old, new, shift_m)
    return FeatureChange(kind=kind, feature_id=one.feature_id, old=old, new=new, shift_m=shift_m)


def _kind_of_standing(old: MapFeature, new: MapFeature, shift_m: float) -> DeltaKind:
    """What happened to a feature that is on both maps."""
    if shift_m > MOVED_M:
        return DeltaKind.MOVED
    if abs(new.cone_height_m - old.cone_height_m) > HEIGHT_M:
        return DeltaKind.HEIGHT_CHANGED
    return DeltaKind.MISSED if _is_only_less_believed(old, new) else DeltaKind.CONFIRMED


def _is_only_less_believed(old: MapFeature, new: MapFeature) -> bool:
    """A drive that looks in vain lowers the belief in a version and changes nothing else; one that sees the cone makes another
    version."""
    if new.existence_probability >= old.existence_probability:
        return False
    return new == old.model_copy(update={"existence_probability": new.existence_probability})


def invert(changes: Sequence[FeatureChange]) -> list[FeatureChange]:
    """The changes that lead back."""
    turned = [change(one.new, one.old) for one in changes]
    return [found for found in turned if found is not None]


def compose(first: Sequence[FeatureChange], second: Sequence[FeatureChange]) -> list[FeatureChange]:
    """One difference for two that follow each other. Raises ValueError where the second does not start where the first ends."""
    ends: Mapping[object, FeatureChange] = {one.feature_id: one for one in first}
    starts: Mapping[object, FeatureChange] = {one.feature_id: one for one in second}
    together = []
    for feature_id in sorted({*ends, *starts}, key=str):
        a, b = ends.get(feature_id), starts.get(feature_id)
        if a and b and a.new != b.old:
            raise ValueError(f"feature {feature_id}: the second difference does not start where the first ends")
        old = a.old if a else b.old if b else None
        new = b.new if b else a.new if a else None
        if old is not None or new is not None:
            together.append(change(old, new))
    return sorted((found for found in together if found is not None), key=lambda found: found.feature_id)
