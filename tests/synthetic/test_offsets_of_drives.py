"""Ten drives, each put aside as a whole by its GNSS/INS: does the map state its errors, and do cones stay together?"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.packing import cov3, cov_matrix
from conetl.mapping.changes import reconcile
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from conetl.model.records import Track
from tests.synthetic.world import ORIGIN_M, START_NS

Floats = NDArray[np.float64]
CONES_M = np.array([[12.0 * k, 3.0 * (k % 2), 0.0] for k in range(5)])
DRIVES, TRIALS = 10, 150


class Figures(NamedTuple):
    """Means over trials."""

    nees_of_first: float
    """Squared error of a cone that all drives saw, in the sigmas that the map states, over 3."""
    nees_of_late: float
    """Of the one that was added later."""
    apart_m: float
    """Root mean square error of the way between the two, horizontally."""


def one_track(index: int, off_m: Floats, drive: int, drive_m: float, cone_m: float) -> Track:
    at = ORIGIN_M + CONES_M[index] + off_m
    seen_ns = START_NS + drive * 86_400_000_000_000
    return Track(
        track_index=index, xyz_m=tuple(at.tolist()), cov_m2=cov3(np.eye(3) * (drive_m**2 + cone_m**2)),
        relative_cov_m2=cov3(np.eye(3) * cone_m**2), centre_xyz_m=tuple(at.tolist()), cone_height_m=0.7, cone_height_sigma_m=0.02,
        existence_probability=0.95, observation_count=10, first_seen_ns=seen_ns, last_seen_ns=seen_ns + 10**9,
        residual_rms_px=0.3, nearest_range_m=7.0, members=((index, 0),),
    )  # fmt: skip


def figures(late_from: int, drive_m: float, cone_m: float) -> Figures:
    """drive_m, cone_m: sigmas of a drive as a whole and of a cone in it, one axis; the last cone is there from that drive on."""
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(TRIALS):
        standing: dict[object, MapFeature] = {}
        for drive in range(DRIVES):
            # An offset beyond four sigmas is not believed, which is right, and would happen to one drive in some thousand.
            gnss_m = np.clip(rng.normal(0, drive_m, 3), -2.5 * drive_m, 2.5 * drive_m)
            tracks = [
                one_track(k, gnss_m + rng.normal(0, cone_m, 3), drive, drive_m, cone_m)
                for k in range(len(CONES_M))
                if k < len(CONES_M) - 1 or drive >= late_from
            ]
            for delta in reconcile(
                tracks, list(standing.values()), lambda *_: None, ReconcileParams(), founding_key=f"drive {drive}"
            ):
                assert delta.new is not None
                standing[delta.feature_id] = delta.new
        assert len(standing) == len(CONES_M)
        nearest = [
            min(standing.values(), key=lambda f: float(np.hypot(*np.subtract(f.xyz_m, place)[:2])))
            for place in ORIGIN_M + CONES_M
        ]
        off = np.array([f.xyz_m for f in nearest]) - ORIGIN_M - CONES_M
        nees = [float(e @ np.linalg.solve(cov_matrix(f.cov_m2), e)) / 3 for e, f in zip(off, nearest, strict=True)]
        rows.append((nees[0], nees[-1], float(np.sum((off[-1] - off[0])[:2] ** 2))))
    first, late, squared = np.mean(rows, axis=0).tolist()
    return Figures(first, late, squared**0.5)


@pytest.mark.parametrize(("drive_m", "cone_m"), [(0.05, 0.01), (0.2, 0.02)], ids=["RTK", "no fix"])
@pytest.mark.parametrize("late_from", [1, 5, 9])
def test_the_map_states_its_errors_and_keeps_cones_together(late_from: int, drive_m: float, cone_m: float) -> None:
    """Where a difference was shared out twice, between drive and map and again between place and place, NEES was above 3."""
    found = figures(late_from, drive_m, cone_m)
    assert 0.8 < found.nees_of_first < 1.25
    assert 0.8 < found.nees_of_late < 1.25
    # What its own sightings allow; the drives as a whole are off by ten times as much.
    assert found.apart_m < 2.0 * cone_m
