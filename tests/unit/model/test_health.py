"""Measured values of health checks, as reports and commands show them."""

from __future__ import annotations

import pytest

from conetl.model.health import HealthCheck, Verdict, hold_reason


@pytest.mark.parametrize(
    ("value", "sigma", "limit", "shown"),
    [
        (0.000375, 0.00217, 0.0108, "0.0004 +- 0.0022 m (limit 0.0108)"),
        (-0.2471, 0.3382, 1.9, "-0.25 +- 0.34 m (limit 1.9)"),
        (-0.001, 0.3, None, "0.00 +- 0.30 m"),
        (1234.4, 56.0, None, "1234 +- 56 m"),
        (0.123456, None, 0.02, "0.123 m (limit 0.02)"),
        (0.5, 0.0, None, "0.5 m"),
        (None, None, 0.02, ""),
    ],
)
def test_a_value_has_the_decimals_of_its_sigma(
    value: float | None, sigma: float | None, limit: float | None, shown: str
) -> None:
    check = HealthCheck(
        name="a check", verdict=Verdict.PASS, value=value, sigma=sigma, limit=limit, unit="m", detail="It passed."
    )
    assert check.figures == shown


def test_what_several_checks_advise_is_said_once() -> None:
    advice = "Calibrate the rig (conetl calibrate), or reprocess the GNSS/INS log."
    checks = [
        HealthCheck(name=name, verdict=Verdict.HOLD, value=1.0, detail=f"{said} {advice}")
        for name, said in (("motions", "38 of 38 contradict."), ("distances", "They differ by -12.0 %."))
    ]
    assert hold_reason(checks) == f"38 of 38 contradict. {advice} They differ by -12.0 %."
