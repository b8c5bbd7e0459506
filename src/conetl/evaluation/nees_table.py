"""NEES of a drive as rows of a table and as JSON values."""

from __future__ import annotations

from collections.abc import Mapping

from conetl.geometry.consistency import Consistency, Nees

NEES_COLUMNS = ("", "sum", "degrees of freedom", "95 % band", "per degree", "sigmas are")
NEES_TEXT = (
    "NEES: sum of squared errors over their stated covariance. Relative: without the errors common to the whole drive "
    "(GNSS/INS). Common: those errors. Absolute: both. One per degree of freedom is right."
)


def parts_of(result: Consistency | None) -> dict[str, Nees | None]:
    """Relative, common and absolute NEES by name; None without degrees of freedom."""
    names = ("relative", "common", "absolute")
    return {name: nees if (nees := getattr(result, name, None)) and nees.dof else None for name in names}


def nees_as_dict(result: Consistency | None) -> dict[str, dict[str, float | bool] | None]:
    """Each part with its 95 % band."""
    parts: dict[str, dict[str, float | bool] | None] = dict.fromkeys(("absolute", "relative", "common"))
    for name, nees in parts_of(result).items():
        if nees is not None:
            known = {"value": nees.value, "dof": nees.dof, **dict(zip(("low", "high"), nees.band(), strict=True))}
            parts[name] = {**known, "per_dof": nees.per_dof, "holds": nees.holds()}
    return parts


def nees_rows(nees: Mapping[str, Consistency | None]) -> list[tuple[object, ...]]:
    """One row for each part with degrees of freedom."""
    rows: list[tuple[object, ...]] = []
    for name, result in nees.items():
        for part, one in parts_of(result).items():
            if one is None:
                continue
            low, high = one.band()
            verdict = "right" if one.holds() else "too small" if one.value > high else "too large"
            band = f"{low:.1f} to {high:.1f}"
            rows.append((f"{name}, {part}", f"{one.value:.1f}", one.dof, band, f"{one.per_dof:.2f}", verdict))
    return rows
