"""The columns of a feature: one list, from which tables, files, services and documents take theirs.

A new column is added here, to the table (a migration) and to the view `feature_state` (sql/functions/3_features.sql); a stored
one also to the record, `MapFeature` or `Marking`.
"""

from __future__ import annotations

from enum import Flag, auto
from typing import Literal, NamedTuple


class Face(Flag):
    """Where a column is shown, under its name."""

    NONE = 0
    FILE = auto()
    """Files: a property of every row."""
    HISTORY = auto()
    """Files of histories and changes, too."""
    CHANGE = auto()
    """Files of changes, and changes of the OGC API: the earlier state."""
    PLACE = auto()
    """The position: columns of CSV files and the OGC API; elsewhere the geometry."""
    OGC = auto()
    """Features of the OGC API, and layers of QGIS."""
    PAGE = auto()
    """Lists of the web view."""


EVERYWHERE = Face.FILE | Face.OGC | Face.PAGE
SERVED = Face.FILE | Face.OGC


class FeatureColumn(NamedTuple):
    """One column."""

    name: str
    kind: Literal["uuid", "text", "integer", "float8", "timestamptz", "boolean"]
    """Type of PostgreSQL."""
    unit: str
    """Empty for ids, words and counts."""
    title: str
    """Heading, as in QGIS."""
    meaning: str
    null: str = ""
    """What null means; empty where there is always a value."""
    shown: Face = Face.NONE
    of: Literal["all", "points", "lines"] = "all"
    stored: bool = False
    """Whether `feature_version` has it under this name, as has the record."""
    words: tuple[str, ...] = ()
    """All values, where they are few."""
    heading: str = ""
    """In tables of the command line, where it is in `TABLES`."""
    decimals: int = 3
    """There."""


def _number(name: str, unit: str, title: str, meaning: str, **more: object) -> FeatureColumn:
    return FeatureColumn(name, "float8", unit, title, meaning, **more)  # type: ignore[arg-type]


def _time(name: str, title: str, meaning: str, **more: object) -> FeatureColumn:
    return FeatureColumn(name, "timestamptz", "UTC", title, meaning, **more)  # type: ignore[arg-type]


_CHANGES = ("added", "confirmed", "moved", "removed", "missed", "height_changed", "split", "merged")
_NO_LINE, _NO_POINT = "of a lane marking", "of a point object"

#: In the order of files.
COLUMNS = (
    FeatureColumn(
        "feature_id", "uuid", "", "Feature",
        "The object: a UUID, the same in all files and services. A late drive that observed the object earlier changes it.",
        shown=EVERYWHERE, heading="feature",
    ),
    FeatureColumn(
        "version", "integer", "", "Version",
        "Number of the state on the road, from 1. A drive that does not observe the object leaves it as it is.",
        shown=EVERYWHERE, heading="version",
    ),
    FeatureColumn(
        "category", "text", "", "Class", "Class of the object, such as traffic_cone or lane_marking.",
        shown=EVERYWHERE, stored=True, heading="class",
    ),
    _number(
        "existence_probability", "0 to 1", "Existence probability",
        "That it stands there, after the last drive to which it was visible.",
        shown=EVERYWHERE, stored=True, heading="probability",
    ),
    _number(
        "object_height_m", "m", "Height of the object", "Of the object itself, from its foot to its tip.", null=_NO_LINE,
        shown=EVERYWHERE, of="points", stored=True, heading="object m", decimals=2,
    ),
    _number(
        "object_height_sigma_m", "m", "Sigma of the height of the object", "Standard deviation of object_height_m.",
        null=_NO_LINE,
        shown=SERVED, of="points", stored=True,
    ),
    _number(
        "ground_height_m", "m", "Height of the ground", "Of the foot of the object, in the height system of height_system.",
        shown=Face.FILE,
    ),
    FeatureColumn(
        "height_system", "text", "", "Height system",
        "`ellipsoidal` (above the WGS 84 ellipsoid), or `EPSG:` and the code of a vertical CRS.", shown=Face.FILE,
    ),
    _number("sigma_e_m", "m", "Sigma east", "Standard deviation of the position along the easting axis.", shown=SERVED),
    _number("sigma_n_m", "m", "Sigma north", "Along the northing axis.", shown=SERVED),
    _number("sigma_u_m", "m", "Sigma up", "Of the height of the ground.", shown=EVERYWHERE, heading="sigma height m"),
    _number(
        "sigma_m", "m", "Horizontal sigma", "Along the major axis of the horizontal error ellipse.",
        shown=Face.OGC | Face.PAGE, heading="sigma horiz. m",
    ),
    _number("cov_en_m2", "m^2", "Covariance east, north", "Of the position.", shown=SERVED),
    _number("cov_eu_m2", "m^2", "Covariance east, up", "Of the position.", shown=SERVED),
    _number("cov_nu_m2", "m^2", "Covariance north, up", "Of the position.", shown=SERVED),
    _number(
        "width_m", "m", "Width", "Of the paint of a lane marking, across the line.",
        null=_NO_POINT, shown=SERVED, of="lines", stored=True, heading="width m", decimals=2,
    ),
    _number(
        "width_sigma_m", "m", "Sigma of the width", "Standard deviation of width_m.",
        null=_NO_POINT, shown=SERVED, of="lines", stored=True,
    ),
    FeatureColumn(
        "colour", "text", "", "Colour", "Of the paint.", null=_NO_POINT, shown=SERVED, of="lines", stored=True,
        words=("white", "yellow", "other"), heading="paint",
    ),
    FeatureColumn(
        "pattern", "text", "", "Pattern", "Of the paint; a dashed line is one line through its gaps.",
        null=_NO_POINT, shown=SERVED,
        of="lines", stored=True, words=("solid", "dashed"), heading="pattern",
    ),
    _number("dash_m", "m", "Dash", "Length of one dash.", null="of a solid line", shown=SERVED, of="lines", stored=True),
    _number("gap_m", "m", "Gap", "Between two dashes.", null="of a solid line", shown=SERVED, of="lines", stored=True),
    _number(
        "sigma_lateral_m", "m", "Lateral sigma", "Standard deviation across the line: that of the vertex with the largest one.",
        null=_NO_POINT, shown=SERVED, of="lines",
    ),
    _number(
        "length_m", "m", "Length", "Of this stretch of a lane marking, at most about 10 m.",
        null=_NO_POINT, shown=SERVED, of="lines", heading="length m", decimals=1,
    ),
    _time("first_seen_at", "First seen", "First frame pair in which it was observed.", shown=SERVED, heading="first seen (UTC)"),
    _time("last_seen_at", "Last seen", "Last frame pair in which it was observed.", shown=EVERYWHERE),
    FeatureColumn(
        "observation_count", "integer", "", "Observations", "Frame pairs in which it was observed.",
        shown=EVERYWHERE, stored=True, heading="observations",
    ),
    FeatureColumn(
        "seen_count", "integer", "", "Drives that observed it", "Until valid_from; imported maps do not count.",
        shown=SERVED, stored=True, heading="drives",
    ),
    FeatureColumn(
        "missed_count", "integer", "", "Drives that did not observe it", "Of those to which it was visible, until valid_from.",
        shown=SERVED, stored=True, heading="not observed",
    ),
    _time(
        "first_missed_at", "Not observed since",
        "First frame pair without it since it was last observed: it may be gone since then.",
        null="no drive missed it", shown=SERVED,
    ),
    _time("valid_from", "Valid from", "Start of the period in which this row is true on the road.", shown=SERVED),
    _time("valid_to", "Valid to", "End of that period.", null="it lasts", shown=SERVED),
    FeatureColumn("changeset_id", "uuid", "", "Changeset", "That of the drive that made this row: a UUID.", shown=SERVED),
    FeatureColumn(
        "changeset_no", "integer", "", "Changeset number", "Counts the changesets of a map from 1.",
        shown=EVERYWHERE, heading="changeset",
    ),
    FeatureColumn(
        "drive_id", "text", "", "Drive", "The drive, or the imported file, of the changeset.",
        shown=SERVED, heading="drive",
    ),
    FeatureColumn(
        "change", "text", "", "Change",
        "What the drive did; in changes, how the later state differs. `missed`: visible, not observed.",
        shown=Face.HISTORY | Face.CHANGE | Face.OGC, words=_CHANGES, heading="change",
    ),
    _time("changed_at", "Changed", "Instant of the change on the road.", shown=Face.CHANGE, heading="on the road since (UTC)"),
    _number(
        "shift_m", "m", "Shift", "Horizontal distance between the old and the new position; of a lane marking, across the line.",
        null="added or removed", shown=Face.HISTORY | Face.CHANGE, heading="shift m",
    ),
    FeatureColumn("present", "boolean", "", "Present", "False where it is gone.", shown=Face.HISTORY),
    FeatureColumn(
        "suppressed", "boolean", "", "Suppressed", "True where a person decided that nothing stands here.",
        shown=Face.HISTORY,
    ),
    _time("system_from", "In the database from", "Start of the period in which the database held this row.", shown=Face.HISTORY),
    _time("system_to", "In the database to", "End of that period.", null="it lasts", shown=Face.HISTORY),
    FeatureColumn(
        "old_version", "integer", "", "Old version", "Of the earlier state.",
        null="added", shown=Face.CHANGE, heading="old",
    ),
    FeatureColumn(
        "new_version", "integer", "", "New version", "Of the later state.",
        null="removed", shown=Face.CHANGE, heading="new",
    ),
    _number("old_easting_m", "m", "Old easting", "Of the earlier state.", null="added", shown=Face.CHANGE),
    _number("old_northing_m", "m", "Old northing", "Of the earlier state.", null="added", shown=Face.CHANGE),
    _number(
        "old_ellipsoidal_height_m", "m", "Old ellipsoidal height of the ground", "Of the earlier state.",
        null="added", shown=Face.CHANGE
    ),
    _number(
        "old_ground_height_m", "m", "Old height of the ground", "Of the earlier state, in height_system.",
        null="added", shown=Face.FILE,
    ),
    _number("lon_deg", "degrees", "Longitude", "WGS 84.", shown=Face.PLACE),
    _number("lat_deg", "degrees", "Latitude", "WGS 84.", shown=Face.PLACE),
    _number(
        "ellipsoidal_height_m", "m", "Ellipsoidal height of the ground",
        "Of the foot of the object above the WGS 84 ellipsoid, whatever height_system is.",
        shown=Face.PLACE | Face.OGC, heading="ground m",
    ),
    _number(
        "easting_m", "m", "Easting", "Of the foot of the object, in the map's CRS; in files in that of --crs, if given.",
        shown=Face.PLACE | Face.OGC, heading="easting m",
    ),
    _number("northing_m", "m", "Northing", "Likewise.", shown=Face.PLACE | Face.OGC, heading="northing m"),
)  # fmt: skip
BY_NAME = {column.name: column for column in COLUMNS}
#: Columns of files that follow from others, by the column without which they do not exist; they depend on the CRS.
DERIVED = {
    "ground_height_m": "ellipsoidal_height_m",
    "height_system": "ellipsoidal_height_m",
    "old_ground_height_m": "old_ellipsoidal_height_m",
}
_POSITION = ("easting_m", "northing_m", "ellipsoidal_height_m")
_SIGMAS = ("sigma_m", "sigma_u_m", "existence_probability", "observation_count")
_DRIVES = ("seen_count", "missed_count", "first_seen_at")
#: Columns of the tables of the command line.
TABLES = {
    "features": (
        "feature_id", "category", "version", *_POSITION, "object_height_m", *_SIGMAS, *_DRIVES,
    ),
    "lane markings": (
        "feature_id", "version", *_POSITION, *_SIGMAS, *_DRIVES, "length_m", "width_m", "colour", "pattern",
    ),
    "changes by a drive": ("change", "feature_id", "category", *_POSITION, "object_height_m", *_SIGMAS, "shift_m"),
    "changes": ("change", "feature_id", "category", *_POSITION, "shift_m", "old_version", "new_version"),
    "history": (
        "change", "category", "drive_id", "changed_at", *_POSITION, "existence_probability", "observation_count", "shift_m",
    ),
}  # fmt: skip
#: Of objects, and of lane markings.
Geometry = Literal["points", "lines"]


def names(shown: Face, of: Geometry | None = None) -> tuple[str, ...]:
    """Names of the columns that are shown in one of the faces; of: only what features of this geometry have."""
    return tuple(c.name for c in COLUMNS if c.shown & shown and (of is None or c.of in ("all", of)))


def stored_names(of: Geometry | None = None) -> tuple[str, ...]:
    """Names of the stored columns that are numbers, words or counts; of: only those that features of this geometry alone have."""
    return tuple(c.name for c in COLUMNS if c.stored and of in (None, c.of))


#: Lists of columns that statements take by name.
GROUPS = {
    "stored": stored_names(),
    "paint": stored_names("lines"),
    "listed": names(Face.PAGE),
    "ogc_points": names(Face.OGC, "points"),
    "ogc_lines": names(Face.OGC, "lines"),
    "ogc_changes": tuple(name for name in names(Face.OGC, "points") if not BY_NAME[name].shown & Face.CHANGE),
    "of_changes": names(Face.CHANGE, "points"),
}


def select_list(group: str) -> str:
    """A list of `GROUPS` as SQL, of a table with the alias x."""
    return ", ".join(f"x.{name}" for name in GROUPS[group])


def as_markdown() -> str:
    """The table of `docs/reference/fields.md`."""
    head = ["## Fields", "", "| field | unit | meaning | null |", "|---|---|---|---|"]
    rows = [
        f"| `{c.name}` | {c.unit} | {c.meaning}{f' One of {_listed(c.words)}.' if c.words else ''} | {c.null} |"
        for c in COLUMNS
    ]
    return "\n".join([*head, *rows, ""])


def _listed(words: tuple[str, ...]) -> str:
    return ", ".join(f"`{word}`" for word in words)
