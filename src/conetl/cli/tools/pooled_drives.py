"""Several drives judged together: what `conetl evaluate` prints and writes below the single ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from conetl.cli.console import out, print_table
from conetl.evaluation.accuracy import (
    ConsistencyReport,
    ErrorStatistics,
    NeesReport,
    PointErrors,
    consistency_report,
    drive_consistency,
    pooled_consistency,
    pooled_statistics,
)
from conetl.model.errors import InputError
from conetl.reports.accuracy_page import Section, write_accuracy_page

#: What the errors of a drive are of.
KINDS = ("tracks", "single positions")
NEES_COLUMNS = ("", "sum", "degrees of freedom", "95 % band", "per degree", "sigmas are")
_DRIVES = ("drive", "cones found", "false", "median 3D", "tracks: relative", "common", "absolute",
           "single positions: relative", "common", "absolute")  # fmt: skip
_WORDS = (
    "NEES per degree of freedom, 1 where the stated sigmas are right; * outside of its 95 % band, as one value in twenty is by "
    "chance. All drives together: sums over drives that err independently."
)


@dataclass(frozen=True)
class DriveErrors:
    """One drive against its truth."""

    cones: int
    found: int
    false: int
    tracks: PointErrors
    singles: PointErrors


@dataclass(frozen=True)
class PooledDrives:
    """Drives by id, and what they say together."""

    drives: Mapping[str, DriveErrors]
    figures: dict[str, ErrorStatistics]
    nees: dict[str, ConsistencyReport]


def pool(drives: Mapping[str, DriveErrors]) -> PooledDrives:
    """Figures and NEES of all drives together, by what they are of."""
    errors = {KINDS[0]: [d.tracks for d in drives.values()], KINDS[1]: [d.singles for d in drives.values()]}
    figures = {kind: figure for kind, some in errors.items() if (figure := pooled_statistics(some)) is not None}
    nees = {kind: consistency_report(pooled_consistency(some)) for kind, some in errors.items()}
    return PooledDrives(drives, figures, nees)


def print_pooled(pooled: PooledDrives) -> None:
    """One line a drive, one for all, and the bands of all."""
    out.print(f"[bold]{len(pooled.drives)} drives together[/], in metres\n")
    print_table("", _DRIVES, _drive_rows(pooled))
    out.print()
    print_table("Do the stated sigmas hold, all drives together? (NEES)", NEES_COLUMNS, nees_rows(pooled.nees))
    out.print()
    out.print(_WORDS, markup=False)


def write_pooled_page(path: Path, pooled: PooledDrives) -> Path:
    """The same as one page. Raises InputError where it cannot be written."""
    sections = [
        Section("Drive by drive", "Metres. " + _WORDS, _DRIVES, _drive_rows(pooled)),
        Section("Do the stated sigmas hold, all drives together?", "", NEES_COLUMNS, nees_rows(pooled.nees)),
    ]
    found, cones = (sum(getattr(d, what) for d in pooled.drives.values()) for what in ("found", "cones"))
    summary = [f"{found} of {cones} cones found, {sum(d.false for d in pooled.drives.values())} false ones."]
    if figures := pooled.figures.get(KINDS[0]):
        summary.append(
            f"Median 3D error of the tracks {figures.median_3d_m:.3f} m, CE90 {figures.ce90_m:.3f} m, "
            f"LE90 {figures.le90_m:.3f} m."
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return write_accuracy_page(
            path, title=f"{len(pooled.drives)} drives against truth", summary=summary, sections=sections
        )
    except OSError as error:
        raise InputError(
            f"{path.parent} cannot be written ({error.strerror}): choose another folder by --out"
        ) from error


def as_dict(pooled: PooledDrives) -> dict[str, object]:
    """For JSON."""
    return {
        "pooled": {
            "errors": {kind: figures.model_dump(mode="json") for kind, figures in pooled.figures.items()},
            "nees": {kind: report.model_dump(mode="json") for kind, report in pooled.nees.items()},
        }
    }


def nees_rows(nees: Mapping[str, ConsistencyReport]) -> list[tuple[object, ...]]:
    """One row for each part that has degrees of freedom."""
    rows: list[tuple[object, ...]] = []
    for name, report in nees.items():
        for part in ("relative", "common", "absolute"):
            one: NeesReport | None = getattr(report, part)
            if one is None:
                continue
            verdict = "right" if one.holds else "too small" if one.value > one.high else "too large"
            rows.append(
                (f"{name}, {part}", f"{one.value:.1f}", one.dof, f"{one.low:.1f} to {one.high:.1f}",
                 f"{one.per_dof:.2f}", verdict)
            )  # fmt: skip
    return rows


def _drive_rows(pooled: PooledDrives) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for name, drive in pooled.drives.items():
        reports = [consistency_report(drive_consistency(errors)) for errors in (drive.tracks, drive.singles)]
        figures = pooled_statistics([drive.tracks])
        rows.append(_row(name, [drive], figures, reports))
    reports = [pooled.nees[kind] for kind in KINDS]
    rows.append(_row("all together", list(pooled.drives.values()), pooled.figures.get(KINDS[0]), reports))
    return rows


def _row(
    name: str, drives: Sequence[DriveErrors], tracks: ErrorStatistics | None, reports: Sequence[ConsistencyReport]
) -> tuple[object, ...]:
    parts = [part for report in reports for part in (report.relative, report.common, report.absolute)]
    return (
        name, f"{sum(d.found for d in drives)} of {sum(d.cones for d in drives)}", sum(d.false for d in drives),
        "" if tracks is None else f"{tracks.median_3d_m:.3f}",
        *("" if part is None else f"{part.per_dof:.2f}{'' if part.holds else ' *'}" for part in parts),
    )  # fmt: skip
