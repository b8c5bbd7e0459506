"""What the check of the clocks advises: a searched offset that the analysis refines is not a fault of the recorder."""

from __future__ import annotations

import pytest

from conetl.checks.verdict import judge
from conetl.model.health import Finding, Verdict
from conetl.model.params import TrajectoryParams
from conetl.tracking.checks.jumps import JUMPS
from conetl.tracking.checks.poses import _clock, _with_likely_cause
from conetl.tracking.clock import ClockOffset


@pytest.mark.parametrize(("known_s", "advice"), [(0.031, "known to 31 ms"), (0.001, "Correct the synchronisation")])
def test_an_offset_within_what_was_known_is_no_fault(known_s: float, advice: str) -> None:
    check = judge(_clock(ClockOffset(-0.02, 0.001), TrajectoryParams(clock_sigma_s=known_s)))
    assert check.verdict == Verdict.CORRECTED
    assert advice in check.detail


@pytest.mark.parametrize(
    ("known_s", "clock", "begins"),
    [
        (
            0.031,
            ClockOffset(-0.036, 0.001),
            "The beginning of the images is only known to 31 ms, and the poses show that it is off by -36 ",
        ),
        (0.031, None, "The beginning of the images is only known to 31 ms: state it in drive.yaml"),
        (0.001, ClockOffset(-0.036, 0.001), "18 of 153 measured motions"),
    ],
)
def test_an_estimated_beginning_is_named_before_the_calibration(
    known_s: float, clock: ClockOffset | None, begins: str
) -> None:
    params = TrajectoryParams(clock_sigma_s=known_s)
    facts = {"rejected": 18, "motions": 153, "agreeing": 135, "metres": 0.1, "degrees": 0.1}
    held = Finding(check="visual odometry against GNSS/INS", value=0.12, says=("", "unknown"), facts=facts)
    assert judge(_with_likely_cause(held, clock, params)).detail.startswith(begins)
    passed = judge(_with_likely_cause(held.model_copy(update={"value": 0.01}), clock, params))
    assert passed.detail == "135 of 153 measured motions agree with GNSS/INS."
    other = held.model_copy(update={"check": JUMPS})
    assert _with_likely_cause(other, clock, params) == other
