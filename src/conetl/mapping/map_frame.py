"""Tracks of a drive put into the map's frame, where they stand by themselves: what their places are known to there.

The drive's offset is what tracks and features of the same cones differ by. Its share w taken out of a track leaves 1 - w of the
drive's own common error, w of the map's, and the errors of the track itself (`relative_cov_m2`). With the drive's whole
covariance instead, a cone that a drive without a fix adds to a well-known row would be moved by the next one as if nothing were
known of it, away from the row. The shared_jacobian of the calibration go the same way, A - w mean(A_track - A_feature): what a
drive from the other side adds is off as the map is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.calibration.shared import pack_all, unpack_all
from conetl.geometry.packing import cov3, cov_matrix
from conetl.mapping.fusion import MOST_CALIBRATIONS, own_parts, with_jacobian
from conetl.model.map_records import MapFeature
from conetl.model.records import SharedErrorJacobian, Track

Floats = NDArray[np.float64]


def placed_tracks(
    wanted: Iterable[int],
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    pairs: Mapping[int, int],
    weight: float,
) -> dict[int, Track]:
    """The wanted tracks by index, with covariances and shared_jacobian of their places less `weight` times the drive's offset.

    pairs: feature -> track index, from which the offset is. Tracks are as they are where no offset was found.
    """
    own = {i: tracks[i] for i in wanted}
    if weight == 0 or not pairs or not own:
        return own
    seen = [features[j] for j in pairs]
    of_map = weight**2 * own_parts([f.cov_m2 for f in seen], [f.shared_jacobian for f in seen]).mean(axis=0)
    summed = _sums([tracks[i].shared_jacobian for i in pairs.values()], 1.0)
    for calibration, moved_m in _sums([f.shared_jacobian for f in seen], -1.0).items():
        summed[calibration] = _added(summed.get(calibration), moved_m)
    of_offset = {calibration: weight / len(pairs) * moved_m for calibration, moved_m in summed.items()}
    return {i: _placed(track, of_map, of_offset, weight) for i, track in own.items()}


def _placed(track: Track, of_map: Floats, of_offset: Mapping[UUID, Floats], weight: float) -> Track:
    """A track less the offset, which has these shared_jacobian (3, K) by calibration; of_map (3, 3) m^2: what comes with it of
    the map."""
    relative = cov_matrix(track.relative_cov_m2)
    [whole] = own_parts([track.cov_m2], [track.shared_jacobian])
    # Without the calibration's part; of GNSS/INS, all cones of the drive have the same error.
    own = relative + (1 - weight) ** 2 * (whole - relative) + of_map
    ids = tuple(sorted({*of_offset, *(track.shared_jacobian.calibrations if track.shared_jacobian else ())}))
    before = unpack_all(ids, [track.shared_jacobian])
    width = max([before.shape[3], *(moved_m.shape[1] for moved_m in of_offset.values())])
    after = np.pad(before, ((0, 0), (0, 0), (0, 0), (0, width - before.shape[3])))
    for calibration, moved_m in of_offset.items():
        after[0, ids.index(calibration), :, : moved_m.shape[1]] -= moved_m
    after = after.astype(np.float32).astype(np.float64)  # as it is kept
    [cov] = with_jacobian(own[None], after)
    [shared_jacobian] = pack_all(ids, after, most=MOST_CALIBRATIONS)
    return track.model_copy(update={"cov_m2": cov3((cov + cov.T) / 2), "shared_jacobian": shared_jacobian})


def _sums(shared_jacobian: Sequence[SharedErrorJacobian | None], sign: float) -> dict[UUID, Floats]:
    """Sum (3, K) of the shared_jacobian of each calibration, times the sign."""
    alike: dict[tuple[tuple[UUID, ...], int], list[SharedErrorJacobian]] = {}
    for one in shared_jacobian:
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
