"""A known trajectory, written in every format as its maker writes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from functools import reduce
from pathlib import Path
from typing import NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from conetl.readers.trajectories.settings import TrajectoryFile

Array = NDArray[np.float64]
#: 2024-02-07 09:15:00 UTC, a Wednesday; GPS is 18 s ahead.
START = datetime(2024, 2, 7, 9, 15, tzinfo=UTC)
WEEK, TOW = 2300, 3 * 86_400 + 9 * 3600 + 15 * 60 + 18
GEOID_M = 47.93
COUNT = 40
STEP_MS = 100


class Known(NamedTuple):
    """What was written: N records."""

    times_ns: NDArray[np.int64]
    llh: Array
    """Latitude, longitude (degrees), ellipsoidal height."""
    rph: Array
    """Roll (right side down), pitch (front up), heading (clockwise from north), degrees."""
    sigma: Array
    """East, north, up (m), roll, pitch, heading (degrees)."""


def known(count: int = COUNT, start: datetime = START) -> Known:
    k = np.arange(count, dtype=np.float64)
    heading = 30.0 + 40.0 * np.sin(k / 15.0)
    llh = np.column_stack([49.0 + 8e-6 * k, 8.43 + 6e-6 * k + 1e-6 * np.sin(k), 116.1 + 0.01 * k])
    rph = np.column_stack([2.5 * np.sin(k / 5.0), 1.5 * np.cos(k / 7.0), heading])
    sigma = np.column_stack(
        [0.011 + 1e-4 * k, 0.013 + 1e-4 * k, 0.025 + 1e-4 * k, 0.01 + 0 * k, 0.02 + 0 * k, 0.05 + 0 * k]
    )
    times = np.int64(start.timestamp()) * 10**9 + np.arange(count) * STEP_MS * 10**6
    return Known(times, llh, rph, sigma)


def local_poses(t: Known) -> tuple[Array, Array]:
    """x, y, z (N, 3) and quaternions w, x, y, z (N, 4) of the same drive, in a frame of its own."""
    xyz = (t.llh - t.llh[0]) * [111_000.0, 73_000.0, 1.0]
    turn = Rotation.from_euler("ZYX", np.column_stack([90 - t.rph[:, 2], -t.rph[:, 1], t.rph[:, 0]]), degrees=True)
    return xyz, turn.as_quat()[:, [3, 0, 1, 2]]


def digits_of(t: Known) -> int:
    """Decimals of its times in seconds: milliseconds as most programs write them, else all."""
    return 9 if (t.times_ns % 10**6).any() else 3


def stamps(form: str, t: Known, shift_s: float = 0.0, digits: int | None = None) -> list[str]:
    """Times as texts, with a fraction of the second."""
    found = []
    for time_ns in t.times_ns.tolist():
        seconds, rest = divmod(time_ns + round(shift_s * 1e9), 10**9)
        found.append(
            f"{datetime.fromtimestamp(seconds, UTC):{form}}.{rest:09d}"[: (digits or digits_of(t)) - 9 or None]
        )
    return found


def leap_s(t: Known) -> int:
    """By how much GPS is ahead of UTC, from 2009 to 2012 and since 2017."""
    return 18 if t.times_ns[0] > datetime(2017, 1, 1, tzinfo=UTC).timestamp() * 1e9 else 15


def gps_time(t: Known) -> tuple[list[int], list[str]]:
    """Weeks, and seconds of them as texts."""
    since_1980 = t.times_ns + (leap_s(t) - 315_964_800) * 10**9
    weeks, tows = np.divmod(since_1980, 604_800 * 10**9)
    return weeks.tolist(), [f"{tow // 10**9}.{tow % 10**9:09d}"[: digits_of(t) - 9 or None] for tow in tows.tolist()]


def dms(value: float, seconds: int = 5, sep: str = " ") -> str:
    """Degrees, minutes, seconds."""
    whole = round(abs(value) * 3600, seconds)
    d, rest = divmod(whole, 3600)
    m, s = divmod(rest, 60)
    return f"{'-' if value < 0 else ''}{int(d)}{sep}{int(m):02d}{sep}{s:0{seconds + 3}.{seconds}f}"


def write(folder: Path, name: str, lines: list[str], end: str = "\n") -> Path:
    path = folder / name
    path.write_text(end.join(lines) + end, newline="", encoding="utf-8")
    return path


# --------------------------------------------------------------------------- RTKLIB

RTKLIB_HEADER = [
    "% program   : RTKPOST ver.demo5 b34g",
    "% inp file  : C:\\data\\rover.obs",
    "% obs start : 2024/02/07 09:15:18.0 GPST (week2300 292518.0s)",
    "% pos mode  : Kinematic",
    "%",
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)",
]


def write_rtklib(
    folder: Path,
    t: Known | None = None,
    *,
    system: str = "GPST",
    form: str = "llh",
    tow: bool = False,
    sep: str = " ",
    quality: int = 1,
) -> Path:
    t = t or known()
    shift = {"GPST": leap_s(t), "UTC": 0.0, "JST": 9 * 3600.0}[system]
    weeks = [f"{week}{sep}{tow_s}" for week, tow_s in zip(*gps_time(t), strict=True)]
    times = weeks if tow else stamps("%Y/%m/%d %H:%M:%S", t, shift)
    if form == "xyz":
        places = ["x-ecef(m)", "y-ecef(m)", "z-ecef(m)"]
        sigmas = ["sdx(m)", "sdy(m)", "sdz(m)", "sdxy(m)", "sdyz(m)", "sdzx(m)"]
        lon, lat = np.radians(t.llh[:, 1]), np.radians(t.llh[:, 0])
        xyz = np.column_stack(Transformer.from_crs(4979, 4978).transform(*t.llh.T))
        rows = []
        for i in range(len(t.llh)):
            e = np.array([-math.sin(lon[i]), math.cos(lon[i]), 0.0])
            n = np.array([-math.sin(lat[i]) * math.cos(lon[i]), -math.sin(lat[i]) * math.sin(lon[i]), math.cos(lat[i])])
            axes = np.column_stack([e, n, np.cross(e, n)])
            c = axes @ np.diag(t.sigma[i, :3] ** 2) @ axes.T
            roots = np.sign(c) * np.sqrt(np.abs(c))
            sds = [roots[0, 0], roots[1, 1], roots[2, 2], roots[0, 1], roots[1, 2], roots[2, 0]]
            rows.append([*(f"{v:.4f}" for v in xyz[i]), str(quality), "12", *(f"{v:.9f}" for v in sds), "0.00", "50.0"])
    else:
        unit = "(d'\")" if form == "dms" else "(deg)"
        places = [f"latitude{unit}", f"longitude{unit}", "height(m)"]
        sigmas = ["sdn(m)", "sde(m)", "sdu(m)", "sdne(m)", "sdeu(m)", "sdun(m)"]
        angle: Callable[[float], str] = (lambda v: dms(v, 5, sep)) if form == "dms" else (lambda v: f"{v:.9f}")
        rows = [
            [angle(lat), angle(lon), f"{h:.4f}", str(quality), "12", f"{n:.4f}", f"{e:.4f}", f"{u:.4f}",
             "0.0010", "-0.0010", "0.0020", "0.00", "50.0"]
            for (lat, lon, h), (e, n, u) in zip(t.llh, t.sigma[:, :3], strict=True)
        ]  # fmt: skip
    gap = "  " if sep == " " else sep
    lines = [*RTKLIB_HEADER, "%  " + gap.join([f"{system}         ", *places, "Q", "ns", *sigmas, "age(s)", "ratio"])]
    return write(
        folder, "rover.pos", [*lines, *(gap.join([time, *row]) for time, row in zip(times, rows, strict=True))], "\r\n"
    )


# --------------------------------------------------------------------------- Applanix, Inertial Explorer


def sbet_rows(t: Known, wander_rad: float = 0.3) -> Array:
    rows = np.zeros((len(t.llh), 17))
    rows[:, 0] = np.array(gps_time(t)[1], dtype=np.float64)
    rows[:, 1:3], rows[:, 3] = np.radians(t.llh[:, :2]), t.llh[:, 2]
    rows[:, 7:9], rows[:, 9] = np.radians(t.rph[:, :2]), np.radians(t.rph[:, 2]) + wander_rad
    rows[:, 10] = wander_rad
    return rows


def write_sbet(folder: Path, t: Known | None = None) -> Path:
    t = t or known()
    path = folder / "sbet_mission1.out"
    sbet_rows(t).astype("<f8").tofile(path)
    sigmas = np.zeros((len(t.llh), 10))
    sigmas[:, 0] = sbet_rows(t)[:, 0]
    sigmas[:, 1:4] = t.sigma[:, [1, 0, 2]]
    sigmas[:, 7:] = t.sigma[:, 3:] * 60
    sigmas.astype("<f8").tofile(folder / "smrmsg_mission1.out")
    return path


def write_inertial_explorer(folder: Path, t: Known | None = None, *, angles: str = "deg") -> Path:
    t = t or known()
    unit = "(+/-D M S)" if angles == "dms" else "(deg)"
    angle: Callable[[float], str] = (lambda v: dms(v, 6)) if angles == "dms" else (lambda v: f"{v:.10f}")
    lines = [
        "Project:     20240207_van", "Program:     Inertial Explorer Version 8.90.6611", "Profile:     conetl",
        "Source:      GNSS/INS Epochs(Smoothed TC Combined)", "SolutionType: Tightly coupled",
        "Datum:       WGS84, (processing datum)",
        f"UTC Offset:  {leap_s(t)} s", "",
        "     GPSTime  Week       Latitude      Longitude        H-Ell         Roll        Pitch      Heading  SDNorth   SDEast "
        "SDHeight    RollSD   PitchSD  HeadingSD  Q",
        f"       (sec) (weeks)  {unit}  {unit}  (m)  (deg)  (deg)  (deg)  (m)  (m)  (m)  (deg)  (deg)  (deg)  ( )",
    ]  # fmt: skip
    for i, (week, tow) in enumerate(zip(*gps_time(t), strict=True)):
        (lat, lon, h), (r, p, y), (e, n, u, sr, sp, sy) = t.llh[i], t.rph[i], t.sigma[i]
        lines.append(
            f"  {tow}  {week} {angle(lat)} {angle(lon)} {h:12.4f} {r:12.9f} {p:12.9f} {y:13.9f} {n:8.4f} {e:8.4f} "
            f"{u:8.4f} {sr:.6f} {sp:.6f} {sy:.6f} 1"
        )
    return write(folder, "van.txt", lines, "\r\n")


# --------------------------------------------------------------------------- NMEA, GPX


def sentence(body: str) -> str:
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode(), 0):02X}"


def minutes(value: float, digits: int, sides: str) -> str:
    whole, rest = divmod(abs(value), 1.0)
    return f"{int(whole):0{digits}d}{rest * 60:011.8f},{sides[int(value < 0)]}"


def write_nmea(folder: Path, t: Known | None = None, *, rmc_first: int = 0, attitude: bool = True) -> Path:
    t = t or known()
    lines = []
    digits = 9 if (t.times_ns % 10**7).any() else 2
    for i, (day, clock) in enumerate(zip(stamps("%d%m%y", t), stamps("%H%M%S", t, digits=digits), strict=True)):
        (lat, lon, h), (r, p, y), (e, n, u, sr, sp, sy) = t.llh[i], t.rph[i], t.sigma[i]
        where = f"{minutes(lat, 2, 'NS')},{minutes(lon, 3, 'EW')}"
        lines.append(sentence(f"GNGGA,{clock},{where},4,17,0.7,{h - GEOID_M:.4f},M,{GEOID_M},M,1.0,0123"))
        if i >= rmc_first:
            lines.append(sentence(f"GNRMC,{clock},A,{where},12.3,30.0,{day[:6]},,,R,V"))
        lines.append(sentence(f"GNGST,{clock},0.02,0.015,0.01,30.0,{n:.4f},{e:.4f},{u:.4f}"))
        if attitude:
            lines.append(sentence(f"PASHR,{clock},{y:.9f},T,{r:+.9f},{p:+.9f},+0.00,{sr:.3f},{sp:.3f},{sy:.3f},1,1"))
        lines.append(sentence("GNGSA,A,3,01,02,03,,,,,,,,,,1.2,0.7,1.0,1"))
    return write(folder, "log.nmea", lines, "\r\n")


def write_gpx(folder: Path, t: Known | None = None, *, geoid: bool = True) -> Path:
    t = t or known()
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<gpx version="1.1" creator="receiver" xmlns="http://www.topografix.com/GPX/1/1">', "<trk><name>van</name><trkseg>",
    ]  # fmt: skip
    for (lat, lon, h), stamp in zip(t.llh, stamps("%Y-%m-%dT%H:%M:%S", t), strict=True):
        extra = f"<geoidheight>{GEOID_M}</geoidheight>" if geoid else ""
        lines.append(
            f'<trkpt lat="{lat:.10f}" lon="{lon:.10f}"><ele>{h - geoid * GEOID_M:.4f}</ele><time>{stamp}Z</time>{extra}</trkpt>'
        )
    return write(folder, "van.gpx", [*lines, "</trkseg></trk>", "</gpx>"])


# --------------------------------------------------------------------------- OXTS, local, tables


def write_oxts(folder: Path, t: Known | None = None) -> Path:
    t = t or known()
    (folder / "oxts/data").mkdir(parents=True)
    for i in range(len(t.llh)):
        r, p, y = np.radians([t.rph[i, 0], -t.rph[i, 1], 90.0 - t.rph[i, 2]])
        values = [*t.llh[i], r, p, y, *[0.0] * 17, 0.011, *[0.0] * 6]
        (folder / f"oxts/data/{i:010d}.txt").write_text(" ".join(repr(float(v)) for v in values))
    (folder / "oxts/timestamps.txt").write_text("\n".join(stamps("%Y-%m-%d %H:%M:%S", t, digits=9)) + "\n")
    return folder / "oxts"


def write_tum(folder: Path, t: Known | None = None) -> Path:
    t = t or known()
    xyz, wxyz = local_poses(t)
    rows = np.column_stack([xyz, wxyz[:, [1, 2, 3, 0]]])
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    lines += [
        f"{ns // 10**9}.{ns % 10**9:09d} " + " ".join(f"{v:.9f}" for v in row)
        for ns, row in zip(t.times_ns.tolist(), rows, strict=True)
    ]
    return write(folder, "trajectory.txt", lines)


def write_euroc(folder: Path, t: Known | None = None) -> Path:
    t = t or known()
    xyz, wxyz = local_poses(t)
    lines = [
        "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],v_RS_R_x [m s^-1]"
    ]
    lines += [
        f"{ns}," + ",".join(f"{v:.9f}" for v in (*p, *q, 0.0))
        for ns, p, q in zip(t.times_ns.tolist(), xyz, wxyz, strict=True)
    ]
    return write(folder, "data.csv", lines)


def write_csv(folder: Path, t: Known | None = None) -> Path:
    t = t or known()
    lines = [
        "# exported",
        "time,lat,lon,h_ell,roll,pitch,heading,sigma_e,sigma_n,sigma_u,sigma_roll,sigma_pitch,sigma_heading,note",
    ]
    for stamp, values in zip(stamps("%Y-%m-%dT%H:%M:%S", t), np.column_stack([t.llh, t.rph, t.sigma]), strict=True):
        lines.append(f"{stamp}Z," + ",".join(f"{v:.10f}" for v in values) + ',"a, b"')
    return write(folder, "drive.csv", lines)


def write_german(folder: Path, t: Known | None = None) -> Path:
    """Semicolons, decimal commas, date and time apart, local time, Windows' encoding."""
    t = t or known()
    ahead = datetime.fromtimestamp(int(t.times_ns[0]) // 10**9, ZoneInfo("Europe/Berlin")).utcoffset()
    assert ahead is not None
    lines = ["Datum;Uhrzeit;Breite [°];Länge [°];Höhe [m];Roll;Pitch;Heading;sdE;sdN;sdU;sdRoll;sdPitch;sdHeading"]
    times = stamps("%d.%m.%Y;%H:%M:%S", t, ahead.total_seconds())
    for stamp, values in zip(times, np.column_stack([t.llh, t.rph, t.sigma]), strict=True):
        lines.append((stamp + ";" + ";".join(f"{v:.10f}" for v in values)).replace(".", ",").replace(",", ".", 2))
    path = folder / "fahrt.csv"
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    return path


def write_tsv(folder: Path, t: Known | None = None) -> Path:
    """Tabs, radians, GPS week and seconds, projected coordinates."""
    t = t or known()
    east, north = Transformer.from_crs(4326, 25832, always_xy=True).transform(t.llh[:, 1], t.llh[:, 0])
    lines = ["gps_week\ttow[s]\tEasting (m)\tNorthing (m)\tH_mm\troll_rad\tpitch_rad\theading_rad"]
    for i, (week, tow) in enumerate(zip(*gps_time(t), strict=True)):
        place = [f"{east[i]:.5f}", f"{north[i]:.5f}", f"{t.llh[i, 2] * 1000:.3f}"]
        lines.append("\t".join([str(week), tow, *place, *(f"{v:.12f}" for v in np.radians(t.rph[i]))]))
    return write(folder, "drive.tsv", lines)


def write_pospac(folder: Path, t: Known | None = None) -> Path:
    """Names with commas above values with blanks, two heights, the date in the heading."""
    t = t or known()
    lines = [
        "", "  POSPac export", f"  Date of Mission: {datetime.fromtimestamp(int(t.times_ns[0]) // 10**9, UTC):%Y-%m-%d}",
        " TIME, DISTANCE, ORTHOMETRIC HEIGHT, LATITUDE, LONGITUDE, ELLIPSOID HEIGHT, ROLL, PITCH, HEADING, EAST SD, NORTH SD, "
        "HEIGHT SD, ROLL SD, PITCH SD, HEADING SD", "", " (time in Sec, position in Meters, lat, long in Degrees)", "",
    ]  # fmt: skip
    for tow, (lat, lon, h), rph, sigma in zip(gps_time(t)[1], t.llh, t.rph, t.sigma, strict=True):
        numbers = " ".join(f"{v:.10f}" for v in (h - GEOID_M, lat, lon, h, *rph, *sigma))
        lines.append(f" {tow} 0.000 {numbers}")
    return write(folder, "export.txt", lines)


def write_logger(folder: Path, t: Known | None = None) -> Path:
    """Hemispheres in columns of their own, a column TAG, date and time without marks."""
    t = t or known()
    lines = ["INDEX,TAG,DATE,TIME,LATITUDE,N/S,LONGITUDE,E/W,HEIGHT,SPEED"]
    for i, (stamp, (lat, lon, h)) in enumerate(zip(stamps("%y%m%d,%H%M%S", t), t.llh, strict=True)):
        lines.append(
            f"{i},T,{stamp},{abs(lat):.10f},{'NS'[int(lat < 0)]},{abs(lon):.10f},{'EW'[int(lon < 0)]},{h:.4f},43"
        )
    return write(folder, "logger.csv", lines)


def write_parts(folder: Path, t: Known | None = None) -> Path:
    """Times in parts, comments with two strokes."""
    t = t or known()
    names = (
        "PacketCounter UTC_Nano UTC_Year UTC_Month UTC_Day UTC_Hour UTC_Minute UTC_Second Latitude Longitude Altitude"
    )
    lines = ["// Update Rate: 10.0Hz", names.replace(" ", "\t")]
    for i, (stamp, (lat, lon, h)) in enumerate(zip(stamps("%Y %m %d %H %M %S", t, digits=9), t.llh, strict=True)):
        whole, _, nano = stamp.partition(".")
        lines.append("\t".join([str(i), nano, *whole.split(), f"{lat:.10f}", f"{lon:.10f}", f"{h:.4f}"]))
    return write(folder, "mti.txt", lines)


def write_mixed_nmea(folder: Path, t: Known | None = None) -> Path:
    """GNS, headings first, without checksums, between messages of another protocol."""
    t = t or known()
    path = folder / "log.ubx"
    parts = []
    for day, clock, (lat, lon, h), rph in zip(stamps("%d%m%y", t), stamps("%H%M%S", t), t.llh, t.rph, strict=True):
        where = f"{minutes(lat, 2, 'NS')},{minutes(lon, 3, 'EW')}"
        texts = [
            f"$GPHDT,{rph[2]:.9f},T",
            f"$PASHR,{clock},{rph[2]:.9f},T,{rph[0]:.9f},{rph[1]:.9f},,,,,1,1",
            f"$GNRMC,{clock},A,{where},12.3,30.0,{day[:6]},,,R,V",
            f"$GNGNS,{clock},{where},RN,17,0.7,{h - GEOID_M:.4f},{GEOID_M},1.0,0123",
        ]
        parts += [b"\xb5\x62\x01\x07\x04\x00\x00\n$\x00\xb5", *map(str.encode, texts)]
    path.write_bytes(b"\r\n".join(parts) + b"\r\n")
    return path


class Sample(NamedTuple):
    """A format's file: how to write it, what its name is, and what the file does not say."""

    write: Callable[[Path], Path]
    format: str
    settings: TrajectoryFile = TrajectoryFile()
    has_sigma: bool = True
    has_attitude: bool = True
    is_local: bool = False


SAMPLES: dict[str, Sample] = {
    "rtklib": Sample(write_rtklib, "rtklib", has_attitude=False),
    "rtklib_dms_utc": Sample(lambda f: write_rtklib(f, form="dms", system="UTC"), "rtklib", has_attitude=False),
    "rtklib_week_comma": Sample(lambda f: write_rtklib(f, tow=True, sep=","), "rtklib", has_attitude=False),
    "rtklib_week": Sample(lambda f: write_rtklib(f, tow=True), "rtklib", has_attitude=False),
    "rtklib_dms_comma": Sample(lambda f: write_rtklib(f, form="dms", sep=","), "rtklib", has_attitude=False),
    "rtklib_ecef_jst": Sample(lambda f: write_rtklib(f, form="xyz", system="JST"), "rtklib", has_attitude=False),
    "sbet": Sample(write_sbet, "sbet", TrajectoryFile(week=WEEK)),
    "inertial_explorer": Sample(write_inertial_explorer, "inertial_explorer"),
    "inertial_explorer_dms": Sample(lambda f: write_inertial_explorer(f, angles="dms"), "inertial_explorer"),
    "nmea": Sample(write_nmea, "nmea"),
    "gpx": Sample(write_gpx, "gpx", has_sigma=False, has_attitude=False),
    "oxts": Sample(write_oxts, "oxts", has_sigma=False),
    "tum": Sample(write_tum, "tum", has_sigma=False, is_local=True),
    "euroc": Sample(write_euroc, "euroc", has_sigma=False, is_local=True),
    "csv": Sample(write_csv, "table"),
    "csv_german": Sample(write_german, "table", TrajectoryFile(time="Europe/Berlin")),
    "nmea_mixed": Sample(write_mixed_nmea, "nmea", has_sigma=False),
    "pospac": Sample(write_pospac, "table"),
    "logger": Sample(write_logger, "table", has_sigma=False, has_attitude=False),
    "parts": Sample(write_parts, "table", has_sigma=False, has_attitude=False),
    "tsv_projected": Sample(write_tsv, "table", TrajectoryFile(crs="EPSG:25832"), has_sigma=False),
}  # fmt: skip
