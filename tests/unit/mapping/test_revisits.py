"""Cones that a drive passes twice: displaced together they are a finding; noisy, or some of them moved, they are none."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.checks.verdict import judge
from conetl.geometry.packing import vec3
from conetl.mapping.revisits import check_revisits
from conetl.model.health import HealthCheck
from conetl.model.params import IngestParams
from tests import records
from tests.synthetic.world import ORIGIN_M, make_path

#: At unequal distances.
ZONE = np.array([(5.0 * k + 0.4 * (k % 3), 3.6 - 0.4 * k, 0.0) for k in range(8)])
#: Pairs of each pass, five of each cone.
FRAMES, SEEN, AGAIN_NS = 40, 5, 60 * 10**9


def found(
    second: NDArray[np.float64], *, sigma_m: float = 0.03, joined: Collection[int] = (), backwards: bool = False
) -> HealthCheck | None:
    """What the check finds in a drive that passes `ZONE` and, a minute later, cones at `second`.

    joined: cones whose positions of both passes are one track. backwards: in the other order.
    """
    rng = np.random.default_rng(0)
    path = make_path(2 * FRAMES)
    path[FRAMES:] = [p.model_copy(update={"captured_at_ns": p.captured_at_ns + AGAIN_NS}) for p in path[FRAMES:]]
    at_ns = [pair.captured_at_ns for pair in path]
    passes = [[], []]
    positions = []
    for number, feet in enumerate((ZONE, second)):
        for k, foot in enumerate(feet):
            place = len(feet) - 1 - k if backwards and number else k
            frames = range(number * FRAMES + SEEN * place, number * FRAMES + SEEN * (place + 1))
            xyz_m = vec3(ORIGIN_M + foot + rng.normal(0, 0.01, 3))
            stated = {"xyz_m": xyz_m, "cov_m2": records.cov_of(sigma_m)}
            positions += [records.position(frame, **stated) for frame in frames]
            members = tuple((frame, 0) for frame in frames)
            times = {"first_seen_ns": at_ns[frames[0]], "last_seen_ns": at_ns[frames[-1]]}
            passes[number].append(records.track(k, members=members, **stated, **times))
    tracks = []
    for k, (one, other) in enumerate(zip(*passes, strict=True)):
        if k in joined:
            mean = vec3(np.mean([one.xyz_m, other.xyz_m], axis=0))
            update = {"xyz_m": mean, "members": one.members + other.members, "last_seen_ns": other.last_seen_ns}
            tracks.append(one.model_copy(update=update))
        else:
            tracks += [one, other]
    return next(map(judge, check_revisits(tracks, positions, path, IngestParams())), None)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("joined", [(), range(8), (1, 4, 5)], ids=["no", "all", "some"])
@pytest.mark.parametrize("error_m", [(0.0, 0.3, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.4), (2.0, 2.0, 0.0)])
def test_a_common_displacement_is_found(
    error_m: tuple[float, float, float], joined: Collection[int], backwards: bool
) -> None:
    check = found(ZONE + error_m, joined=joined, backwards=backwards)
    assert check is not None and check.value == pytest.approx(np.linalg.norm(error_m), abs=0.03)
    assert f"passes 8 cones again from frame pair {FRAMES} on" in check.detail
    assert ("higher or lower" in check.detail) == bool(error_m[2])


@pytest.mark.parametrize("joined", [(), range(8)], ids=["no", "all"])
def test_cones_at_the_same_positions_are_none(joined: Collection[int]) -> None:
    assert found(ZONE, joined=joined) is None


def test_a_displacement_within_the_stated_sigmas_is_none() -> None:
    assert found(ZONE + np.array((0.0, 0.4, 0.0)), sigma_m=0.1) is None


@pytest.mark.parametrize("seed", range(5))
def test_some_cones_that_people_moved_meanwhile_are_none(seed: int) -> None:
    moved_m = np.random.default_rng(seed).uniform(-1.5, 1.5, ZONE.shape) * (1, 1, 0)
    assert found(ZONE + np.where(np.arange(len(ZONE))[:, None] % 3 == 1, moved_m, 0.0)) is None


@pytest.mark.parametrize("backwards", [False, True])
def test_a_drift_displaces_every_cone_by_another_distance(backwards: bool) -> None:
    check = found(ZONE + np.linspace(0.2, 0.8, len(ZONE))[:, None] * (1, 0, 0), backwards=backwards)
    assert check is not None and check.value == pytest.approx(0.5, abs=0.03)


def test_a_continuation_of_the_row_is_none() -> None:
    assert found(ZONE + np.array((42.0, -3.6, 0.0))) is None


def test_another_level_of_the_road_is_none() -> None:
    assert found((ZONE - (15.0, 2.0, 0.0)) @ np.array([(0, 1, 0), (-1, 0, 0), (0, 0, 1.0)]) + (15.0, 2.0, 8.0)) is None
