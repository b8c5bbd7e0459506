"""The rule by which a finding gets a verdict."""

from __future__ import annotations

import pytest

from conetl.checks.verdict import judge
from conetl.model.check_params import CheckParams
from conetl.model.health import Finding, HealthCheck, Verdict

K1 = "distortion of the lenses"  # hold above 0.02 and 6 sigmas
ROWS = "rows of the right images"  # hold above 4 px
SHARE = "intervals measured by visual odometry"  # hold below 0.5
CLIMB = "heights of GNSS/INS"  # hold where it is not 1, by 0.3 and 6 sigmas


@pytest.mark.parametrize(
    ("check", "values", "verdict"),
    [
        (K1, {}, Verdict.PASS),
        (K1, {"value": 0.019, "sigma": 0.001}, Verdict.PASS),
        (K1, {"value": -0.021, "sigma": 0.001}, Verdict.HOLD),
        (K1, {"value": 0.021, "sigma": 0.004}, Verdict.PASS),
        (K1, {"value": 0.025, "sigma": 0.004}, Verdict.HOLD),
        (K1, {"value": 0.3, "sigma": 0.001, "effect_m": 0.1}, Verdict.HOLD),
        (K1, {"value": 0.3, "sigma": 0.001, "effect_m": 0.1, "treated": "widened"}, Verdict.WIDENED),
        (K1, {"value": 0.3, "sigma": 0.001, "effect_m": 0.31, "treated": "widened"}, Verdict.HOLD),
        (K1, {"value": 0.03, "sigma": 0.001, "limit": 0.04}, Verdict.PASS),
        (ROWS, {"value": 2.0, "sigma": 0.1, "treated": "corrected", "says": ("turned",)}, Verdict.CORRECTED),
        (ROWS, {"value": 5.0, "sigma": 0.1, "treated": "corrected", "says": ("turned",)}, Verdict.HOLD),
        (SHARE, {"value": 0.6, "facts": {"measured": 6, "intervals": 10}}, Verdict.PASS),
        (SHARE, {"value": 0.4, "facts": {"measured": 4, "intervals": 10}}, Verdict.HOLD),
        (SHARE, {"value": 0.4, "found": False, "facts": {"measured": 4, "intervals": 10}}, Verdict.PASS),
        (CLIMB, {"value": 1.2, "sigma": 0.01}, Verdict.PASS),
        (CLIMB, {"value": 0.6, "sigma": 0.01}, Verdict.HOLD),
        ("blurred parts of the lenses", {"value": 0.2, "facts": {"sides": "left"}}, Verdict.NOTE),
        ("adjustment of the poses", {"found": True, "facts": {"images_m": 1.0, "log_m": 2.0}}, Verdict.HOLD),
    ],
)
def test_the_rule(check: str, values: dict[str, object], verdict: Verdict) -> None:
    assert judge(Finding(check=check, **values)).verdict is verdict


def test_a_limit_is_a_parameter() -> None:
    finding = Finding(check=K1, value=0.03, sigma=0.001)
    strict, loose = (CheckParams.model_validate({"stereo": {"max_k1": limit}}) for limit in (0.02, 0.04))
    assert (judge(finding, strict).verdict, judge(finding, loose).verdict) == (Verdict.HOLD, Verdict.PASS)
    assert (judge(finding, strict).limit, judge(finding, loose).limit) == (0.02, 0.04)


def test_a_message_says_what_was_found_and_what_to_do_or_why_nothing_was() -> None:
    held = judge(Finding(check=K1, value=0.05, sigma=0.001))
    assert held.detail.startswith("The right images are distorted by k1 +0.050 +- 0.001")
    assert held.detail.endswith("Calibrate the rig (conetl calibrate).")
    assert judge(Finding(check=K1)).detail == "The images do not show enough for this check."
    assert judge(Finding(check=K1, value=0.0)).detail == "The distortion of both lenses agrees with the calibration."


def test_only_what_larger_sigmas_cover_says_that_they_do() -> None:
    finding = Finding(
        check="distances by images and by GNSS/INS",
        value=1.5,
        sigma=0.1,
        treated="widened",
        says=("", "covered"),
        effect_m=0.2,
    )
    covered, held = judge(finding), judge(finding.model_copy(update={"effect_m": 0.5}))
    assert (covered.verdict, held.verdict) == (Verdict.WIDENED, Verdict.HOLD)
    assert covered.detail == f"{held.detail} The sigmas of all positions include such a drift."


def test_what_earlier_releases_stored_is_read() -> None:
    stored = {"name": "a check", "verdict": "warn", "value": None, "detail": "Clean the lens."}
    assert HealthCheck.model_validate(stored).verdict is Verdict.NOTE
    assert (
        HealthCheck.model_validate_json('{"name": "a", "verdict": "warn", "value": null, "detail": ""}').verdict
        == "note"
    )
