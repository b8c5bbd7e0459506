"""Tracks put into the map's frame: what their places are known to there."""

from __future__ import annotations

from uuid import UUID

import numpy as np
import pytest

from conetl.geometry.calibration.shared import pack_all, unpack_all
from conetl.geometry.packing import cov3, cov_matrix
from conetl.mapping.map_frame import placed_tracks
from conetl.model.map_records import MapFeature
from conetl.model.records import SharedErrorJacobian, Track
from tests.unit.mapping.test_changes import feature, track

ONE, OTHER = UUID(int=1), UUID(int=2)
RELATIVE_M2, DRIVE_M2, MAP_M2 = 0.01**2, 0.3**2, 0.05**2


def shared_jacobian(**moved_m: list[float]) -> SharedErrorJacobian | None:
    """Of the calibrations `one` and `other`, a row of the errors' ways to the east each."""
    ids = tuple(UUID(int=("one", "other").index(name) + 1) for name in sorted(moved_m))
    east = np.array(list(moved_m.values()))
    return pack_all(ids, np.stack([east, 0 * east, 0 * east], axis=1)[None])[0]


def seen(number: int, own: SharedErrorJacobian | None = None) -> Track:
    moved = unpack_all(own.calibrations, [own])[0] if own else np.zeros((1, 3, 1))
    cov = (RELATIVE_M2 + DRIVE_M2) * np.eye(3) + sum(a @ a.T for a in moved)
    update = {"cov_m2": cov3(cov), "relative_cov_m2": cov3(RELATIVE_M2 * np.eye(3)), "shared_jacobian": own}
    return track(number, 5.0 * number, 3.0).model_copy(update=update)


def known(number: int, own: SharedErrorJacobian | None = None) -> MapFeature:
    moved = unpack_all(own.calibrations, [own])[0] if own else np.zeros((1, 3, 1))
    cov = MAP_M2 * np.eye(3) + sum(a @ a.T for a in moved)
    return feature(number, 5.0 * number, 3.0).model_copy(update={"cov_m2": cov3(cov), "shared_jacobian": own})


def test_a_place_less_the_offset_has_errors_of_the_drive_and_of_the_map() -> None:
    tracks = [seen(k) for k in range(3)]
    placed = placed_tracks([2], tracks, [known(0), known(1)], {0: 0, 1: 1}, weight=0.75)
    assert list(placed) == [2]
    wanted = RELATIVE_M2 + 0.25**2 * DRIVE_M2 + 0.75**2 * MAP_M2
    np.testing.assert_allclose(cov_matrix(placed[2].cov_m2), wanted * np.eye(3), rtol=1e-9, atol=1e-15)
    assert placed[2].shared_jacobian is None
    assert placed[2].xyz_m == tracks[2].xyz_m, "where it is, the comparison knows"


@pytest.mark.parametrize(("pairs", "weight"), [({}, 0.5), ({0: 0}, 0.0)])
def test_without_an_offset_tracks_are_as_they_are(pairs: dict[int, int], weight: float) -> None:
    tracks = [seen(0, shared_jacobian(one=[0.1])), seen(1)]
    placed = placed_tracks([0, 1], tracks, [known(0)], pairs, weight)
    assert all(placed[i] is tracks[i] for i in (0, 1))


def test_levers_are_those_of_the_drive_less_those_of_its_difference_from_the_map() -> None:
    """The drive errs to the east, the map the other way for the same calibration, and as another one does."""
    tracks = [
        seen(0, shared_jacobian(one=[0.1, 0.02])),
        seen(1, shared_jacobian(one=[0.1, 0.02])),
        seen(2, shared_jacobian(one=[0.2, 0.02])),
    ]
    features = [known(0, shared_jacobian(one=[-0.1], other=[0.04])), known(1, shared_jacobian(one=[-0.1]))]
    placed = placed_tracks([2], tracks, features, {0: 0, 1: 1}, weight=0.5)[2]
    assert placed.shared_jacobian is not None and placed.shared_jacobian.calibrations == (ONE, OTHER)
    moved = unpack_all((ONE, OTHER), [placed.shared_jacobian])[0]
    np.testing.assert_allclose(moved[:, 0], [[0.2 - 0.5 * 0.2, 0.02 - 0.5 * 0.02], [0.5 * 0.02, 0.0]], rtol=1e-6)
    own = cov_matrix(placed.cov_m2) - sum(a @ a.T for a in moved)
    wanted = RELATIVE_M2 + 0.25 * DRIVE_M2 + 0.25 * MAP_M2
    np.testing.assert_allclose(own, wanted * np.eye(3), rtol=1e-5, atol=1e-9)
