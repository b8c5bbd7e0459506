"""What the check of the clocks advises: a searched offset that the analysis refines is no fault of the recorder."""

from __future__ import annotations

import pytest

from conetl.model.health import Verdict
from conetl.model.params import TrajectoryParams
from conetl.tracking.clock import ClockOffset
from conetl.tracking.health import _clock


@pytest.mark.parametrize(("known_s", "advice"), [(0.031, "known to 31 ms"), (0.001, "Correct the synchronisation")])
def test_an_offset_within_what_was_known_is_no_fault(known_s: float, advice: str) -> None:
    check = _clock(ClockOffset(-0.02, 0.001), TrajectoryParams(clock_sigma_s=known_s))
    assert check.verdict == Verdict.CORRECTED
    assert advice in check.detail
