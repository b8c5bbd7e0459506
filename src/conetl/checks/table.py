"""The table of health checks: one row for each check of a drive."""

from __future__ import annotations

from typing import Any

from conetl.checks import images, log, map
from conetl.checks.check import Check
from conetl.model.check_params import CheckParams
from conetl.model.params import IngestParams

GROUPS: dict[str, tuple[Check, ...]] = {"images": images.CHECKS, "log": log.CHECKS, "map": map.CHECKS}
TABLE: dict[str, Check] = {check.name: check for group in GROUPS.values() for check in group}
_HEADER = "| check | measured | needs | beyond the limit | effect on positions |\n|---|---|---|---|---|"


def as_markdown(group: str) -> str:
    """A table of the checks of a group, with the limits of the default parameters."""
    params = IngestParams()
    named: dict[str, Any] = {**dict(params.check), "agreement": params.reconcile.agreement}
    rows = [[row.name, row.measured, row.observable, _beyond(row, params.check), row.effect] for row in GROUPS[group]]
    return "\n".join([_HEADER, *(f"| {' | '.join(cells)} |".format_map(named) for cells in rows)])


def _beyond(row: Check, params: CheckParams) -> str:
    """Limit and what follows, in words; names of parameters in braces."""
    unit = f" {row.unit}" if row.unit else ""
    limit = [f"{'below' if row.is_smallest else 'above'} {params.value(row.least):g}{unit}"] if row.least else []
    limit += [row.limit] if row.limit else []
    limit += [f"and {params.value(row.sigmas):g} sigmas"] if row.sigmas else []
    return "; ".join(
        [*([f"{' '.join(limit)}: {_follows(row)}"] if limit else []), *([row.treated] if row.treated else [])]
    )


def _follows(row: Check) -> str:
    return " or ".join(dict.fromkeys(verdict.value for verdict in (row.follows, *row.follows_from.values())))
