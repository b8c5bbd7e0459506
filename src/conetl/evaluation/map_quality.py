"""Quality of a map as one report: positional accuracy (ASPRS 2023, NSSDA), measures by element of ISO 19157-1, coverage, latency.

Sums are exact (math.fsum) and percentiles are values that occur (nearest rank), so that others compute the same last digit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from conetl.db.connection import Connection, or_infinity, read
from conetl.db.map.decision_store import read_decisions
from conetl.db.map.map_store import list_changesets, read_features_as_of
from conetl.db.schema import AuditResult, run_audits
from conetl.evaluation.truth import CheckedMap, check_map
from conetl.model.base import Record, Vec3, ns_from_utc, utc_from_ns
from conetl.model.drive import SurveyedPoint
from conetl.model.map_records import MapFeature
from conetl.model.work_zone_params import WorkZoneParams
from conetl.reports.html import Section, render, write_page

#: ASPRS Positional Accuracy Standards, edition 2 (2023), 7.12: fewer check points give no verdict.
MIN_CHECK_POINTS = 30
#: NSSDA (FGDC-STD-007.3-1998): RMSE of similar axes to the radius, and RMSE of heights to the interval, that hold 95 %.
NSSDA_HORIZONTAL, NSSDA_VERTICAL = 1.7308, 1.9600
#: Upper ends of the classes of ages; the last is open.
AGES_DAYS = (1, 7, 30)
_DAY_S = 86_400.0
#: Squares of the page; all are in the JSON.
_MAX_ROWS = 200
Element = Literal["completeness", "positional accuracy", "thematic quality", "temporal quality", "logical consistency"]


class PositionalAccuracy(Record):
    """The map at check points; metres, None where no object stands on one."""

    check_points: int
    tested: int
    """Check points on which an object of the map stands; the figures are of these."""
    mean_enu_m: Vec3 | None = None
    """Map minus point: east, north, up."""
    rmse_differences_enu_m: Vec3 | None = None
    rmse_points_enu_m: Vec3 | None = None
    """Of the survey itself."""
    rmse_h_m: float | None = None
    """RMSE_H, RMSE_V and RMSE_3D of the product, with those of the check points."""
    rmse_v_m: float | None = None
    rmse_3d_m: float | None = None
    nssda_horizontal_m: float | None = None
    """At 95 %, from the differences alone, as NSSDA defines it."""
    nssda_vertical_m: float | None = None
    contradicts_sigmas: bool
    verdict: str | None = None
    """None below 30 check points."""
    statement: str


class Measure(Record):
    """One measure of ISO 19157-1."""

    element: Element
    name: str
    value: float | None
    """None: the map's data do not show it."""
    unit: str
    basis: str
    """What it was measured on, or what is missing."""


class CoveredSquare(Record):
    """A square of 256 m that drives passed."""

    west_m: float
    south_m: float
    drives: int
    frame_pairs: int
    last_at: datetime
    age_days: float


class AgeClass(Record):
    """What was last looked at, or observed, up to so many days ago (None: longer ago)."""

    up_to_days: int | None
    squares: int
    features: int


class Latency(Record):
    """From the end of a drive to its changes on the map; seconds."""

    drives: int
    p50_s: float | None
    p95_s: float | None


class MapQuality(Record):
    """The whole report."""

    map_name: str
    srid: int
    at: datetime
    features: int
    positional: PositionalAccuracy | None
    measures: tuple[Measure, ...]
    ages: tuple[AgeClass, ...]
    squares: tuple[CoveredSquare, ...]
    """The oldest first."""
    latency: Latency
    audits: dict[str, int]
    """Offending rows by audit, of all maps of the database."""

    @property
    def needs_attention(self) -> bool:
        contradicts = self.positional is not None and self.positional.contradicts_sigmas
        return contradicts or any(self.audits.values())


def read_quality(
    conn: Connection,
    *,
    map_name: str,
    srid: int,
    as_of: datetime | None = None,
    points: Sequence[SurveyedPoint] = (),
    within_m: float = 0.75,
    now: datetime | None = None,
) -> MapQuality:
    """Quality of the state of the road at as_of (None: now) as the map knows it now; read-only."""
    at = as_of or now or datetime.now(UTC)
    features = [one.feature for one in read_features_as_of(conn, as_of, map_name=map_name)]
    covered = read(conn, f"The drives of map {map_name} cannot be read", "reports.coverage", map_name=map_name,
        valid_until=or_infinity(as_of))  # fmt: skip
    drives = [one for one in list_changesets(conn, map_name=map_name) if one.kind == "drive" and one.counts]
    ended = [(utc_from_ns(one.captured_to_ns), one.effective_at) for one in drives]
    delays_s = [(on_map - end).total_seconds() for end, on_map in ended if end <= at]
    reclassified = len(read_decisions(conn, map_name=map_name).classified)
    conn.rollback()
    audits = run_audits(conn)
    checked = check_map(points, features, within_m=within_m) if points else None
    squares = [CoveredSquare(**row, age_days=_days(row["last_at"], at)) for row in covered]
    return MapQuality(
        map_name=map_name,
        srid=srid,
        at=at,
        features=len(features),
        positional=None if checked is None else positional_accuracy(checked),
        measures=(*_measures(features, checked, at, reclassified, audits),),
        ages=_age_classes(squares, features, at),
        squares=tuple(squares),
        latency=Latency(drives=len(delays_s), p50_s=nearest_rank(delays_s, 0.5), p95_s=nearest_rank(delays_s, 0.95)),
        audits={audit.name: audit.row_count for audit in audits},
    )


def positional_accuracy(checked: CheckedMap) -> PositionalAccuracy:
    """RMSE of the product from the differences and the survey's own errors, which are independent of each other."""
    tested = [(r.difference_m.tolist(), r.point.sigma_m) for r in checked.residuals if r.difference_m is not None]
    made = PositionalAccuracy(
        check_points=len(checked.residuals), tested=len(tested), contradicts_sigmas=checked.contradicts,
        statement=f"No verdict: an object of the map stands on {len(tested)} check points, and ASPRS 2023 requires at least "
        f"{MIN_CHECK_POINTS}. The figures describe these points only.",
    )  # fmt: skip
    if not tested:
        return made
    east, north, up = zip(*(difference for difference, _ in tested), strict=True)
    e, n, u = _rms(east), _rms(north), _rms(up)
    point_e, point_n, point_u = (_rms(axis) for axis in zip(*(sigma for _, sigma in tested), strict=True))
    rmse_h = math.sqrt(e * e + n * n + point_e * point_e + point_n * point_n)
    rmse_v = math.sqrt(u * u + point_u * point_u)
    figures = {
        "mean_enu_m": (_mean(east), _mean(north), _mean(up)),
        "rmse_differences_enu_m": (e, n, u),
        "rmse_points_enu_m": (point_e, point_n, point_u),
        "rmse_h_m": rmse_h,
        "rmse_v_m": rmse_v,
        "rmse_3d_m": math.sqrt(rmse_h * rmse_h + rmse_v * rmse_v),
        "nssda_horizontal_m": NSSDA_HORIZONTAL * math.sqrt(e * e + n * n),
        "nssda_vertical_m": NSSDA_VERTICAL * u,
    }
    if len(tested) < MIN_CHECK_POINTS:
        return made.model_copy(update=figures)
    verdict = f"horizontal class {math.ceil(100 * rmse_h)} cm, vertical class {math.ceil(100 * rmse_v)} cm"
    statement = (
        f"Tested by the ASPRS Positional Accuracy Standards, edition 2 (2023), with {len(tested)} check points: RMSE_H "
        f"{100 * rmse_h:.1f} cm, RMSE_V {100 * rmse_v:.1f} cm; {verdict}."
    )
    return made.model_copy(update=figures | {"verdict": verdict, "statement": statement})


def _measures(
    features: Sequence[MapFeature],
    checked: CheckedMap | None,
    at: datetime,
    reclassified: int,
    audits: Sequence[AuditResult],
) -> Iterable[Measure]:
    """By element, in the order of the standard."""
    count, stated = len(features), f"{len(features)} objects on the map"
    points = 0 if checked is None else len(checked.residuals)
    missing = points - sum(r.feature is not None for r in checked.residuals) if checked is not None else None
    surveyed = f"{points} check points" if points else "not measured: give check points"

    def measure(element: Element, name: str, value: float | None, unit: str, basis: str) -> Measure:
        return Measure(element=element, name=name, value=value, unit=unit, basis=basis)

    yield measure("completeness", "omission: number of missing items", missing, "items", surveyed)
    rate = None if missing is None else missing / points
    yield measure("completeness", "omission: rate of missing items", rate, "ratio", surveyed)
    doubt = _mean([1.0 - one.existence_probability for one in features]) if features else None
    yield measure("completeness", "commission: expected rate of excess items", doubt, "ratio",
        f"stated existence probabilities of {stated}")  # fmt: skip
    accuracy = None if checked is None else positional_accuracy(checked)
    for name, figure in (("RMSE of planimetry", "rmse_h_m"), ("RMSE of heights", "rmse_v_m")):
        yield measure("positional accuracy", f"absolute: {name}", getattr(accuracy, figure, None), "m", surveyed)
    for name, sigmas in (
        ("horizontal", [math.sqrt(one.cov_m2[0] + one.cov_m2[3]) for one in features]),
        ("vertical", [math.sqrt(one.cov_m2[5]) for one in features]),
    ):
        mean = _mean(sigmas) if sigmas else None
        yield measure("positional accuracy", f"absolute: mean value of positional uncertainties, {name}", mean, "m",
            f"stated covariances of {stated}")  # fmt: skip
    yield measure("thematic quality", "classification: number of corrected locations", float(reclassified), "items",
        "decisions of people; the rate is not measured, as nobody states which objects were looked at")  # fmt: skip
    limit = WorkZoneParams().max_age_days
    old = sum(_days(utc_from_ns(one.last_seen_ns), at) > limit for one in features)
    yield measure("temporal quality", f"temporal validity: rate of items not observed for {limit:g} days",
        old / count if count else None, "ratio", stated)  # fmt: skip
    order = sum(audit.row_count for audit in audits if "periods" in audit.name)
    yield measure("temporal quality", "temporal consistency: number of items", float(order), "rows",
        "audits of periods, all maps of the database")  # fmt: skip
    others = sum(audit.row_count for audit in audits) - order
    yield measure("logical consistency", "number of items not compliant with the rules of the conceptual schema",
        float(others), "rows", "other audits, all maps of the database")  # fmt: skip


def write_quality_page(path: Path, quality: MapQuality) -> Path:
    """Write the report as a page. Raises InputError where it cannot be written."""
    found, latency = quality.positional, quality.latency
    summary = [
        f"State of the road at {quality.at:%Y-%m-%d %H:%M} UTC, EPSG:{quality.srid}, {quality.features} objects.",
        "No check points: positional accuracy was not tested." if found is None else found.statement,
    ]
    left = max(len(quality.squares) - _MAX_ROWS, 0)
    more = f"; {left} more are in the JSON" if left else ""
    sections = [
        *([] if found is None else [_positions(found)]),
        _table("Measures by element (ISO 19157-1)", "", quality.measures),
        Section("Age", "Since drives passed a square, and since an object was last observed.", ("days", "squares", "objects"),
            [(f"up to {one.up_to_days}" if one.up_to_days else "more", one.squares, one.features) for one in quality.ages]),
        _table("Coverage", f"Squares of 256 m that drives passed, the oldest first{more}.",
            quality.squares[:_MAX_ROWS]),
        Section("From road to map", "From the end of a drive to its changes on the map, in hours; backfills and holds count.",
            ("drives", "median", "95 %"), [(latency.drives, _hours(latency.p50_s), _hours(latency.p95_s))]),
        Section("Audits", "Offending rows, of all maps of the database.", ("audit", "rows"),
            [(name.replace("_", " "), count) for name, count in quality.audits.items()]),
    ]  # fmt: skip
    title = f"Quality of the map {quality.map_name}"
    return write_page(path, render("accuracy.html.j2", title=title, summary=summary, sections=sections))


def _positions(found: PositionalAccuracy) -> Section:
    agrees = "contradict" if found.contradicts_sigmas else "agree with"
    figures = {
        "Mean of the differences, east, north, up": found.mean_enu_m,
        "RMSE of the differences, east, north, up": found.rmse_differences_enu_m,
        "RMSE of the check points, east, north, up": found.rmse_points_enu_m,
        "RMSE_H": found.rmse_h_m,
        "RMSE_V": found.rmse_v_m,
        "RMSE_3D": found.rmse_3d_m,
        "NSSDA, horizontal, 95 %": found.nssda_horizontal_m,
        "NSSDA, vertical, 95 %": found.nssda_vertical_m,
    }
    note = (
        f"{found.tested} of {found.check_points} check points carry an object. The differences {agrees} the stated sigmas. "
        "RMSE_H, RMSE_V and RMSE_3D include the check points' own errors; NSSDA does not."
    )
    return Section(
        "Positional accuracy", note, ("figure", "m"), [(name, _cell(value)) for name, value in figures.items()]
    )


def _table(heading: str, note: str, records: Sequence[Record]) -> Section:
    columns = [name.replace("_", " ") for name in type(records[0]).model_fields] if records else []
    return Section(heading, note, columns, [[_cell(value) for _, value in record] for record in records])


def _cell(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_cell, value))
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    text = f"{value:.4f}".rstrip("0").rstrip(".") if isinstance(value, float) else value
    return "" if text is None else str(text)


def _hours(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds / 3600:,.2f}"


def _age_classes(
    squares: Sequence[CoveredSquare], features: Sequence[MapFeature], at: datetime
) -> tuple[AgeClass, ...]:
    of_squares = Counter(_class_of(square.age_days) for square in squares)
    of_features = Counter(_class_of(_days(utc_from_ns(one.last_seen_ns), at)) for one in features)
    return tuple(
        AgeClass(up_to_days=limit, squares=of_squares[limit], features=of_features[limit])
        for limit in (*AGES_DAYS, None)
    )


def _class_of(age_days: float) -> int | None:
    return next((limit for limit in AGES_DAYS if age_days <= limit), None)


def _days(instant: datetime, at: datetime) -> float:
    return (ns_from_utc(at) - ns_from_utc(instant)) / 1e9 / _DAY_S


def nearest_rank(values: Sequence[float], share: float) -> float | None:
    """The smallest value that at least this share of the values does not exceed; None without values."""
    return sorted(values)[max(math.ceil(share * len(values)), 1) - 1] if values else None


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(_mean([value * value for value in values]))
