"""Logs of other programs as text with columns, and GPX: hemispheres, units, times and names as their makers write them."""

from __future__ import annotations

import random
from datetime import date
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from conetl.model.errors import InputError
from conetl.readers.trajectories import find_trajectories, read_trajectory, remarks_on, trajectory_format
from conetl.readers.trajectories.recorded import RecordedTrajectory
from conetl.readers.trajectories.settings import TrajectoryFile
from tests.unit.readers import trajectory_files as files
from tests.unit.readers.test_trajectories import angle_rad, apart_m, true_rotations

PER_EXAMPLE = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
RIO = np.array([-22.898, -43.2, 115.9])


def rio() -> files.Known:
    t = files.known()
    return t._replace(llh=t.llh - t.llh[0] + RIO)


def is_trajectory(path: Path, t: files.Known, **stated: Any) -> RecordedTrajectory:
    """The trajectory of a file, which is found by its content and is that one."""
    assert path in find_trajectories(path.parent)
    found = read_trajectory(path, TrajectoryFile(**stated))
    assert found.bad == {}
    np.testing.assert_array_equal(found.times_ns, t.times_ns)
    assert apart_m(found.positions, t.llh) < 2e-3
    return found


# --------------------------------------------------------------------------- hemispheres


@pytest.mark.parametrize(
    ("names", "lat", "lon"),
    [
        ("INDEX,DATE,TIME,LATITUDE,N/S,LONGITUDE,E/W,HEIGHT(m)", "{a:.9f},{s}", "{b:.9f},{w}"),
        ("no,date,time,lat,lat_dir,lon,lon_dir,alt", "{a:.9f},{s:.1}", "{b:.9f},{w:.1}"),
        ("no,date,time,NS,Latitude,EW,Longitude,alt", "{side},{a:.9f}", "{side},{b:.9f}"),
        ("no,date,time,hemisphere,lat,hemisphere2,lon,alt", "{south},{a:.9f}", "{west},{b:.9f}"),
        ("no,date,time,lat,a,lon,b,alt", "-{a:.9f},S", "-{b:.9f},W"),
        ("no,date,time,LATITUDE N/S,flag,LONGITUDE E/W,flag2,alt", "{a:.9f}S,x", "{b:.9f}W,x"),
        ("no,date,time,lat,flag,lon,flag2,alt", "S{a:.9f},x", "w {b:.9f},x"),
        ("no,date,time,lat,flag,lon,flag2,alt", "{dms_a}S,x", "{dms_b} w,x"),
    ],
)
def test_hemispheres_in_columns_signs_and_letters(names: str, lat: str, lon: str, tmp_path: Path) -> None:
    t = rio()
    rows = []
    for i, stamp in enumerate(files.stamps("%Y/%m/%d,%H:%M:%S", t)):
        a, b, h = np.abs(t.llh[i])
        dms = [f"{int(v)}°{int(v % 1 * 60):02d}'{v % 1 * 60 % 1 * 60:08.5f}\"" for v in (a, b)]
        words = {"a": a, "b": b, "s": "S", "w": "W", "south": "South", "west": "WEST", "dms_a": dms[0], "dms_b": dms[1]}
        place = f"{lat.format(**words, side='s')},{lon.format(**words, side='w')}"
        rows.append(f"{i},{stamp},{place},{h:.4f}")
    is_trajectory(files.write(tmp_path, "log.csv", [names, *rows]), t)


def test_a_hemisphere_that_contradicts_the_sign_is_bad(tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", ["time,lat,ns,lon,alt", "1707297300,-49,N,8,110", "1707297301,49,N,8,110"])
    found = read_trajectory(path)
    assert len(found.times_ns) == 1 and "latitude" in next(iter(found.bad.values()))


def test_a_letter_that_is_not_a_hemisphere_changes_nothing(tmp_path: Path) -> None:
    """A status S (single) before the latitude, and one far from it."""
    for names, row in (("time,mode,lat,lon,alt", "S,49,8,110"), ("time,lat,lon,alt,mode", "49,8,110,S")):
        path = files.write(tmp_path, "a.csv", [names, f"1707297300,{row}"])
        assert read_trajectory(path).positions[0, 0] == 49


# --------------------------------------------------------------------------- names, units and separators


def values_of(t: files.Known, i: int) -> dict[str, str]:
    weeks, tows = files.gps_time(t)
    numbers = [*t.llh[i], *t.rph[i], *t.sigma[i]]
    keys = ["lat", "lon", "h", "roll", "pitch", "heading", "se", "sn", "su", "sr", "sp", "sh"]
    return {"week": str(weeks[i]), "tow": tows[i]} | {key: f"{v:.10f}" for key, v in zip(keys, numbers, strict=True)}


@PER_EXAMPLE
@given(seed=st.integers(0, 2**32), mark=st.sampled_from([",", ";", "\t", "   "]), extra=st.integers(0, 3))
def test_any_order_of_columns_and_any_separator_gives_the_same_records(
    seed: int, mark: str, extra: int, tmp_path: Path
) -> None:
    rng, t = random.Random(seed), files.known(12)
    columns = {
        "week": ["Week", "GPS week"],
        "tow": ["ToW (s)", "GPS TOW [s]", "tow_s"],
        "lat": ["Lat (deg)", "GPS (Lat.) [deg]", "Latitude[deg]"],
        "lon": ["Lon (deg)", "LONGITUDE", "lon_deg"],
        "h": ["Height (m)", "h_ell", "ELLIPSOID HEIGHT"],
        "roll": ["Roll(d)", "ROLL"],
        "pitch": ["Pitch (d)", "Pitch"],
        "heading": ["Head(d)", "True Heading", "heading [deg]"],
        "sn": ["sN (m)"],
        "se": ["sE (m)"],
        "su": ["sH (m)"],
        "sr": ["sR (d)"],
        "sp": ["sP (d)"],
        "sh": ["sHd (d)"],
    }
    keys = rng.sample([*columns], len(columns)) + [f"#{k}" for k in range(extra)]
    names = [rng.choice(columns.get(key, [key])) for key in keys]
    lines = [mark.join(names)] + [mark.join(values_of(t, i).get(key, "7") for key in keys) for i in range(12)]
    found = is_trajectory(files.write(tmp_path, "a.txt", lines), t)
    assert found.rotations is not None and angle_rad(found.rotations, true_rotations(t.rph)) < 1e-6
    np.testing.assert_allclose(found.sigma[:, :3], t.sigma[:, :3], atol=1e-6)
    np.testing.assert_allclose(found.sigma[:, 3:], np.radians(t.sigma[:, 3:]), rtol=1e-6)


NAMES = ["GPSTime", "Week", "Latitude", "Longitude", "H-Ell", "Roll", "Pitch", "Heading"]
UNITS = ["(sec)", "(weeks)", "(deg)", "(deg)", "(m)", "(deg)", "(deg)", "(deg)"]


@PER_EXAMPLE
@given(data=st.data())
def test_columns_of_inertial_explorer_are_free(data: st.DataObject, tmp_path: Path) -> None:
    """Columns without a unit anywhere, in lines that are aligned or not."""
    t, names, units = files.known(12), [*NAMES], [*UNITS]
    keys = ["tow", "week", "lat", "lon", "h", "roll", "pitch", "heading"]
    for name, unit in data.draw(
        st.lists(st.sampled_from([("Q", ""), ("NS", ""), ("VEast", "(m/s)"), ("AmbStatus", "")]), unique=True)
    ):
        at = data.draw(st.integers(0, len(names)))
        for one, value in ((names, name), (units, unit), (keys, "")):
            one.insert(at, value)
    width = data.draw(st.sampled_from([0, 14]))
    lines = ["Project: van", "Program: Inertial Explorer Version 8.90", ""]
    lines += [" ".join(name.rjust(width) for name in names), " ".join(u.rjust(width) for u in units if u or width)]
    for i in range(12):
        lines.append("  " + " ".join(values_of(t, i).get(key, "1") for key in keys))
    found = is_trajectory(files.write(tmp_path, "van.txt", lines), t)
    assert found.rotations is not None and angle_rad(found.rotations, true_rotations(t.rph)) < 1e-6


@pytest.mark.parametrize(
    "units", [["s", "", "deg", "deg", "mm", "rad"], ["[s]", "[-]", "[°]", "[deg]", "[mm]", "[rad]"]]
)
def test_units_in_a_row_of_their_own(units: list[str], tmp_path: Path) -> None:
    t = files.known()
    lines = ["tow,week,lat,lon,height,heading", ",".join(units)]
    for i in range(files.COUNT):
        v = values_of(t, i)
        heading = np.radians(float(v["heading"]))
        lines.append(f"{v['tow']},{v['week']},{v['lat']},{v['lon']},{float(v['h']) * 1000:.1f},{heading:.9f}")
    found = is_trajectory(files.write(tmp_path, "a.csv", lines), t)
    assert found.rotations is not None
    assert angle_rad(found.rotations, true_rotations(t.rph * [0, 0, 1])) < 1e-6


def test_an_unknown_unit_in_a_row_is_refused(tmp_path: Path) -> None:
    lines = ["tow,week,lat,lon,height", "s,week,deg,deg,ft", "292518.0,2300,49,8,110"]
    with pytest.raises(InputError, match="unit 'ft' is not supported"):
        read_trajectory(files.write(tmp_path, "a.csv", lines))


POSPAC = (
    "TIME, DISTANCE, EASTING, NORTHING, {}, LATITUDE, LONGITUDE, {}, ROLL, PITCH, HEADING, EAST SD, NORTH SD, HEIGHT SD"
)


@pytest.mark.parametrize(
    ("heights", "rest", "stated"),
    [
        (("ELLIPSOID HEIGHT", "ELLIPSOID HEIGHT"), "   Date of Mission: 2024-02-07", {}),
        (("ORTHOMETRIC HEIGHT", "ELLIPSOID HEIGHT"), "Mission date 2024/2/7, office 3", {}),
        (("ELLIPSOID HEIGHT", "ELLIPSOID HEIGHT"), "Date of Mission: unknown", {"week": files.WEEK}),
    ],
)
def test_names_with_commas_above_values_with_blanks(
    heights: tuple[str, str], rest: str, stated: dict[str, Any], tmp_path: Path
) -> None:
    t = files.known()
    lines = [
        "",
        "  POSPac export",
        rest,
        POSPAC.format(*heights),
        "",
        " (time in Sec, position in Meters, lat, long in Degrees)",
        "",
    ]
    for i in range(files.COUNT):
        v = values_of(t, i)
        first = float(v["h"]) - (47.0 if heights[0].startswith("ORTHO") else 0.0)
        lines.append(
            f" {v['tow']} {1.2 * i:.3f} 458279.682 5427824.463 {first:.10f} {v['lat']} {v['lon']} {v['h']} "
            f"{v['roll']} {v['pitch']} {v['heading']} {v['se']} {v['sn']} {v['su']}"
        )
    found = is_trajectory(files.write(tmp_path, "export.txt", lines), t, **stated)
    assert found.rotations is not None and angle_rad(found.rotations, true_rotations(t.rph)) < 1e-6
    assert bool(found.notes) == (not stated)
    lines[2] = "Date of Mission: 2024-02-09"  # not the day of the week of the times
    with pytest.raises(InputError, match="does not state which"):
        read_trajectory(files.write(tmp_path, "export.txt", lines))


def test_units_in_words_that_are_not_metres_or_degrees_are_refused(tmp_path: Path) -> None:
    lines = [
        "Date of Mission: 2024-02-07",
        "TIME, LATITUDE, LONGITUDE, ELLIPSOID HEIGHT",
        "(time in Sec, position in Feet)",
    ]
    with pytest.raises(InputError, match="unit feet is not supported"):
        read_trajectory(files.write(tmp_path, "a.txt", [*lines, "292518.0 49 8 110"]), TrajectoryFile(format="table"))


@pytest.mark.parametrize("system", ["MSLV", "mean sea level"])
def test_gopro_telemetry(system: str, tmp_path: Path) -> None:
    t = files.known()
    names = '"cts","date","GPS (Lat.) [deg]","GPS (Long.) [deg]","GPS (Alt.) [m]","GPS (2D speed) [m/s]","fix","altitude system"'
    stamps = files.stamps("%Y-%m-%dT%H:%M:%S", t)
    rows = [
        f"{100 * i}.0,{stamps[i]}Z,{lat:.9f},{lon:.9f},{h:.3f},12.0,3,{system}" for i, (lat, lon, h) in enumerate(t.llh)
    ]
    path = files.write(tmp_path, "gopro.csv", [names, *rows])
    assert (is_trajectory(path, t).sigma[:, 2] == 100.0).all()
    assert np.isnan(is_trajectory(path, t, heights="ellipsoidal").sigma).all()


# --------------------------------------------------------------------------- sigmas


@pytest.mark.parametrize(
    ("name", "value", "columns", "sigma_m"),
    [
        ("hAcc", "14", {}, None),
        ("hAcc", "14.2", {}, None),
        ("h_acc", "1200.0", {}, None),
        ("pAcc", "3", {"sigma_horizontal": "pAcc"}, None),
        ("hAcc", "14", {"sigma_horizontal": "hAcc [mm]"}, 0.014),
        ("hAcc", "3", {"sigma_horizontal": "hAcc [m]"}, 3.0),
        ("hAcc_mm", "14", {}, 0.014),
        ("hAcc [m]", "14", {}, 14.0),
        ("hAcc", "4.7", {}, 4.7),
        ("horizontal_accuracy", "12", {}, 12.0),
    ],
)
def test_sigmas_in_mm_or_metres_are_asked_for(
    name: str, value: str, columns: dict[str, str | int], sigma_m: float | None, tmp_path: Path
) -> None:
    path = files.write(
        tmp_path, "a.csv", [f"time,lat,lon,height,{name}", *(f"{1707297300 + k},49,8,110,{value}" for k in range(3))]
    )
    if sigma_m is None:
        with pytest.raises(InputError, match=r"in mm, as receivers of u-blox give it, or in metres.* \[mm\]"):
            read_trajectory(path, TrajectoryFile(columns=columns))
    else:
        assert read_trajectory(path, TrajectoryFile(columns=columns)).sigma[0, 0] == pytest.approx(sigma_m)


def test_short_names_are_sigmas_only_beside_others(tmp_path: Path) -> None:
    path = files.write(
        tmp_path, "a.csv", ["time,lat,lon,height,roll,pitch,heading,sp,sr", "1707297300,49,8,110,0,0,30.5,12,100"]
    )
    assert np.isnan(read_trajectory(path).sigma).all()


# --------------------------------------------------------------------------- times


@pytest.mark.parametrize(
    ("names", "row", "stated"),
    [
        ("UTC_Nano,UTC_Year,UTC_Month,UTC_Day,UTC_Hour,UTC_Minute,UTC_Second", "250000000,2024,2,7,9,15,0", {}),
        ("year,month,day,hour,min,sec,valid,nano", "2024,2,7,9,15,1,55,-750000000", {}),
        ("year,month,day,hour,minute,second", "2024,02,07,09,15,0.25", {}),
        ("TAG,DATE,TIME", "T,240207,091500.25", {}),
        ("DATE,TIME", "07022024,091500.25", {"date": date(2024, 2, 7)}),
        ("DATE,TIME", "20240207,09:15:00.25", {}),
        ("date,time", "070224,091500.25", {"date": date(2024, 2, 7)}),
        ("date,time", "07/02/2024,09:15:00.25", {"date": date(2024, 2, 7)}),
        ("date,time", "02/07/2024,09:15:00.25", {"date": date(2024, 2, 7)}),
        ("time", "02/07/2024 09:15:00.25", {"date": date(2024, 2, 7)}),
        ("cts,date", "0.0,2024-02-07T09:15:00.250Z", {}),
    ],
)
def test_dates_and_times_in_parts(names: str, row: str, stated: dict[str, Any], tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", [f"{names},lat,lon,alt", *[f"{row},49,8.4,110"] * 3])
    assert trajectory_format(path) == "table"
    assert read_trajectory(path, TrajectoryFile(**stated)).times_ns[0] == 1707297300_250_000_000


def test_a_day_above_12_shows_the_order_of_a_date(tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", ["date,time,lat,lon,alt", "02/25/2024,09:15:00,49,8.4,110"])
    assert read_trajectory(path).times_ns[0] == 1708852500 * 10**9
    for text, says in (
        ("070224", "two ways"),
        ("310224", "is not one since 2008"),
        ("01/01/1999", "is not one since 2008"),
    ):
        with pytest.raises(InputError, match=f"{says}.*date: 2024-02-07"):
            read_trajectory(files.write(tmp_path, "a.csv", ["date,time,lat,lon,alt", f"{text},09:15:00,49,8.4,110"]))


@PER_EXAMPLE
@given(cuts=st.lists(st.integers(1, 39), min_size=1, max_size=3, unique=True), seed=st.integers(0, 2**32))
def test_parts_of_a_solution_have_their_own_time_system_and_columns(cuts: list[int], seed: int, tmp_path: Path) -> None:
    rng, t = random.Random(seed), files.known()
    lines: list[str] = []
    ends = [0, *sorted(cuts), files.COUNT]
    for a, b in pairwise(ends):
        part = files.Known(*(values[a:b] for values in t))
        lines += (
            files.write_rtklib(
                tmp_path,
                part,
                system=rng.choice(["GPST", "UTC", "JST"]),
                tow=rng.random() < 0.2,
                form=rng.choice(["llh", "dms"]),
            )
            .read_text()
            .splitlines()
        )
    path = files.write(tmp_path, "rover.pos", lines)
    if any("UTC" in line or "JST" in line for line in lines) and " 2300 " in " ".join(line[:8] for line in lines):
        return  # RTKLIB writes weeks in GPS time only
    found = is_trajectory(path, t)
    np.testing.assert_allclose(found.sigma[:, :3], t.sigma[:, :3], atol=1e-4)


@pytest.mark.parametrize("second", ["time,lat,lon,alt", "alt,lon,lat,time", "# gps_week,tow,lat,lon,alt"])
def test_tables_that_were_joined(second: str, tmp_path: Path) -> None:
    t = files.known()
    lines = []
    for names, part in (("time,lat,lon,alt", range(25)), (second, range(25, 40))):
        lines.append(names)
        for i in part:
            v = values_of(t, i) | {"time": f"{t.times_ns[i] // 10**9}.{t.times_ns[i] % 10**9:09d}"}
            v |= {"alt": v["h"], "gps_week": v["week"]}
            lines.append(",".join(v[name] for name in names.lstrip("# ").split(",")))
    is_trajectory(files.write(tmp_path, "a.csv", lines), t)


def test_joined_tables_of_different_coordinates_are_refused(tmp_path: Path) -> None:
    lines = ["time,lat,lon,alt", "1707297300,49,8,110", "time,easting,northing,alt", "1707297301,458000,5427000,110"]
    with pytest.raises(InputError, match="line 3 names other coordinates"):
        read_trajectory(files.write(tmp_path, "a.csv", lines))


def test_a_course_in_whole_degrees_is_no_attitude(tmp_path: Path) -> None:
    rows = [f"{1707297300 + k},49,8,110,{57 + k}" for k in range(3)]
    found = read_trajectory(files.write(tmp_path, "a.csv", ["time,lat,lon,height,HEADING", *rows]))
    assert found.rotations is None and "whole degrees" in found.notes[0]
    found = read_trajectory(tmp_path / "a.csv", TrajectoryFile(columns={"heading": "HEADING"}))
    assert found.rotations is not None


def test_columns_of_the_same_values_are_one_and_others_are_asked_for(tmp_path: Path) -> None:
    for second, expected in (("49.5", 49.5), ("49.6", None)):
        path = files.write(
            tmp_path, "a.csv", ["time,latitude,gps_lat,ins_lat,lon,alt", f"1707297300,x,49.5,{second},8,110"][:2]
        )
        path.write_text(path.read_text().replace("latitude,", "note,"))
        if expected is None:
            with pytest.raises(InputError, match="'gps_lat' and 'ins_lat' may both be the lat"):
                read_trajectory(path)
        else:
            assert read_trajectory(path).positions[0, 0] == expected


# --------------------------------------------------------------------------- GPX


def nested(inner: str) -> str:
    return f"<extensions><x:a xmlns:x='u'>{inner}</x:a></extensions>"


@pytest.mark.parametrize(
    "extra",
    [
        nested("<x:ele>3</x:ele>"),
        nested("<x:time>2024-02-07T09:15:00Z</x:time>"),
        nested("<geoidheight>50</geoidheight>"),
        "<extensions><ele>1</ele><time>x</time></extensions>",
        "<link href='u'><text>a</text><time>1</time></link>",
        nested("<trkpt lat='1' lon='1'><ele>5</ele></trkpt>"),
    ],
)
@pytest.mark.parametrize("first", [True, False])
def test_values_of_extensions_are_not_those_of_the_point(extra: str, first: bool, tmp_path: Path) -> None:
    t = files.known()
    path = files.write_gpx(tmp_path, geoid=False)
    mark = "<ele>" if first else "</trkpt>"
    path.write_text(path.read_text().replace(mark, extra + mark))
    assert (is_trajectory(path, t).sigma[:, 2] == 100.0).all()


@PER_EXAMPLE
@given(share=st.floats(0.1, 0.999), tail=st.sampled_from([b"", b"\0" * 5000, b"\xff\xfe\0"]))
def test_a_gpx_file_that_was_cut_gives_its_whole_points(share: float, tail: bytes, tmp_path: Path) -> None:
    t, path = files.known(), files.write_gpx(tmp_path)
    data = path.read_bytes()
    kept = data[: int(share * len(data))]
    path.write_bytes(kept + tail)
    found = read_trajectory(path)
    count = kept.count(b"</trkpt>")
    np.testing.assert_array_equal(found.times_ns, t.times_ns[:count])
    assert apart_m(found.positions, t.llh[:count]) < 1e-3
    assert "whole points" in found.notes[0]
    assert any("end is missing" in remark for remark in remarks_on(path, TrajectoryFile()))


# --------------------------------------------------------------------------- hostile files


@pytest.mark.parametrize("name", [name for name in files.SAMPLES if name not in {"oxts", "sbet"}])
def test_reserved_space_behind_a_log_costs_nothing(name: str, tmp_path: Path) -> None:
    sample = files.SAMPLES[name]
    path = sample.write(tmp_path)
    with path.open("ab") as file:
        file.truncate(1 << 30)
    found = read_trajectory(path, sample.settings.model_copy(update={"format": sample.format}))
    np.testing.assert_array_equal(found.times_ns, files.known().times_ns)
    with path.open("ab") as file:
        file.truncate(3 << 30)
    with pytest.raises(InputError, match="at most"):
        read_trajectory(path, sample.settings)


def test_control_characters_of_a_file_do_not_reach_a_message(tmp_path: Path) -> None:
    evil = "\x1b]0;x\x07\x1b[31mlat\u202e"
    for lines in (
        [f"a,{evil},c", "1,2,3"],
        [f"time,lat{evil},lon,alt,{evil}", "1,2,3,4,5"],
        [f"time,lat,lon,alt {evil}", f"{evil},1,2,3"],
        [f"time,lat,lon,alt,gps_lat,{evil}", f"1707297300,{evil},2,3,4,5"],
        [f"date {evil},time,lat,lon,alt", "1,2,3,4,5"],
        ["time,lat,lon,alt,hAcc", f"170729730{evil},{evil},2,3,4"],
    ):
        path = files.write(tmp_path, "a.csv", lines)
        for stated in ({}, {"columns": {"lat": "lat2"}}, {"columns": {"lat": evil}}):
            try:
                found = read_trajectory(path, TrajectoryFile.model_validate(stated))
                texts = [*found.notes, *found.bad.values()]
            except InputError as error:
                texts = [str(error)]
            assert all(map(str.isprintable, texts)), texts


# --------------------------------------------------------------------------- units and heights that nothing states


def turning(count: int = 60) -> files.Known:
    """A drive whose heading is that of its course, about 60 degrees."""
    heading = 60 + 40 * np.sin(np.arange(count) / 10)
    steps = 1.5 * np.column_stack([np.cos(np.radians(heading)), np.sin(np.radians(heading))]) / [111_195.0, 73_000.0]
    t = files.known(count)
    llh, rph = t.llh.copy(), t.rph.copy()
    llh[1:, :2] = llh[0, :2] + np.cumsum(steps, axis=0)[:-1]
    rph[:, 2] = heading
    return t._replace(llh=llh, rph=rph)


def angle_rows(t: files.Known, factor: float, turned: bool) -> list[str]:
    roll, pitch, heading = t.rph.T * factor
    last = np.radians(90) / np.radians(1) * factor - heading if turned else heading
    stamps = files.stamps("%Y-%m-%dT%H:%M:%S", t)
    return [
        f"{stamps[i]}Z,{a:.9f},{b:.9f},{h:.4f},{roll[i]:.6f},{pitch[i]:.6f},{last[i]:.6f}"
        for i, (a, b, h) in enumerate(t.llh)
    ]


@pytest.mark.parametrize("name", ["heading", "yaw"])
def test_angles_in_radians_without_a_unit_are_not_taken_for_degrees(name: str, tmp_path: Path) -> None:
    t = turning()
    rows = angle_rows(t, np.pi / 180, turned=name == "yaw")
    path = files.write(tmp_path, "log.csv", [f"time,lat,lon,height,roll,pitch,{name}", *rows])
    with pytest.raises(InputError, match=rf"column '{name}' is in radians.*trajectory: {{angles: radians}}"):
        read_trajectory(path)
    path = files.write(tmp_path, "log.csv", [f"time,lat [deg],lon [deg],height,roll,pitch,{name}", *rows])
    found = read_trajectory(path, TrajectoryFile(angles="radians"))
    assert apart_m(found.positions, t.llh) < 2e-3 and found.rotations is not None
    np.testing.assert_allclose(
        np.degrees(np.arctan2(found.rotations[:, 0, 0], found.rotations[:, 1, 0])), t.rph[:, 2], atol=0.01
    )


@pytest.mark.parametrize("course", [0.0, 90.0, 180.0, 270.0])
def test_small_headings_in_degrees_are_degrees(course: float, tmp_path: Path) -> None:
    """Straight to the north, and a camera that looks aside or back."""
    t = turning()
    llh, rph = t.llh.copy(), t.rph.copy()
    llh[:, :2] = llh[0, :2] + np.arange(60)[:, None] * 1.5 * np.array(
        [np.cos(np.radians(course)) / 111_195, np.sin(np.radians(course)) / 73_000]
    )
    rph[:, 2] = np.sin(np.arange(60) / 5)
    rows = angle_rows(t._replace(llh=llh, rph=rph), 1.0, turned=False)
    found = read_trajectory(files.write(tmp_path, "log.csv", ["time,lat,lon,height,roll,pitch,heading", *rows]))
    assert found.rotations is not None and len(found.times_ns) == 60


def test_positions_in_radians_without_a_unit_are_refused(tmp_path: Path) -> None:
    t = files.known()
    rows = [f"{s}Z,{a:.11f},{b:.11f},{h:.3f}" for s, (a, b, h) in zip(
        files.stamps("%Y-%m-%dT%H:%M:%S", t), t.llh * [np.pi / 180, np.pi / 180, 1.0], strict=True)]  # fmt: skip
    path = files.write(tmp_path, "log.csv", ["time,lat,lon,height", *rows])
    with pytest.raises(InputError, match="in the Atlantic: are latitude and longitude in radians"):
        read_trajectory(path)
    is_trajectory(path, t, angles="radians")


@pytest.mark.parametrize(
    ("names", "ellipsoidal"),
    [
        ("height_msl,undulation", False), ("H-MSL,Undulation", False), ("orthometric_height,geoid_separation [m]", False),
        ("elevation,geoid height", False), ("H-Ell,Undulation", True), ("Alt (HAE),Geoid Separation", True),
        ("Alt (HAE),Alt (MSL)", True),
    ],
)  # fmt: skip
def test_heights_with_the_separation_of_the_geoid(names: str, ellipsoidal: bool, tmp_path: Path) -> None:
    t = files.known()
    rows = [
        f"{s}Z,{a:.9f},{b:.9f},{h if ellipsoidal else h - 48:.3f},{h - 48 if 'Alt (MSL)' in names else 48.0:.3f}"
        for s, (a, b, h) in zip(files.stamps("%Y-%m-%dT%H:%M:%S", t), t.llh, strict=True)
    ]
    is_trajectory(files.write(tmp_path, "log.csv", [f"time,lat,lon,{names}", *rows]), t)


def test_a_height_beside_a_separation_that_states_nothing_may_be_of_either(tmp_path: Path) -> None:
    rows = [f"2024-02-07T09:15:0{k}Z,49.00{k},8.4,68.0,48.0" for k in range(5)]
    path = files.write(tmp_path, "log.csv", ["time,lat,lon,altitude,undulation", *rows])
    found = read_trajectory(path)
    assert found.sigma[0, 2] == 100.0 and "does not state whether its heights are above sea level" in found.notes[0]
    found = read_trajectory(path, TrajectoryFile(heights="ellipsoidal"))
    assert found.positions[0, 2] == 68.0 and not found.sigma[0, 2] >= 100.0


# --------------------------------------------------------------------------- what names and columns beside a value say of it

STAMPED = "2024-02-07 10:15:0{k}.250"
PLACE = "49.00000{k},8.43,116.1"


@pytest.mark.parametrize(
    ("names", "row", "stated", "says"),
    [
        ("time (CET)", STAMPED, {}, "time zone"),
        ("time (CET)", STAMPED, {"columns": {"time": "time (CET)"}}, "time zone"),
        ("time (UTC+1)", STAMPED, {"columns": {"time": "time (UTC+1)"}}, "time zone"),
        ("Zeit [Europe/Berlin]", STAMPED, {}, "time zone"),
        ("time,timezone", f"{STAMPED},+01:00", {}, "time zone"),
        ("datetime,utc_offset", f"{STAMPED},3600", {}, "time zone"),
        ("year,month,day,hour,minute,second,tz", "2024,2,7,10,15,{k}.25,+1", {}, "time zone"),
        ("GNSS time", STAMPED, {}, "is this GPS time"),
        ("gps_date,time", "2024-02-07,09:15:0{k}.250", {}, "is this GPS time"),
        ("date,time,am_pm", "2024-02-07,02:15:0{k}.250,PM", {}, "AM and PM"),
        ("time", "09:15:0{k}.250", {}, "name the column of the dates, or state the first one"),
        ("time", "09150{k}.25", {"date": date(2024, 2, 7)}, "may be hhmmss or seconds"),
        ("time", "09150{k}.25", {}, "may be hhmmss or seconds"),
        ("Time (s)", "0.{k}50000000E0", {}, "from the start of the recording"),
    ],
)
def test_times_of_another_clock_are_asked_for(
    names: str, row: str, stated: dict[str, Any], says: str, tmp_path: Path
) -> None:
    rows = [f"{row.format(k=k)},{PLACE.format(k=k)}" for k in range(5)]
    path = files.write(tmp_path, "a.csv", [f"{names},lat,lon,h_ell", *rows])
    with pytest.raises(InputError, match=says):
        read_trajectory(path, TrajectoryFile.model_validate(stated))


@pytest.mark.parametrize(
    ("names", "row", "stated"),
    [
        ("time_utc,time_local", f"2024-02-07 09:15:00.250,{STAMPED}", {}),
        ("Local Time,UTC Time", f"{STAMPED},2024-02-07T09:15:00.250", {}),
        ("time (UTC+1)", STAMPED, {"time": "Etc/GMT-1"}),
        ("time", "09:15:00.250", {"date": date(2024, 2, 7)}),
        ("Uhrzeit", "10:15:00.250", {"date": date(2024, 2, 7), "time": "Europe/Berlin"}),
        ("gps_time", "09:15:18.250", {"date": date(2024, 2, 7), "time": "gps"}),
        ("time,time_offset,timezone", f"2024-02-07T09:15:00.250Z,{STAMPED}+01:00,CET", {}),
    ],
)
def test_a_time_that_is_stated_is_read(names: str, row: str, stated: dict[str, Any], tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", [f"{names},lat,lon,h_ell", f"{row.format(k=0)},{PLACE.format(k=0)}"])
    assert read_trajectory(path, TrajectoryFile.model_validate(stated)).times_ns[0] == 1707297300_250_000_000


@pytest.mark.parametrize(
    ("names", "received"),
    [
        ("%time,field.header.seq,field.header.stamp,field.latitude,field.longitude,field.altitude", True),
        ("__time,/fix/latitude,/fix/longitude,/fix/altitude", False),
    ],
)
def test_messages_of_ros_as_tables_have_the_times_of_their_headers(names: str, received: bool, tmp_path: Path) -> None:
    t = files.known()
    rows = []
    for time_ns, (lat, lon, h) in zip(t.times_ns.tolist(), t.llh, strict=True):
        times = f"{time_ns + 80_000_000},7,{time_ns}" if received else f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        rows.append(f"{times},{lat:.9f},{lon:.9f},{h:.4f}")
    is_trajectory(files.write(tmp_path, "fix.csv", [names, *rows]), t)


def test_times_of_day_go_over_midnight(tmp_path: Path) -> None:
    rows = [f"{text},49,8.43,116.1" for text in ("23:59:58.5", "23:59:59.5", "00:00:00.5", "00:00:01.5")]
    path = files.write(tmp_path, "a.csv", ["time,lat,lon,h_ell", *rows])
    found = read_trajectory(path, TrajectoryFile(date=date(2024, 2, 7)))
    np.testing.assert_array_equal(np.diff(found.times_ns), [10**9] * 3)


def test_seconds_of_six_digits_with_their_unit_are_seconds(tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", ["time,lat,lon,h_ell", "091500.25,49.0,8.43,116.1"])
    found = read_trajectory(path, TrajectoryFile(columns={"time": "time [s]"}, date=date(2024, 2, 5)))
    assert found.times_ns[0] == 1707096282_250_000_000  # of the GPS week of that day


@pytest.mark.parametrize(
    "name",
    [
        "height (EGM96)",
        "height_egm2008",
        "Height (NAVD88)",
        "Alt_AMSL",
        "Altitude above mean sea level",
        "Höhe über NHN",
    ],
)
def test_names_that_say_sea_level_are_believed(name: str, tmp_path: Path) -> None:
    lines = [f"time,lat,lon,{name}", "1707297300,49,8.43,68.1"]
    path = files.write(tmp_path, "a.csv", lines)
    for columns in ({}, {"height": name}):
        with pytest.raises(InputError, match="heights are above sea level"):
            read_trajectory(path, TrajectoryFile.model_validate({"columns": columns}))
    assert read_trajectory(path, TrajectoryFile(heights="ellipsoidal")).positions[0, 2] == 68.1


@pytest.mark.parametrize("name", ["height (WGS84 ellipsoid)", "Altitude ellipsoidal", "Height over ellipsoid [m]"])
def test_names_that_say_ellipsoid_are_believed(name: str, tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", [f"time,lat,lon,{name}", "1707297300,49,8.43,116.1"])
    assert read_trajectory(path).positions[0, 2] == 116.1


def test_a_separation_without_values_is_none(tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", ["time,lat,lon,elevation,geoidheight", "1707297300,49,8.43,68.1,"])
    with pytest.raises(InputError, match="heights are above sea level"):
        read_trajectory(path)


@pytest.mark.parametrize("names", ["X,Y,Z", "X-ECEF (m),Y-ECEF (m),Z-ECEF (m)", "ecef_x,ecef_y,ecef_z"])
def test_geocentric_coordinates_show_in_their_values(names: str, tmp_path: Path) -> None:
    t = files.known()
    xyz = np.column_stack(Transformer.from_crs(4979, 4978).transform(*t.llh.T))
    rows = [f"{s}Z,{x:.4f},{y:.4f},{z:.4f}" for s, (x, y, z) in zip(
        files.stamps("%Y-%m-%dT%H:%M:%S", t), xyz, strict=True)]  # fmt: skip
    is_trajectory(files.write(tmp_path, "a.csv", [f"time,{names}", *rows]), t)


@pytest.mark.parametrize(
    ("name", "refused"),
    [
        ("Heading [M]", None), ("heading (m)", None), ("heading (mrad)", "mrad"), ("heading_mrad", "mrad"),
        ("heading [mdeg]", "mdeg"),
    ],
)  # fmt: skip
def test_a_heading_in_a_unit_of_something_else_is_not_one_in_degrees(
    name: str, refused: str | None, tmp_path: Path
) -> None:
    rows = [f"{1707297300 + k},49,8,110,57.25" for k in range(3)]
    path = files.write(tmp_path, "a.csv", [f"time,lat,lon,height,{name}", *rows])
    if refused is None:
        assert read_trajectory(path).rotations is None
        return
    with pytest.raises(InputError, match=f"unit '{refused}' is not supported"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("names", "row", "stated", "found"),
    [
        ("UTCDate UTCTime", "3/02/2026 09:41:07.250", {"units": "(MDY) (HMS)"}, 1772444467_250_000_000),
        ("LocalDate LocalTime", "2026/03/02 10:41:07.250", {"units": "(YMD) (HMS)"}, None),
        ("LocalDate LocalTime", "2026/03/02 10:41:07.250", {"units": "(YMD) (HMS)", "time": "Europe/Berlin"},
         1772444467_250_000_000),
    ],
)  # fmt: skip
def test_dates_and_times_of_inertial_explorer(
    names: str, row: str, stated: dict[str, str], found: int | None, tmp_path: Path
) -> None:
    lines = ["Project: van", "Program: Inertial Explorer Version 8.90", "", f" {names} Latitude Longitude H-Ell"]
    lines += [f" {stated['units']} (deg) (deg) (m)", f" {row} 49.0 8.43 116.1"]
    path, settings = files.write(tmp_path, "a.txt", lines), TrajectoryFile(time=stated.get("time"))
    if found is None:
        with pytest.raises(InputError, match="time zone"):
            read_trajectory(path, settings)
    else:
        assert read_trajectory(path, settings).times_ns[0] == found
