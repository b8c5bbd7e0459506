"""What the errors of a drive's tracks have in common with the map's once the drive's offset against the map was taken out.

The offset is what tracks and features of the same cones differ by, so it has the errors of both in it: a track less the share w
of it has the levers A - w mean(A_track - A_feature), the mean taken over the pairs. A cone that a drive from the other side adds
stands in the map's frame, and is off as the map is. Of other errors the drive's own covariance is kept, which is the larger one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.packing import cov3, cov_matrix
from conetl.geometry.shared_calibration import pack_all, unpack_all
from conetl.map_records import MapFeature
from conetl.records import Levers, Track
from conetl.steps.fusion import MOST_CALIBRATIONS, relevered

Floats = NDArray[np.float64]


def without_shift(
    wanted: Iterable[int],
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    pairs: Mapping[int, int],
    weight: float,
) -> dict[int, Track]:
    """The wanted tracks by index, with covariances and levers of their places less `weight` times the drive's offset.

    pairs: feature -> track index, from which the offset is. Where nothing has levers, or no offset was found, tracks are as they
    are.
    """
    own = {i: tracks[i] for i in wanted}
    if weight == 0 or not pairs or not own:
        return own
    summed = _sums([tracks[i].levers for i in pairs.values()], 1.0)
    for calibration, moved_m in _sums([features[j].levers for j in pairs], -1.0).items():
        summed[calibration] = _added(summed.get(calibration), moved_m)
    if not summed:
        return own
    of_offset = {calibration: weight / len(pairs) * moved_m for calibration, moved_m in summed.items()}
    return {i: _less(track, of_offset) for i, track in own.items()}


def _less(track: Track, of_offset: Mapping[UUID, Floats]) -> Track:
    """A track whose place has an error less, with these levers (3, K) by calibration."""
    ids = tuple(sorted({*of_offset, *(track.levers.calibrations if track.levers else ())}))
    before = unpack_all(ids, [track.levers])
    width = max(before.shape[3], *(moved_m.shape[1] for moved_m in of_offset.values()))
    before = np.pad(before, ((0, 0), (0, 0), (0, 0), (0, width - before.shape[3])))
    after = before.copy()
    for calibration, moved_m in of_offset.items():
        after[0, ids.index(calibration), :, : moved_m.shape[1]] -= moved_m
    after = after.astype(np.float32).astype(np.float64)
    cov = relevered(cov_matrix(track.cov_m2)[None], before, after)[0]
    [levers] = pack_all(ids, after, most=MOST_CALIBRATIONS)
    return track.model_copy(update={"cov_m2": cov3((cov + cov.T) / 2), "levers": levers})


def _sums(levers: Sequence[Levers | None], sign: float) -> dict[UUID, Floats]:
    """Sum (3, K) of the levers of each calibration, times the sign."""
    alike: dict[tuple[tuple[UUID, ...], int], list[Levers]] = {}
    for one in levers:
        if one is not None:
            alike.setdefault((one.calibrations, len(one.moved_m)), []).append(one)
    sums: dict[UUID, Floats] = {}
    for (ids, _), some in alike.items():
        for calibration, moved_m in zip(ids, sign * unpack_all(ids, some).sum(axis=0), strict=True):
            sums[calibration] = _added(sums.get(calibration), moved_m)
    return sums


def _added(a: Floats | None, b: Floats) -> Floats:
    """Sum of (3, K) and (3, L), the missing columns being 0."""
    if a is None:
        return b
    wide, narrow = (a, b) if a.shape[1] >= b.shape[1] else (b, a)
    result = wide.copy()
    result[:, : narrow.shape[1]] += narrow
    return result
