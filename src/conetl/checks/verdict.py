"""The one rule by which a finding gets a verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from conetl.checks.check import SHARE, Check
from conetl.checks.log import COMMON_MESSAGES
from conetl.checks.table import TABLE
from conetl.model.check_params import CheckParams
from conetl.model.health import AGREEMENT, Finding, HealthCheck, Verdict

_DEFAULT = CheckParams()


def judge(finding: Finding, params: CheckParams = _DEFAULT) -> HealthCheck:
    """The verdict on a finding, with its message: by its row of the table, whose limits are those of the parameters.

    What was not measured, or is within its limit, passes. What the analysis has corrected, or covered by larger sigmas, counts;
    also beyond the limit, if its effect on positions is known and small enough for that. Else follows what the row states.
    """
    row, limit = TABLE[finding.check], _limit(finding, params)
    was_measured = finding.found is not None or finding.value is not None
    verdict = Verdict.PASS
    if was_measured and _is_beyond(finding, row, limit) and not _is_treated(finding, params):
        verdict = _follows(finding, row)
    elif finding.treated:
        verdict = Verdict(finding.treated)
    messages = [row.passed if was_measured else row.unobserved]
    if verdict is not Verdict.PASS:
        says = [name for name in finding.says if name != "covered" or verdict is Verdict.WIDENED]
        messages = [*(row.messages.get(name) or COMMON_MESSAGES[name] for name in says), row.remedy]
    value, sigma, limit = (_shown(figure, row) for figure in (finding.value, finding.sigma, limit))
    return HealthCheck(
        name=row.name, verdict=verdict, value=value, sigma=sigma, limit=limit, unit="%" if row.unit == SHARE else row.unit,
        detail=" ".join(filter(None, messages)).format_map(_facts(finding)),
    )  # fmt: skip


def judge_all(findings: Iterable[Finding], params: CheckParams = _DEFAULT) -> list[HealthCheck]:
    """As `judge`, of each."""
    return [judge(finding, params) for finding in findings]


def _limit(finding: Finding, params: CheckParams) -> float | None:
    """Largest (of some checks smallest) value, or deviation from the expected one, that is within the limit; None without any."""
    row, least = TABLE[finding.check], finding.limit
    if least is None and row.least:
        least = params.value(row.least)
    if least is not None and row.sigmas and finding.sigma is not None:
        least = max(least, params.value(row.sigmas) * finding.sigma)
    return least


def _is_beyond(finding: Finding, row: Check, limit: float | None) -> bool:
    if finding.found is not None or finding.value is None:
        return bool(finding.found)
    if row.is_smallest:
        return finding.value < (limit or 0.0)
    return abs(finding.value - row.expected) > (limit or 0.0)


def _is_treated(finding: Finding, params: CheckParams) -> bool:
    """Whether the effect on positions is corrected, or in the sigmas, and so small that cones are still told apart."""
    return bool(finding.treated) and finding.effect_m is not None and finding.effect_m <= params.covered_m


def _follows(finding: Finding, row: Check) -> Verdict:
    """The first of what its messages and the row state."""
    return next((row.follows_from[name] for name in finding.says if name in row.follows_from), row.follows)


def _shown(figure: float | None, row: Check) -> float | None:
    """Shares in %; to four digits, so that a repeated computation gives the same."""
    return None if figure is None else float(f"{figure * (100 if row.unit == SHARE else 1):.4g}")


def _facts(finding: Finding) -> Mapping[str, object]:
    size = None if finding.value is None else abs(finding.value)
    return {"value": finding.value, "size": size, "sigma": finding.sigma, **finding.facts}


#: Of a drive that the map does not contradict.
AGREES = judge(Finding(check=AGREEMENT, found=False))
