"""Where a part of a recording begins, against where the one before it led: driving explains it, jumps do not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.packing import vec3
from conetl.model.drive import FramePair
from conetl.pipeline.compared.adjoining import _misfit_m, _Part
from tests.integration.drives_of_days import RIG
from tests.synthetic.world import make_path, shifted

Floats = NDArray[np.float64]
SECONDS = 20.0


def speeds_of(times_s: Floats) -> Floats:
    """Of a vehicle in town, m/s: it brakes to a stop with 3.5 m/s^2, waits, and pulls away with 2.5 m/s^2."""
    return np.maximum(np.minimum(14.0, np.maximum(14.0 - 3.5 * (times_s - 5.0), 2.5 * (times_s - 11.0))), 0.0)


def driven(hz: float, sigma_m: float, noise_m: float = 0.0) -> list[FramePair]:
    fine_s = np.arange(0.0, SECONDS, 1 / 600)
    along_m = np.cumsum(speeds_of(fine_s)) / 600
    noise = np.random.default_rng(0).normal(0, noise_m, (int(SECONDS * hz), 3))
    first = make_path(1, sigma_m=sigma_m)[0]
    pairs = []
    for k, off_m in enumerate(noise):
        east, north, up = first.pose.map_t_body_m
        along = float(np.interp(k / hz, fine_s, along_m))
        at_m = vec3(np.array([east + along, north, up]) + off_m)
        at_ns = first.captured_at_ns + round(k / hz * 1e9)
        pose = first.pose.model_copy(update={"map_t_body_m": at_m})
        pairs.append(first.model_copy(update={"frame_index": k, "captured_at_ns": at_ns, "pose": pose}))
    return pairs


def largest_m(pairs: list[FramePair], gap: int, jump_m: float = 0.0) -> list[float]:
    """Misfits of the recording cut anywhere, with so many frame pairs lost between the parts."""
    moved = [shifted(pair, (0.0, jump_m, 0.0)) for pair in pairs]
    cuts = range(4, len(pairs) - gap - 4)
    found = [_misfit_m(_Part(RIG, pairs[:cut]), _Part(RIG, moved[cut + gap :])) for cut in cuts]
    return [off_m for off_m in found if off_m is not None]


@pytest.mark.parametrize("gap_s", [0.0, 0.5, 2.0, 4.5])
@pytest.mark.parametrize("hz", [2.0, 10.0, 30.0])
@pytest.mark.parametrize(("sigma_m", "noise_m"), [(0.02, 0.0), (0.3, 0.3)])
def test_braking_waiting_and_pulling_away_are_no_jump(hz: float, gap_s: float, sigma_m: float, noise_m: float) -> None:
    assert max(largest_m(driven(hz, sigma_m, noise_m), round(gap_s * hz))) == 0.0


@pytest.mark.parametrize(("gap_s", "jump_m"), [(0.0, 1.0), (0.5, 3.0), (2.0, 10.0), (4.5, 40.0)])
def test_jumps_beyond_what_a_vehicle_does_are_found(gap_s: float, jump_m: float) -> None:
    found = largest_m(driven(10.0, 0.02), round(gap_s * 10.0), jump_m)
    assert min(found) > 0.8 * jump_m
