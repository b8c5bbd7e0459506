"""Drives that contradict the map by a small displacement: both get sigmas that cover it.

A wrong lever arm, base station or datum moves all cones of a drive alike. If it is known without doubt which cones are the same,
the drive is fused with the map, and the sigmas of both are enlarged by the displacement (`fusion.EXCESS`): it does not matter
which of the two was first, or right. Larger displacements, those of a part, and those of cones that stand too near to each other
are left to `displacement.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from conetl.geometry.packing import cov3, cov_matrix, vec3
from conetl.mapping.association import Offset, best_offset, classes_of, xyz_of
from conetl.mapping.displacement import HEIGHTS, POSITION
from conetl.mapping.fusion import difference_cov
from conetl.model.arrays import Floats
from conetl.model.drive import Track
from conetl.model.health import Finding
from conetl.model.map_records import MapFeature
from conetl.model.params import AgreementParams, ReconcileParams


class Contradiction(NamedTuple):
    """A displacement of a drive against the map that exceeds the stated sigmas of both."""

    offset_m: Floats
    """(3,) metres: the drive's cones less those of the map."""
    finding: Finding

    @property
    def excess_m2(self) -> Floats:
        """(3, 3): by this both sigmas are too small."""
        return np.outer(self.offset_m, self.offset_m)

    def on_map(self, track: Track) -> Track:
        """The track where the map has its cone, with sigmas that cover both positions."""
        return track.model_copy(
            update={
                "xyz_m": vec3(np.array(track.xyz_m) - self.offset_m),
                "centre_xyz_m": vec3(np.array(track.centre_xyz_m) - self.offset_m),
                "cov_m2": cov3(cov_matrix(track.cov_m2) + self.excess_m2),
            }
        )


def find_contradiction(
    tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams
) -> Contradiction | None:
    """The displacement of a drive's cones; None if the sigmas cover it, or if it is not sure that it is one. No order matters."""
    sure = sorted(
        (track for track in tracks if track.existence_probability >= params.founding_existence_probability),
        key=lambda track: track.members[0],
    )
    on_map = sorted(features, key=lambda feature: feature.feature_id.int)
    limits, reach_m = params.agreement, params.agreement.widened_max_m
    if min(len(sure), len(on_map)) < limits.least_pairs or _agrees(sure, on_map, limits):
        return None
    found = best_offset(sure, on_map, params, reach_m, reach_m**2)
    if found is None or not _is_sure(found, sure, on_map, params):
        return None
    some, same = [sure[i] for i in found.tracks.tolist()], [on_map[j] for j in found.features.tolist()]
    cov_m2 = difference_cov(
        [one.cov_m2 for one in same], [one.shared_jacobian for one in same],
        [one.cov_m2 for one in some], [one.shared_jacobian for one in some],
    ).mean(axis=0)  # fmt: skip
    offset_m = found.offset_m.copy()
    for axes in (slice(2), slice(2, 3)):
        if (
            _chi2(offset_m, cov_m2, axes) <= limits.sigmas**2
            or np.linalg.norm(offset_m[axes]) <= limits.widened_least_m
        ):
            offset_m[axes] = 0.0
    return Contradiction(offset_m, _finding(offset_m, cov_m2, limits)) if offset_m.any() else None


def _agrees(tracks: Sequence[Track], features: Sequence[MapFeature], limits: AgreementParams) -> bool:
    """Whether most cones stand where the map has one: nothing to search for."""
    t, f = xyz_of(tracks), xyz_of(features)
    distance_m, nearest = cKDTree(f[:, :2]).query(t[:, :2])
    up_m = np.abs(t[:, 2] - f[nearest, 2])
    return bool(np.median(np.maximum(distance_m, up_m)) <= limits.widened_least_m)


def _is_sure(found: Offset, tracks: Sequence[Track], features: Sequence[MapFeature], params: ReconcileParams) -> bool:
    """Whether it is known which cones are the same, and that they have one displacement."""
    t, f = xyz_of(tracks), xyz_of(features)
    count, limits, reach_m = len(found.tracks), params.agreement, params.agreement.widened_max_m
    same_class = classes_of(tracks)[:, None] == np.unique(classes_of(features))
    beside = np.flatnonzero(cKDTree(f[:, :2]).query(t[:, :2])[0] <= reach_m + params.min_gate_m)
    if count < max(limits.least_pairs, limits.least_share * np.count_nonzero(same_class[beside].any(axis=1))):
        return False
    if len(np.unique(found.features)) < count or abs(found.offset_m[2]) > reach_m:
        return False
    left_m = t[found.tracks] - f[found.features] - found.offset_m
    if np.sqrt((left_m**2).sum(axis=1).mean()) > 2 * limits.same_zone_m:
        return False
    spacing_m = np.asarray(cKDTree(f[:, :2]).query(f[found.features, :2], 2)[0])[:, 1]
    return bool(spacing_m.min() >= limits.widened_spacing * np.linalg.norm(found.offset_m[:2]))


def _chi2(offset_m: Floats, cov_m2: Floats, axes: slice) -> float:
    return float(offset_m[axes] @ np.linalg.solve(cov_m2[axes, axes], offset_m[axes]))


def _finding(offset_m: Floats, cov_m2: Floats, limits: AgreementParams) -> Finding:
    level_m, up_m = float(np.hypot(*offset_m[:2])), float(offset_m[2])
    apart = [f"{level_m:.2f} m from"] * (level_m > 0)
    apart += [f"{abs(up_m):.2f} m {'higher' if up_m > 0 else 'lower'} than"] * (up_m != 0)
    axes = slice(2) if level_m else slice(2, 3)
    sigma_m = (level_m or abs(up_m)) / _chi2(offset_m, cov_m2, axes) ** 0.5  # in its direction
    return Finding(
        check=POSITION if level_m else HEIGHTS, value=level_m or up_m, sigma=sigma_m,
        limit=max(limits.widened_least_m, limits.sigmas * sigma_m), found=False, treated="widened",
        says=("widened",), facts={"apart": " and ".join(apart)},
    )  # fmt: skip
