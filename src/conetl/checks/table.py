"""The table of health checks: one row for each check of a drive."""

from __future__ import annotations

from typing import Any

from conetl.checks import images, log, map
from conetl.checks.check import SHARE, Check
from conetl.model.check_params import CheckParams
from conetl.model.params import IngestParams

GROUPS: dict[str, tuple[Check, ...]] = {"images": images.CHECKS, "log": log.CHECKS, "map": map.CHECKS}
TABLE: dict[str, Check] = {check.name: check for group in GROUPS.values() for check in group}


def as_markdown(group: str) -> str:
    """The checks of a group, with the limits of the default parameters: a heading and a list for each."""
    params = IngestParams()
    named: dict[str, Any] = {**dict(params.check), "agreement": params.reconcile.agreement}
    return "\n".join(_described(row, params.check).format_map(named) for row in GROUPS[group])


def _described(row: Check, params: CheckParams) -> str:
    """A check in Markdown; names of parameters in braces."""
    facts = {"Needs": row.observable, "Limit": _beyond(row, params), "Effect on positions": row.effect}
    lines = [f"- **{name}:** {text}" for name, text in facts.items()]
    if row.remedy:
        lines.append(f"- **What to do:** {row.remedy}")
    return "\n".join([f"### {row.name}", "", f"{row.measured[:1].upper()}{row.measured[1:]}.", "", *lines, ""])


def _beyond(row: Check, params: CheckParams) -> str:
    """Limit and what follows, in words; names of parameters in braces."""
    limit = []
    if row.least:
        least = params.value(row.least)
        shown = f"{least:.0%}" if row.unit == SHARE else f"{least:g} {row.unit}".rstrip()
        limit.append(f"{'below' if row.is_smallest else 'above'} {shown}")
    limit += [row.limit] if row.limit else []
    limit += [f"and {params.value(row.sigmas):g} sigmas"] if row.sigmas else []
    return "; ".join(
        [*([f"{' '.join(limit)}: {_follows(row)}"] if limit else []), *([row.treated] if row.treated else [])]
    )


def _follows(row: Check) -> str:
    return " or ".join(dict.fromkeys(verdict.value for verdict in (row.follows, *row.follows_from.values())))
