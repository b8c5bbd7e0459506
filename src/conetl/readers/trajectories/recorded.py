"""The result of every reader of a trajectory file, and the checks that all readers share."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from conetl.files.documents import first_message
from conetl.geometry import pose as se3
from conetl.model.arrays import Bools, Floats
from conetl.model.base import MAX_HEIGHT_M, MIN_HEIGHT_M, GeodeticPosition
from conetl.model.errors import InputError
from conetl.readers.trajectories.text import Progress
from conetl.readers.trajectories.times import EARLIEST_NS, MAX_AHEAD_NS, Times, clock_problem

Axes = Literal["geodetic", "projected", "geocentric", "local"]
Heights = Literal["ellipsoidal", "sea level", "unstated"]

VERTICAL_FACTOR = 1.5
"""The height of a GNSS fix is about this much less accurate than its horizontal position."""
MAX_LOCAL_M = 1e6
"""Positions in a local frame are nearer to its origin."""
SAME_M, UNSTATED_M, DEGREE_M = 0.1, 1.0, 111_195.0
"""Two records of one time are no farther apart than this and 3 sigmas, 1 m where none are stated; metres of a degree."""
NEAR_SHARE = 0.2
"""How far beside the drive path a record is at most, as a share of its distance to the other one, where it is of a later time."""
LEAST_SECOND, LEAST_SECOND_SHARE = 4, 0.05
"""More records than these, and than this share, contradict another one of their time: not damage, but another receiver."""
MAX_RECORDS = 20_000_000
"""27 hours at 200 Hz; a record takes about 150 bytes. More are read by time only."""
MAX_BAD = 100_000
"""Bad records beyond these are gaps: their reasons are not kept."""


class RecordedTrajectory(NamedTuple):
    """The valid records of one file in the order of their time, and what is wrong with the others."""

    name: str
    """Name of the file, for messages."""
    times_ns: Times
    """(N,) UTC nanoseconds since 1970, strictly rising."""
    positions: Floats
    """(N, 3): latitude, longitude (degrees, WGS 84) and height above its ellipsoid (m); of a local file x, y, z (m)."""
    is_local: bool
    """Whether the positions are those of a level frame whose location `georeference` of drive.yaml states."""
    rotations: Floats | None
    """(N, 3, 3): from the body (forward, left, up) to east, north, up, of a local file to its frame; None where it has none."""
    sigma: Floats
    """(N, 6): east, north, up (m), roll, pitch, yaw (rad); NaN where the file states none."""
    bad: dict[int, str]
    """What is wrong with other records, by their time (UTC ns)."""
    notes: tuple[str, ...] = ()
    """What the user has to know, although the file can be read."""


class Records(NamedTuple):
    """Consecutive records of a file, in its own coordinates."""

    times_ns: Times
    """(N,) UTC ns; 0 where the record has no time."""
    positions: Floats
    """(N, 3): latitude, longitude (degrees), height (m), or x or easting, y or northing, z or height (m); NaN if unreadable."""
    rotations: Floats | None
    """(N, 3, 3) as in `RecordedTrajectory`; NaN if unreadable."""
    sigma: Floats
    """(N, 6) as in `RecordedTrajectory`; zero, negative and NaN: none is stated."""
    wrong: dict[int, str]
    """What is wrong with some of them, by index."""
    names: Iterable[str] | None = None
    """Names of the records in messages, such as `line 12`."""


class Reading(NamedTuple):
    """A file that is being read."""

    pieces: Iterator[Records]
    axes: Axes = "geodetic"
    heights: Heights = "ellipsoidal"
    """What the file says of its heights."""
    yaw_column: str | None = None
    """The column of a table with a yaw, which is read as counter-clockwise from east, pitch positive with the front down."""
    yaw_is_stated: bool = False
    """Whether the user says that it is so."""
    notes: Sequence[str] = ()
    """As in `RecordedTrajectory`; complete once the pieces are read."""
    progress: Progress | None = None
    """Of a text."""
    angle_column: str | None = None
    """The column of a heading or yaw whose unit neither the file nor the user states; it is read as degrees."""


def check_fix(lat_deg: float, lon_deg: float, height_m: float) -> None:
    """Raise ValueError with the name of the first value that no vehicle on a road has."""
    try:
        GeodeticPosition(lat_deg=lat_deg, lon_deg=lon_deg, height_m=height_m)
    except ValidationError as error:
        raise ValueError(first_message(error)) from error
    if lat_deg == 0.0 and lon_deg == 0.0:
        raise ValueError("latitude and longitude are both 0: the receiver had no fix")


def attitude(roll_deg: Floats, pitch_deg: Floats, heading_deg: Floats) -> Floats:
    """(N, 3, 3) body (forward, left, up) to east, north, up of angles of aviation and surveying, degrees.

    heading: clockwise from true north; pitch: positive with the front up; roll: positive with the right side down.
    """
    return se3.rotation_from_rpy(np.radians(roll_deg), -np.radians(pitch_deg), np.radians(90.0 - heading_deg))


def rotations_of_quaternions(wxyz: Floats) -> Floats:
    """(N, 3, 3) of quaternions (N, 4), real part first; NaN where their length is not about 1."""
    usable = np.abs(np.linalg.norm(wxyz, axis=1) - 1.0) <= 1e-2  # NaN fails too
    found = np.full((len(wxyz), 3, 3), np.nan)
    if usable.any():
        found[usable] = Rotation.from_quat(wxyz[usable][:, [1, 2, 3, 0]]).as_matrix()
    return found


def assembled(
    path: Path,
    pieces: Iterable[Records],
    *,
    is_local: bool,
    between_ns: tuple[int, int] | None,
    progress: Progress | None = None,
) -> RecordedTrajectory:
    """The trajectory of WGS 84 or local records, sorted by time, each time once. Raises InputError without a valid record.

    between_ns: only records of these times are kept; progress: of the text that the pieces are read from.
    """
    kept: list[Records] = []
    bad: dict[int, str] = {}
    found_ns: list[int] = []
    count, first_problem, latest_ns = 0, "", time.time_ns() + MAX_AHEAD_NS
    for piece in pieces:
        wrong = problems(piece, is_local)
        good = (piece.times_ns >= EARLIEST_NS) & (piece.times_ns <= latest_ns)
        for i in np.flatnonzero(~good)[:1].tolist():  # records without a time are not kept
            wrong.setdefault(i, f"the time {clock_problem(int(piece.times_ns[i]))}")
        usable = good.copy()
        usable[list(wrong)] = False
        if progress is not None:
            progress.records += len(np.unique(piece.times_ns[usable]))
        if usable.any():
            found_ns += [int(piece.times_ns[usable].min()), int(piece.times_ns[usable].max())]
        first_ns, last_ns = between_ns or (-(2**63), 2**63 - 1)
        inside = good & (piece.times_ns >= first_ns) & (piece.times_ns <= last_ns)
        kept_bad = sorted(i for i in wrong if inside[i])[: MAX_BAD - len(bad)]
        told = [min(wrong), *kept_bad] if wrong and not first_problem else kept_bad
        names = dict(enumerate(piece.names)) if told and piece.names is not None else {}
        for i in told:
            message = f"{names[i]}: {wrong[i]}" if i in names else wrong[i]
            first_problem = first_problem or message
            if inside[i]:
                bad.setdefault(int(piece.times_ns[i]), message)
        inside[list(wrong)] = False
        count += int(inside.sum())
        if count > MAX_RECORDS:
            raise InputError(f"{path}: more than {MAX_RECORDS:,} records: cut the file to the time of the drive")
        if inside.any():
            turned = None if piece.rotations is None else piece.rotations[inside]
            kept.append(Records(piece.times_ns[inside], piece.positions[inside], turned, piece.sigma[inside], {}))
    if not kept:
        # A bad line of another time, such as a header, is not the cause.
        cause = "" if found_ns and not bad else first_problem
        raise InputError(f"{path}: no usable pose: {cause or 'there are no records' + of_images(between_ns, found_ns)}")
    order = np.argsort(np.concatenate([piece.times_ns for piece in kept]), kind="stable")
    times, positions, sigma = (np.concatenate([piece[k] for piece in kept])[order] for k in (0, 1, 3))
    first = np.diff(times, prepend=0) > 0
    for time_ns in times[~first][: MAX_BAD - len(bad)].tolist():
        bad[time_ns] = "a second record of this time"
    if not first.all():
        _require_one_receiver(path, times, positions, sigma, first, is_local)
    sigma[~(np.isfinite(sigma) & (sigma > 0.0))] = np.nan
    parts = [piece.rotations for piece in kept if piece.rotations is not None]
    rotations = np.concatenate(parts)[order[first]] if parts else None
    bad = dict(sorted(bad.items()))
    return RecordedTrajectory(path.name, times[first], positions[first], is_local, rotations, sigma[first], bad)


def _require_one_receiver(path: Path, times: Times, at: Floats, sigma: Floats, first: Bools, is_local: bool) -> None:
    """Raise InputError where many records have the time of another one and a position that contradicts it, or is farther on.

    times (N,), at (N, 3), sigma (N, 6): of all records, by time; first (N,): which of them are the first of their time.
    """
    group = np.cumsum(first) - 1
    other = np.flatnonzero(first)[group]
    metres = 1.0 if is_local else np.column_stack([np.full(len(at), DEGREE_M), DEGREE_M * np.cos(np.radians(at[:, 0]))])
    xy_m = at[:, :2] * metres
    away_m = xy_m - xy_m[other]
    apart_m = np.linalg.norm(away_m, axis=1)
    stated_m = np.nan_to_num(np.linalg.norm(sigma[:, :2], axis=1), nan=UNSTATED_M)
    contradict = apart_m > SAME_M + 3.0 * np.hypot(stated_m, stated_m[other])
    # On the way to the first record of the next time, as where times are rounded.
    step_m = np.diff(xy_m[first], axis=0, append=xy_m[-1:])[group]
    share = (away_m * step_m).sum(axis=1) / np.fmax((step_m**2).sum(axis=1), SAME_M**2)
    aside_m = np.linalg.norm(away_m - share[:, None] * step_m, axis=1)
    contradict |= (apart_m > SAME_M) & (share > 0.0) & (share < 1.0) & (aside_m < NEAR_SHARE * apart_m)
    if contradict.sum() > max(LEAST_SECOND, LEAST_SECOND_SHARE * first.sum()):
        at_first = np.datetime64(int(times[contradict][0]), "ns").astype("datetime64[ms]")
        raise InputError(
            f"{path}: {contradict.sum():,} records have the time of another one, but are up to {apart_m.max():.1f} m off, "
            f"the first at {at_first} UTC: two receivers (NMEA: talkers) or logs in one file, or times that were rounded, here "
            f"to {np.gcd.reduce(np.diff(times)) * 1e-9:g} s. Keep the records of one receiver, with their whole times"
        )


def problems(piece: Records, is_local: bool) -> dict[int, str]:
    """What is wrong with records of WGS 84 or of a local frame, by index."""
    wrong = dict(piece.wrong)
    good = np.ones(len(piece.positions), bool)
    good[list(wrong)] = False

    def add(mask: Any, text: str) -> None:
        wrong.update(dict.fromkeys(np.flatnonzero(mask & good).tolist(), text))
        good[mask] = False

    a, b, c = piece.positions.T
    if is_local:
        usable = np.abs(piece.positions) < MAX_LOCAL_M  # NaN fails too
        add(~usable.all(axis=1), f"expected x, y, z as finite metres below {MAX_LOCAL_M:,.0f}")
    else:
        add(~(np.abs(a) <= 90.0), "the latitude is not a number between -90 and 90 degrees")
        add(~(np.abs(b) <= 180.0), "the longitude is not a number between -180 and 180 degrees")
        add(
            ~((c >= MIN_HEIGHT_M) & (c <= MAX_HEIGHT_M)),
            f"the height is not between {MIN_HEIGHT_M:g} and {MAX_HEIGHT_M:g} m",
        )
        add((a == 0.0) & (b == 0.0), "latitude and longitude are both 0: the receiver had no fix")
        add(
            (np.abs(a) <= np.pi / 2) & (np.abs(b) <= np.pi),
            "the position is in the Atlantic: are latitude and longitude in radians? Then put trajectory: {angles: radians} into "
            "drive.yaml",
        )
    if piece.rotations is not None:
        add(
            ~np.isfinite(piece.rotations).all(axis=(1, 2)),
            "the attitude is not one of finite numbers (a quaternion: of length 1)",
        )
    return wrong


def of_images(between_ns: tuple[int, int] | None, found_ns: Sequence[int]) -> str:
    """What to add to the message that a trajectory has no records of the time of the images (UTC ns), and what may be wrong.

    found_ns: with the first and the last time that the file has.
    """
    if between_ns is None or not found_ns:
        return ""
    first, last, own_first, own_last = (
        np.datetime64(ns, "ns").astype("datetime64[s]") for ns in (*between_ns, min(found_ns), max(found_ns))
    )
    return (
        f" between {first} and {last} UTC, the time of the images; its own are from {own_first} to {own_last} UTC. Are its times "
        "local times (trajectory.time: Europe/Berlin) or GPS time, or are the times of the images wrong (for videos: "
        "images.start; for local times: timestamps_timezone: Europe/Berlin)?"
    )
