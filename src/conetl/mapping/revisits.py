"""Whether a drive that passes the same cones twice shows them at the same positions: GNSS/INS may drift or jump in between."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from conetl.mapping.association import xyz_of
from conetl.mapping.displacement import HEIGHTS, check_same_cones
from conetl.model.drive import FramePair, Position, Track
from conetl.model.health import Finding
from conetl.model.params import IngestParams, TrackParams


def check_revisits(
    tracks: Sequence[Track], positions: Sequence[Position], pairs: Sequence[FramePair], params: IngestParams
) -> Iterator[Finding]:
    """The common displacement of cones that the drive passes twice, if it is beyond their stated sigmas.

    positions: from which the tracks were computed. Cones that people moved are not displaced by equal distances.
    """
    located = {(position.frame_index, position.match_index): position for position in positions}
    at_ns = {pair.frame_index: pair.captured_at_ns for pair in pairs}
    sure = (track for track in tracks if track.existence_probability >= params.reconcile.founding_existence_probability)
    own = params.reconcile.agreement
    again_ns = round(own.again_s * 1e9)
    visits = [visit for track in sure for visit in _visits(track, located, at_ns, params.track, again_ns)]
    visits.sort(key=lambda visit: (visit.first_seen_ns, visit.xyz_m))
    if not visits:
        return
    tree = cKDTree(xyz_of(visits))
    near = [tree.query_ball_point(visit.xyz_m, own.again_m) for visit in visits]
    limits = params.reconcile.model_copy(update={"min_gate_m": own.again_gate_m})
    starts = [0]
    for k, visit in enumerate(visits):
        if any(j >= starts[-1] and visit.first_seen_ns - visits[j].last_seen_ns > again_ns for j in near[k]):
            starts.append(k)
    for start, end in pairwise([*starts[1:], len(visits)]):
        again = [visits[k] for k in range(start, end) if min(near[k]) < start]
        if len(again) < own.least_pairs:
            continue
        apart = check_same_cones(again, visits[:start], limits, "passed again")
        if apart is None:
            continue
        how = "higher or lower than before" if apart.check == HEIGHTS else "from where they were"
        facts = {"count": len(again), "first": again[0].members[0][0], "how": how}
        yield apart.model_copy(update={"check": "cones passed twice", "says": ("",), "facts": facts})
        return


def _visits(
    track: Track,
    located: Mapping[tuple[int, int], Position],
    at_ns: Mapping[int, int],
    limits: TrackParams,
    again_ns: int,
) -> Iterator[Track]:
    """The track as each pass alone shows it, by its nearest position; without passes that show too little for a track."""
    members = [located[member] for member in track.members if member in located]
    times_ns = np.array([at_ns[position.frame_index] for position in members], dtype=np.int64)
    ends = np.flatnonzero(np.diff(times_ns) > again_ns) + 1
    if not len(ends):
        yield track
        return
    for visit in np.split(np.arange(len(members)), ends):
        seen = [members[k] for k in visit]
        nearest = min(seen, key=lambda position: position.range_m)
        if len(seen) < limits.min_observations or nearest.range_m > limits.max_range_m:
            continue
        yield track.model_copy(update={
            "xyz_m": nearest.xyz_m, "cov_m2": nearest.cov_m2, "members": tuple((p.frame_index, p.match_index) for p in seen),
            "first_seen_ns": int(times_ns[visit[0]]), "last_seen_ns": int(times_ns[visit[-1]]),
        })  # fmt: skip
