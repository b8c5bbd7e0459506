"""What a column of a table may be, by its name and its unit.

Names are compared without case, accents, punctuation and words that say only whose value it is (`Höhe [m]`, `GPS (Lat.)`,
`UTC_Year`). A unit stands in brackets, at the end of the name, or in a line of its own below the names.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from conetl.files.documents import shown
from conetl.model.errors import InputError
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import ANGLES, PARTS, TIMES, Column

_ALIASES = {
    "time": "time timestamp timestamps stamp t utc utctime timeutc datetime utcdatetime capturedat unixtime unix "
        "epoch posixtime zeit zeitstempel uhrzeit utczeit gpszeit datumzeit timeofday gpst jst "
        "gpstime gpstimestamp gpsdatetime gpsutc tow gpstow sow gpssow secondsofweek timeofweek gpsseconds gpssecs "
        "correctedtime localtime timelocal localdatetime localtimestamp ortszeit",
    "date": "date utcdate datum tag gpsdate gpsdatum day localdate",
    "week": "week gpsweek weekno weeknumber gpswk wn",
    "year": "year yyyy jahr", "month": "month monat", "hour": "hour hours hh stunde", "minute": "minute minutes min",
    "second": "second seconds sec ss sekunde", "nanosecond": "nano nanosecond nanoseconds nanos",
    "lat": "lat latitude breite breitengrad geobreite latitud phi latitudens latns",
    "lon": "lon long lng longitude laenge laengengrad geolaenge longitud lambda longitudeew lonew",
    "height": "height h hell ellh ellipsoidalheight ellipsoidheight heightellipsoidal heightaboveellipsoid hae alt altitude "
        "hoehe ellhoehe ellipsoidischehoehe althae altitudehae heighthae hgthae altellipsoid altitudeellipsoid",
    "height_msl": "hmsl heightmsl altmsl altitudemsl mslaltitude mslheight msl orthometricheight horth elevation ele "
        "elev nhn hoehenhn hnhn",
    "separation": "undulation undul geoidundulation geoidseparation geoidsep geoidheight geoidhgt geoidalseparation",
    "height_system": "altitudesystem heightsystem altsystem",
    "easting": "easting east e rechtswert ostwert utmeast utme",
    "northing": "northing north n hochwert nordwert utmnorth utmn",
    "x": "x px posx positionx tx xecef ecefx",
    "y": "y py posy positiony ty yecef ecefy",
    "z": "z pz posz positionz tz zecef ecefz",
    "roll": "roll rollangle rollwinkel",
    "pitch": "pitch pitchangle nick nickwinkel",
    "heading": "heading head hdg hdt trueheading azimuth azimut azi",
    "yaw": "yaw",
    "qw": "qw quatw orientationw",
    "qx": "qx quatx orientationx",
    "qy": "qy quaty orientationy",
    "qz": "qz quatz orientationz",
    "sigma_e": "sigmae sde se sdeast eastsd stde stdeast eaststd eaststddev sigmaeast easterror",
    "sigma_n": "sigman sdn sn sdnorth northsd stdn stdnorth northstd northstddev sigmanorth northerror",
    "sigma_u": "sigmau sdu su sh sdup sdheight heightsd stdu stdup stdheight upstd upstddev sigmaup sigmaheight "
        "vacc verticalaccuracy stdvertical sdv verticalsd sdh sdvert",
    "sigma_horizontal": "sigmahorizontal hacc horizontalaccuracy sdhoriz horizontalsd stdhorizontal accuracy posaccuracy "
        "poshacc posu",
    "sigma_roll": "sigmaroll rollsd rllsd sdroll stdroll rollstd rollaccuracy sr",
    "sigma_pitch": "sigmapitch pitchsd ptchsd sdpitch stdpitch pitchstd pitchaccuracy sp",
    "sigma_heading": "sigmaheading headingsd hdngsd sdheading stdheading headingstd headingaccuracy sigmayaw yawsd sdyaw "
        "stdyaw yawstd shd",
    "quality": "q", "sdx": "sdx", "sdy": "sdy", "sdz": "sdz", "sdxy": "sdxy", "sdyz": "sdyz", "sdzx": "sdzx",
}  # fmt: skip
_ROLE_OF = {alias: role for role, aliases in _ALIASES.items() for alias in aliases.split()}
#: Words that say only whose value it is, and those of a receiver, which has no attitude.
_QUALIFIERS = frozenset({
    "gps", "gnss", "ins", "imu", "utc", "pos", "position", "angle", "nav", "wgs84", "field", "header", "fix",
})  # fmt: skip
_SATELLITES = frozenset({"gps", "gnss", "pos"})
_ATTITUDE = frozenset({"roll", "pitch", "heading", "yaw"})
_DEGREES = {
    "deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0, "d": 1.0, "rad": 57.29577951308232, "radians": 57.29577951308232,
    "arcmin": 1 / 60, "amin": 1 / 60, "arcsec": 1 / 3600, "asec": 1 / 3600,
}  # fmt: skip
_LENGTHS = {"m": 1.0, "meter": 1.0, "meters": 1.0, "metres": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3}
_TIMES = {"s": "s", "sec": "s", "secs": "s", "seconds": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns"}
_REFUSED = frozenset({"ft", "feet", "usft", "dm", "gon", "grad", "grads", "mil", "mils", "mrad", "mdeg", "semicircles"})
_NO_UNITS = frozenset({"utc", "gps", "wgs84", "msl", "", "-", "ellipsoidal", "gpst", "week", "weeks"})
_UNITS = frozenset({*_DEGREES, *_LENGTHS, *_TIMES, *_REFUSED, *_NO_UNITS})
_DMS = re.compile(r"(?:\+/-\s*)?(?:d\s*m\s*s|deg\s+min\s+sec|dms|d'\"?)", re.IGNORECASE)
_BRACKET = re.compile(r"[\[(]([^\[\]()]*)[\])]")
#: Characters of a column's name that may be known.
_LONGEST_NAME = 60
#: What heights are above, as names say it; of these the sea.
_REFERENCE = re.compile(r"above|over|ueber|mean|ellipsoid(al)?|wgs84|egm\d*|navd\d*|nhn|a?msl|sea|level")
_ABOVE_SEA = re.compile(r"msl|sea.?level|egm|navd|nhn|orthom")
#: Zones of times in brackets: CET, MEZ, UTC+1, Europe/Berlin.
_ZONE = re.compile(r"[A-Z]{2,4}T|MES?Z|TAI|(?:UTC|GMT) ?[+-] ?\d.*|[A-Z]\w+/\w+")
#: Names of columns with the zone of the times.
_ZONE_NAMES = frozenset({"tz", "timezone", "zeitzone", "zone", "utcoffset", "offsetutc", "tzoffset"})
#: Names of u-blox's protocol, whose unit is mm, which other programs give in metres.
_MM_OR_M = frozenset({"hacc", "vacc", "pacc"})
_METRES_LIKE = 10.0


def _plain(text: str) -> str:
    """Lower case, umlauts as two letters, other accents removed."""
    text = text.lower().translate({ord("ä"): "ae", ord("ö"): "oe", ord("ü"): "ue", ord("ß"): "ss"})
    return "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))


def _squeezed(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", _plain(text))


def unit_of(name: str) -> str:
    """The unit in the last brackets or after the last underscore or blank, as far as it is one."""
    brackets = _BRACKET.findall(name)
    words = re.split(r"[_ ]", name.strip())
    word = (brackets[-1] if brackets else words[-1] if words[1:] else "").strip().lower()
    in_brackets = brackets and _DMS.fullmatch(word)
    return word if in_brackets or (word in _UNITS and (brackets or word != "d")) else ""


@lru_cache(maxsize=10_000)
def role_of(name: str) -> str | None:
    """Our name of a column, None where it is unknown."""
    if len(name) > _LONGEST_NAME:
        return None
    unit = unit_of(name)
    base = re.sub(r"[\[(]\s*" + re.escape(unit) + r"\s*[\])]", "", name, flags=re.IGNORECASE)
    whole = _squeezed(base)
    short = whole.removesuffix(_squeezed(unit)) if unit and base == name else whole
    words = re.split(r"[^a-z0-9]+", _plain(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", base)))
    own = "".join(word for word in words if word not in _QUALIFIERS)
    qualified = _ROLE_OF.get(own) if len(own) > 2 else None  # imu_x is no position
    if qualified in _ATTITUDE and not _SATELLITES.isdisjoint(words):  # a course over ground
        qualified = None
    role = _ROLE_OF.get(whole) or qualified or _ROLE_OF.get(short)
    if role is None and _in_brackets(name, _ZONE):
        role = "time" if role_of(_BRACKET.sub("", name)) == "time" else None
    elif role is None:
        rest = _ROLE_OF.get("".join(word for word in words if not _REFERENCE.fullmatch(word)))
        role = "height" if rest == "height" else None
    if role == "height":
        return "height_msl" if _ABOVE_SEA.search(_plain(name)) else role
    kinds = {_kind_of_role(role), _kind_of_unit(unit)} - {""}
    return role if base == name or len(kinds) < 2 else None  # Heading [M]


def _in_brackets(name: str, pattern: re.Pattern[str]) -> bool:
    return any(pattern.fullmatch(text.strip()) for text in _BRACKET.findall(name))


def is_exact(name: str) -> bool:
    """Whether a name is one of ours without words that say whose value it is."""
    return _QUALIFIERS.isdisjoint(re.split(r"[^a-z0-9]+", _plain(name)))


def is_short_sigma(name: str) -> bool:
    """Whether a name is one of two or three letters that a sigma may have beside others of its kind."""
    return _squeezed(_BRACKET.sub("", name)) in {"sn", "se", "su", "sh", "sr", "sp", "shd"}


def is_unit(text: str) -> bool:
    """Whether a text is a unit, or that of no unit, in brackets or not."""
    word = text.strip().strip("[]()").strip().lower()
    return word in _UNITS or _DMS.fullmatch(word) is not None


def _kind_of_unit(unit: str) -> str:
    word = unit.strip().strip("[]()").strip().lower()
    for kind, units in (("time", _TIMES), ("angle", _DEGREES), ("length", {**_LENGTHS, "ft": 1, "usft": 1, "feet": 1})):
        if word in units:
            return kind
    return "angle" if _DMS.fullmatch(word) else "week" if word.startswith("week") else ""


def _kind_of_role(role: str | None) -> str:
    if role is None or role in {"date", "quality", "height_system", *PARTS} or role.startswith("q"):
        return ""
    return role if role in {"time", "week"} else "angle" if role in ANGLES else "length"


def is_dms(unit: str) -> bool:
    """Whether an angle has three values: degrees, minutes, seconds."""
    return _DMS.fullmatch(unit.strip().strip("[]()").strip()) is not None


def aligned(names: Sequence[tuple[str, float]], units: Sequence[tuple[str, float]]) -> list[str]:
    """The unit of each column, empty where it has none: units of a line of their own, in the order of the columns.

    names, units: with the positions of their middles in the lines. Some columns may have no unit: those of which a unit of the
    expected kind is not missed, and of these those that no unit stands below. There are at most as many units as names.
    """
    spare = len(names) - len(units)
    # Cost of the first i names with the first i - k units, k of them without one; and whether the last one has one.
    impossible: tuple[float, list[str]] = (float("inf"), [])
    best: list[tuple[float, list[str]]] = [(0.0, []), *[impossible] * spare]
    for i, (name, at) in enumerate(names):
        kind = _kind_of_role(role_of(name))
        after: list[tuple[float, list[str]]] = []
        for k in range(spare + 1):
            without = (best[k - 1][0] + 100.0 * bool(kind), [*best[k - 1][1], ""]) if k else impossible
            having = impossible
            if 0 <= i - k < len(units):
                unit, below = units[i - k]
                differs = kind not in {"", _kind_of_unit(unit)}
                having = (best[k][0] + 100.0 * differs + min(abs(at - below), 50.0), [*best[k][1], unit])
            after.append(min(without, having, key=lambda one: one[0]))
        best = after
    return best[spare][1]


def column_of(
    path: Path, role: str, at: int, name: str, unit: str, settings: TrajectoryFile, *, required: bool = False
) -> Column:
    """A column with the factor of its unit. Raises InputError for units that are not supported.

    required: the file states all units; else what is not one of this column's is part of its name.
    """
    word = unit.strip().strip("[]()").strip().lower()
    if role in TIMES or role in PARTS or _kind_of_role(role) == "":
        return Column(at, name, unit=_TIMES.get(word))
    if role in ANGLES and _DMS.fullmatch(word):
        return Column(at, name, dms=True)
    units = _DEGREES if role in ANGLES else _LENGTHS
    if word in _REFUSED or (required and word not in units):
        raise InputError(
            f"{path}: column {shown(name)}: the unit {shown(word)} is not supported; write degrees, radians or metres"
        )
    unstated = "rad" if role in ANGLES and settings.angles == "radians" else ""
    return Column(at, name, units.get(word or unstated, 1.0), unit=word or None)


def require_unit(path: Path, role: str, column: Column, values: Sequence[float]) -> None:
    """Raise InputError for a sigma that may be in mm or in metres: of a name of u-blox's protocol, without a unit."""
    name = _squeezed(column.name)
    if role.startswith("sigma") and column.unit is None and name in _MM_OR_M and values:
        middle = sorted(values)[len(values) // 2]
        if middle >= _METRES_LIKE or all(value == round(value) for value in values):
            raise InputError(
                f"{path}: column {shown(column.name)}: is {middle:g} in mm, as receivers of u-blox give it, or in metres? Put "
                f"trajectory: {{columns: {{{role}: '{column.name[:60]} [mm]'}}}}, or [m], into drive.yaml"
            )


def scale_of(name: str) -> str:
    """How a time is counted by the name of its column, see `TableLayout.scale`."""
    plain = _squeezed(name)
    if plain in {"gpst", "jst"}:
        return {"gpst": "gps", "jst": "Asia/Tokyo"}[plain]
    if re.search("lo[ck]al|ortszeit", plain) or (_in_brackets(name, _ZONE) and "gps" not in plain):
        return "local"
    if "utc" in plain or "unix" in plain or "posix" in plain:
        return "UTC"
    return "?" if "gps" in plain or "gnss" in plain else ""


def is_zone(name: str) -> bool:
    """Whether a column is the zone, or the offset from UTC, of the times."""
    return _squeezed(name) in _ZONE_NAMES
