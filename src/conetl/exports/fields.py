"""What every field of a file, of the OGC API and of a QGIS layer means, for `docs/reference/fields.md` and QGIS."""

from __future__ import annotations

from typing import NamedTuple


class Field(NamedTuple):
    """One field."""

    alias: str
    """Heading, as in QGIS."""
    unit: str
    """Empty for ids, words and counts."""
    meaning: str


FIELDS = {
    "feature_id": Field("Feature", "", "The cone: a UUID, the same in all its versions, files and services."),
    "version": Field("Version", "", "Number of the state of the cone on the road, from 1."),
    "category": Field("Category", "", "Kind of object, such as traffic_cone or lane_marking."),
    "existence_probability": Field(
        "Existence probability", "0 to 1", "That it stands there, after the last drive to which it was visible."
    ),
    "object_height_m": Field("Height of the object", "m", "Of the cone itself, from its foot to its tip."),
    "height_m": Field(
        "Height of the object (old name)", "m", "In files the same as object_height_m; kept for programs that read it."
    ),
    "height_sigma_m": Field("Sigma of the object's height", "m", "Standard deviation of object_height_m."),
    "ground_height_m": Field("Height of the ground", "m", "Of the cone's foot, in the height system of height_system."),
    "height_system": Field(
        "Height system", "", "`ellipsoidal` (above the WGS 84 ellipsoid), or `EPSG:` and the code of a vertical CRS."
    ),
    "ellipsoidal_height_m": Field(
        "Ellipsoidal height of the ground",
        "m",
        "Of the cone's foot above the WGS 84 ellipsoid, whatever height_system is.",
    ),
    "lon_deg": Field("Longitude", "degrees", "WGS 84."),
    "lat_deg": Field("Latitude", "degrees", "WGS 84."),
    "easting_m": Field("Easting", "m", "Of the cone's foot, in the map's CRS; in files in that of --crs, if given."),
    "northing_m": Field("Northing", "m", "Likewise."),
    "sigma_e_m": Field("Sigma east", "m", "Standard deviation of the position along the easting axis."),
    "sigma_n_m": Field("Sigma north", "m", "Along the northing axis."),
    "sigma_u_m": Field("Sigma up", "m", "Of the ground's height."),
    "sigma_m": Field("Horizontal sigma", "m", "Root of the mean of both horizontal variances (QGIS)."),
    "cov_en_m2": Field("Covariance east, north", "m^2", "Of the position."),
    "cov_eu_m2": Field("Covariance east, up", "m^2", "Of the position."),
    "cov_nu_m2": Field("Covariance north, up", "m^2", "Of the position."),
    "width_m": Field("Width", "m", "Of the paint of a lane marking, across the line."),
    "width_sigma_m": Field("Sigma of the width", "m", "Standard deviation of width_m."),
    "colour": Field("Colour", "", "Of the paint: white, yellow or other."),
    "pattern": Field("Pattern", "", "solid or dashed; a dashed line is one line through its gaps."),
    "dash_m": Field("Dash", "m", "Length of one dash; null of solid lines."),
    "gap_m": Field("Gap", "m", "Between two dashes; null of solid lines."),
    "sigma_lateral_m": Field(
        "Lateral sigma", "m", "Standard deviation across the line: that of the vertex with the largest one."
    ),
    "length_m": Field("Length", "m", "Of this stretch of a lane marking, at most about 10 m."),
    "first_seen_at": Field("First seen", "UTC", "First frame pair in which it was observed."),
    "last_seen_at": Field("Last seen", "UTC", "Last frame pair of this version."),
    "observation_count": Field("Observations", "", "Frame pairs in which it was observed."),
    "seen_count": Field("Drives that observed it", "", "Until the instant of the file; imported maps do not count."),
    "missed_count": Field("Drives that did not observe it", "", "To which it was visible."),
    "valid_from": Field("Valid from", "UTC", "Start of the period in which this version is true on the road."),
    "valid_to": Field("Valid to", "UTC", "End of that period; null while it lasts."),
    "system_from": Field(
        "In the database from", "UTC", "Start of the period in which the database held this row (histories)."
    ),
    "system_to": Field("In the database to", "UTC", "End of that period; null while it lasts."),
    "changeset_id": Field("Changeset", "", "The changeset that made this version: a UUID."),
    "changeset_no": Field("Number of the changeset", "", "Counts the changesets of a map from 1."),
    "drive_id": Field("Drive", "", "The drive, or the imported file, of the changeset."),
    "change": Field("Change", "", "added, confirmed, moved, removed, height_changed, split, merged or missed."),
    "changed_at": Field("Changed", "UTC", "Instant of the change on the road."),
    "shift_m": Field("Shift", "m", "Horizontal distance between the old and the new position."),
    "present": Field("Present", "", "False in the version that says that the cone is gone (histories)."),
    "suppressed": Field("Suppressed", "", "True where a person decided that nothing stands here (histories)."),
    "old_version": Field("Old version", "", "Of the earlier state; null for an added cone."),
    "new_version": Field("New version", "", "Of the later state; null for a removed cone."),
    "old_easting_m": Field("Old easting", "m", "Of the earlier state."),
    "old_northing_m": Field("Old northing", "m", "Of the earlier state."),
    "old_ground_height_m": Field("Old height of the ground", "m", "Of the earlier state, in height_system."),
    "old_ellipsoidal_height_m": Field("Old ellipsoidal height of the ground", "m", "Of the earlier state (OGC API)."),
    "old_height_m": Field(
        "Old height of the ground (old name)", "m", "The same as old_ground_height_m; kept for programs that read it."
    ),
}


def as_markdown() -> str:
    """The tables of `docs/reference/fields.md`."""
    rows = [f"| `{name}` | {field.unit} | {field.meaning} |" for name, field in FIELDS.items()]
    head = ["## Fields", "", "| field | unit | meaning |", "|---|---|---|"]
    return "\n".join([*head, *rows, ""])
