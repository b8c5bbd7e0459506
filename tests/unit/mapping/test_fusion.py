"""Fusion of two estimates of one position: laws of gains, covariances and shared-error Jacobians; tracks in the map frame."""

from __future__ import annotations

from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from conetl.geometry.calibration.covariance import pack_jacobians, unpack_jacobians
from conetl.geometry.packing import cov3, cov_matrix
from conetl.mapping.fusion import MOST_CALIBRATIONS, difference_cov, fuse, tracks_in_map_frame
from conetl.model.base import Cov3, SharedErrorJacobian
from conetl.model.drive import Track
from conetl.model.map_records import MapFeature
from tests.unit.mapping.test_changes import feature, track

Floats = NDArray[np.float64]
Estimate = tuple[Cov3, SharedErrorJacobian | None]
CALIBRATIONS = [UUID(int=k) for k in range(1, 20)]


def rounded(values: Floats) -> Floats:
    """As Jacobians are stored."""
    return values.astype(np.float32).astype(np.float64)


def spd(rng: np.random.Generator, size_m: float) -> Floats:
    root = rng.normal(0, size_m, (3, 3))
    return np.asarray(root @ root.T + 0.01 * size_m**2 * np.eye(3))


def shared_jacobian(moved_m: dict[UUID, Floats]) -> SharedErrorJacobian | None:
    ids = tuple(sorted(moved_m))
    return pack_jacobians(ids, np.stack([moved_m[one] for one in ids])[None])[0] if ids else None


def estimate(own: Floats, moved_m: dict[UUID, Floats]) -> Estimate:
    return cov3(own + sum((a @ a.T for a in moved_m.values()), np.zeros((3, 3)))), shared_jacobian(moved_m)


def fused(old: Estimate, new: Estimate) -> tuple[Floats, Floats, Estimate]:
    [gain], [cov_m2], [jacobian], _ = fuse([old[0]], [old[1]], [new[0]], [new[1]])
    return gain, cov_m2, (cov3(cov_m2), jacobian)


def by_formula(old: Estimate, new: Estimate) -> tuple[Floats, Floats]:
    """Gain and covariance by the formulas of Bar-Shalom & Campo, calibration by calibration."""
    p1, p2 = cov_matrix(old[0]), cov_matrix(new[0])
    a, b = (
        dict(zip(s[1].calibrations, unpack_jacobians(s[1].calibrations, [s[1]])[0], strict=True)) if s[1] else {}
        for s in (old, new)
    )
    c = np.zeros((3, 3))
    for one in a.keys() & b.keys():
        width = min(a[one].shape[1], b[one].shape[1])
        c += a[one][:, :width] @ b[one][:, :width].T
    gain = (p1 - c) @ np.linalg.inv(p1 + p2 - c - c.T)
    rest = np.eye(3) - gain
    cov = rest @ p1 @ rest.T + gain @ p2 @ gain.T + rest @ c @ gain.T + gain @ c.T @ rest.T
    return gain, cov


@st.composite
def estimates(draw: st.DrawFn) -> tuple[Estimate, Estimate]:
    """Two estimates of drives with up to three calibrations each, partly the same, with different numbers of errors."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    chosen = st.sets(st.sampled_from(CALIBRATIONS[:4]), max_size=3)
    pair = []
    for _ in range(2):
        own_m, errors = draw(st.sampled_from([0.003, 0.02, 0.3])), draw(st.integers(1, 6))
        size_m = draw(st.sampled_from([0.0, 0.01, 0.2]))
        moved = {one: rounded(rng.normal(0, size_m, (3, errors))) for one in draw(chosen)}
        pair.append(estimate(spd(rng, own_m), moved))
    return pair[0], pair[1]


@settings(max_examples=200, deadline=None)
@given(estimates())
def test_weights_and_covariances_are_those_of_the_formula(pair: tuple[Estimate, Estimate]) -> None:
    gain, cov, (_, kept) = fused(*pair)
    wanted_gain, wanted = by_formula(*pair)
    scale = float(np.trace(wanted))
    np.testing.assert_allclose(gain, wanted_gain, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(cov, wanted, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_array_equal(cov, cov.T)
    assert np.linalg.eigvalsh(cov).min() > 0
    # No worse than either alone, whatever they have in common.
    for one in pair:
        assert np.linalg.eigvalsh(cov_matrix(one[0]) - cov).min() > -1e-6 * float(np.trace(cov_matrix(one[0])))
    if kept is not None:
        moved = unpack_jacobians(kept.calibrations, [kept])[0]
        assert np.linalg.eigvalsh(cov - sum(a @ a.T for a in moved)).min() > -1e-7 * scale


@settings(max_examples=100, deadline=None)
@given(estimates())
def test_the_covariance_of_a_difference_is_without_what_both_share(pair: tuple[Estimate, Estimate]) -> None:
    (old_cov, old), (new_cov, new) = pair
    [cov] = difference_cov([old_cov], [old], [new_cov], [new])
    np.testing.assert_array_equal(cov, fuse([old_cov], [old], [new_cov], [new]).difference_m2[0])
    gain, _ = by_formula(*pair)
    _, fused_cov, _ = fused(*pair)
    # The covariance after the fusion is that before less gain times the difference's times gain'.
    expected = cov_matrix(old_cov) - gain @ cov @ gain.T
    scale = float(np.trace(cov_matrix(old_cov)))
    np.testing.assert_allclose(fused_cov, expected, rtol=1e-4, atol=1e-5 * scale)


def test_jacobians_of_opposite_sides_cancel_and_independent_parts_average() -> None:
    a = np.array([[0.2], [0.0], [0.05]])
    own = 0.02**2 * np.eye(3)
    _, cov, (_, kept) = fused(
        estimate(own, {CALIBRATIONS[0]: rounded(a)}), estimate(own, {CALIBRATIONS[0]: rounded(-a)})
    )
    assert kept is not None
    np.testing.assert_allclose(unpack_jacobians(kept.calibrations, [kept])[0, 0], 0, atol=1e-7)
    np.testing.assert_allclose(cov, own / 2, rtol=1e-6, atol=1e-12)


def test_two_estimates_with_calibration_errors_only_have_equal_gains() -> None:
    one = {CALIBRATIONS[0]: rounded(np.diag([0.1, 0.2, 0.3]))}
    state = estimate(np.zeros((3, 3)), one)
    gain, cov, _ = fused(state, state)
    np.testing.assert_allclose(gain, 0.5 * np.eye(3), atol=1e-6)
    np.testing.assert_allclose(cov, cov_matrix(state[0]), rtol=1e-6, atol=1e-9)


def test_only_the_largest_jacobians_are_kept() -> None:
    rng = np.random.default_rng(0)
    state = estimate(spd(rng, 0.02), {})
    for number, calibration in enumerate(CALIBRATIONS):
        moved = rounded(np.full((3, 2), 0.001 * (1 + number)))
        _, cov, state = fused(state, estimate(spd(rng, 0.05), {calibration: moved}))
        assert np.linalg.eigvalsh(cov).min() > 0
    assert state[1] is not None
    assert len(state[1].calibrations) == MOST_CALIBRATIONS
    assert list(state[1].calibrations) == sorted(state[1].calibrations)
    assert CALIBRATIONS[0] not in state[1].calibrations


def test_rows_do_not_depend_on_the_rows_beside_them() -> None:
    """Otherwise a late drive would give other last digits than one in order."""
    rng = np.random.default_rng(5)
    rows = []
    for k in range(20):
        moved = [{one: rounded(rng.normal(0, 0.05, (3, 5))) for one in CALIBRATIONS[: k % n]} for n in (3, 4)]
        rows.append((estimate(spd(rng, 0.02), moved[0]), estimate(spd(rng, 0.02), moved[1])))
    gains, covs_m2, jacobians, _ = fuse(
        [o[0] for o, _ in rows], [o[1] for o, _ in rows], [n[0] for _, n in rows], [n[1] for _, n in rows]
    )
    for k, (old, new) in enumerate(rows):
        [gain], [cov_m2], [jacobian], _ = fuse([old[0]], [old[1]], [new[0]], [new[1]])
        np.testing.assert_array_equal(gain, gains[k])
        np.testing.assert_array_equal(cov_m2, covs_m2[k])
        assert jacobian == jacobians[k]
    assert jacobians[0] is None


ONE, OTHER = UUID(int=1), UUID(int=2)
RELATIVE_M2, DRIVE_M2, MAP_M2 = 0.01**2, 0.3**2, 0.05**2


def eastwards(**moved_m: list[float]) -> SharedErrorJacobian | None:
    """Of the calibrations `one` and `other`, the shift to the east by each error."""
    ids = {"one": ONE, "other": OTHER}
    return shared_jacobian(
        {ids[k]: np.array([east, np.zeros(len(east)), np.zeros(len(east))]) for k, east in moved_m.items()}
    )


def in_drive(number: int, own: SharedErrorJacobian | None = None) -> Track:
    cov = cov3((RELATIVE_M2 + DRIVE_M2) * np.eye(3) + shared_part(own))
    update = {"cov_m2": cov, "relative_cov_m2": cov3(RELATIVE_M2 * np.eye(3)), "shared_jacobian": own}
    return track(number, 5.0 * number, 3.0).model_copy(update=update)


def on_map(number: int, own: SharedErrorJacobian | None = None) -> MapFeature:
    update = {"cov_m2": cov3(MAP_M2 * np.eye(3) + shared_part(own)), "shared_jacobian": own}
    return feature(number, 5.0 * number, 3.0).model_copy(update=update)


def shared_part(own: SharedErrorJacobian | None) -> Floats:
    moved = unpack_jacobians(own.calibrations, [own])[0] if own else np.zeros((1, 3, 1))
    return np.asarray(sum(a @ a.T for a in moved))


def test_a_track_less_the_offset_has_errors_of_the_drive_and_of_the_map() -> None:
    tracks = [in_drive(k) for k in range(3)]
    moved_to_map = tracks_in_map_frame([2], tracks, [on_map(0), on_map(1)], {0: 0, 1: 1}, weight=0.75)
    assert list(moved_to_map) == [2]
    wanted = RELATIVE_M2 + 0.25**2 * DRIVE_M2 + 0.75**2 * MAP_M2
    np.testing.assert_allclose(cov_matrix(moved_to_map[2].cov_m2), wanted * np.eye(3), rtol=1e-9, atol=1e-15)
    assert moved_to_map[2].shared_jacobian is None
    assert moved_to_map[2].xyz_m == tracks[2].xyz_m, "only the covariance changes"


@pytest.mark.parametrize(("pairs", "weight"), [({}, 0.5), ({0: 0}, 0.0)])
def test_without_an_offset_tracks_are_unchanged(pairs: dict[int, int], weight: float) -> None:
    tracks = [in_drive(0, eastwards(one=[0.1])), in_drive(1)]
    moved_to_map = tracks_in_map_frame([0, 1], tracks, [on_map(0)], pairs, weight)
    assert all(moved_to_map[i] is tracks[i] for i in (0, 1))


def test_jacobians_are_those_of_the_drive_less_those_of_its_difference_from_the_map() -> None:
    """The drive errs to the east, the map the other way for the same calibration, and as another one does."""
    tracks = [
        in_drive(0, eastwards(one=[0.1, 0.02])),
        in_drive(1, eastwards(one=[0.1, 0.02])),
        in_drive(2, eastwards(one=[0.2, 0.02])),
    ]
    features = [on_map(0, eastwards(one=[-0.1], other=[0.04])), on_map(1, eastwards(one=[-0.1]))]
    moved_to_map = tracks_in_map_frame([2], tracks, features, {0: 0, 1: 1}, weight=0.5)[2]
    assert moved_to_map.shared_jacobian is not None and moved_to_map.shared_jacobian.calibrations == (ONE, OTHER)
    moved = unpack_jacobians((ONE, OTHER), [moved_to_map.shared_jacobian])[0]
    np.testing.assert_allclose(moved[:, 0], [[0.2 - 0.5 * 0.2, 0.02 - 0.5 * 0.02], [0.5 * 0.02, 0.0]], rtol=1e-6)
    own = cov_matrix(moved_to_map.cov_m2) - sum(a @ a.T for a in moved)
    wanted = RELATIVE_M2 + 0.25 * DRIVE_M2 + 0.25 * MAP_M2
    np.testing.assert_allclose(own, wanted * np.eye(3), rtol=1e-5, atol=1e-9)
