"""Trajectory files: one known trajectory in every format, times, coordinates, and damage that must cost one record only."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from conetl.geometry.geodesy import grid_convergence_rad
from conetl.model.errors import InputError
from conetl.readers.drives.drive_yaml import DriveYaml, Sigmas
from conetl.readers.drives.pairs import ContentHash, Source
from conetl.readers.drives.poses import placed, stated_sigmas
from conetl.readers.trajectories import READERS, find_trajectories, read_trajectory, trajectory_format
from conetl.readers.trajectories.clocks import TimeFormat, time_reader
from conetl.readers.trajectories.settings import FormatName, TrajectoryFile
from conetl.readers.trajectories.times import SECOND_NS, decimal_ns, gps_to_utc, parse_timestamp
from tests.unit.readers import trajectory_files as files

TO_ECEF = Transformer.from_crs(4979, 4978)


def apart_m(a: Any, b: Any) -> float:
    """Largest distance of positions (N, 3) in latitude, longitude, height."""
    x, y = (np.column_stack(TO_ECEF.transform(*np.asarray(p).T)) for p in (a, b))
    return float(np.linalg.norm(x - y, axis=1).max())


def angle_rad(a: Any, b: Any) -> float:
    """Largest angle between rotations (N, 3, 3)."""
    return float((Rotation.from_matrix(a).inv() * Rotation.from_matrix(b)).magnitude().max())


def true_rotations(rph: Any) -> Any:
    """Body (forward, left, up) to east, north, up, from its axes: independent of the reader's formula."""
    r, p, h = np.radians(rph).T
    forward = np.column_stack([np.sin(h) * np.cos(p), np.cos(h) * np.cos(p), np.sin(p)])
    level_right = np.column_stack([np.cos(h), -np.sin(h), np.zeros_like(h)])
    right_up = np.cross(level_right, forward)
    # The right side goes down.
    right = level_right * np.cos(r)[:, None] - right_up * np.sin(r)[:, None]
    return np.stack([forward, -right, np.cross(forward, -right)], axis=-1)


def test_every_format_has_a_sample() -> None:
    assert {sample.format for sample in files.SAMPLES.values()} == READERS.keys() == {*get_args(FormatName)}


@pytest.mark.parametrize("name", files.SAMPLES)
def test_every_format_gives_the_trajectory_that_was_written(name: str, tmp_path: Path) -> None:
    sample, t = files.SAMPLES[name], files.known()
    path = sample.write(tmp_path)
    assert trajectory_format(path) == sample.format
    assert path in find_trajectories(tmp_path)
    found = read_trajectory(path, sample.settings)
    assert found.bad == {}
    np.testing.assert_array_equal(found.times_ns, t.times_ns)
    assert found.is_local == sample.is_local
    if sample.is_local:
        np.testing.assert_allclose(found.positions, files.local_poses(t)[0], atol=1e-8)
    else:
        assert apart_m(found.positions, t.llh) < 1e-3
    if sample.has_attitude:
        assert found.rotations is not None
        assert angle_rad(found.rotations, true_rotations(t.rph)) < 1e-6
    else:
        assert found.rotations is None
    if sample.has_sigma:
        np.testing.assert_allclose(found.sigma[:, :3], t.sigma[:, :3], atol=1e-4)
        if sample.has_attitude:
            np.testing.assert_allclose(found.sigma[:, 3:], np.radians(t.sigma[:, 3:]), rtol=1e-6)


def test_only_the_time_of_the_drive_is_kept(tmp_path: Path) -> None:
    t = files.known()
    found = read_trajectory(files.write_csv(tmp_path), between_ns=(int(t.times_ns[10]), int(t.times_ns[19])))
    np.testing.assert_array_equal(found.times_ns, t.times_ns[10:20])
    with pytest.raises(InputError, match="time of the images; its own are from 2024-02-07T09:15:00"):
        read_trajectory(tmp_path / "drive.csv", between_ns=(0, 1))


# --------------------------------------------------------------------------- times


@pytest.mark.parametrize(
    ("gps", "utc"),
    [
        ("1980-01-06 00:00:00", "1980-01-06 00:00:00"),
        ("2006-01-01 00:00:12.999", "2005-12-31 23:59:59.999"),  # 13 s ahead until then
        ("2006-01-01 00:00:14", "2006-01-01 00:00:00"),
        ("2016-12-31 23:59:59", "2016-12-31 23:59:42"),
        ("2017-01-01 00:00:16.999", "2016-12-31 23:59:59.999"),
        ("2017-01-01 00:00:18", "2017-01-01 00:00:00"),
        ("2026-11-23 00:00:18", "2026-11-23 00:00:00"),
    ],
)  # fmt: skip
def test_gps_time_is_ahead_of_utc_by_the_leap_seconds_of_its_date(gps: str, utc: str) -> None:
    assert gps_to_utc(np.array([parse_timestamp(gps)]))[0] == parse_timestamp(utc)


@given(st.integers(946_684_800, 1_900_000_000).map(lambda s: s * SECOND_NS))
def test_gps_time_never_runs_backwards_by_more_than_its_leap_second(start_ns: int) -> None:
    steps = np.diff(gps_to_utc(start_ns + np.arange(0, 4 * 10**9, 10**8)))
    assert ((steps == 10**8) | (steps == 10**8 - SECOND_NS)).all()
    assert (steps < 0).sum() <= 1


@given(st.integers(0, 2**62))
def test_decimal_times_are_exact(ns: int) -> None:
    for digits in (9, 6, 3, 0):
        whole, rest = divmod(ns, 10**digits)
        assert decimal_ns(f"{whole}.{rest:0{digits}d}" if digits else str(ns), digits) == ns


@given(st.datetimes(datetime(2000, 1, 1), datetime(2060, 1, 1)), st.integers(0, 999_999_999))
def test_texts_of_times_are_exact(moment: datetime, ns: int) -> None:
    whole = moment.replace(microsecond=0, tzinfo=UTC)
    expected = int(whole.timestamp()) * SECOND_NS + ns
    for form in ("%Y-%m-%d %H:%M:%S", "%Y/%m/%dT%H:%M:%S", "%d.%m.%Y %H:%M:%S"):
        assert parse_timestamp(f"{whole:{form}}.{ns:09d}") == expected


def test_a_week_ends_and_one_wild_time_does_not_end_it() -> None:
    read = time_reader(TimeFormat("UTC", "week", week=2300))
    times, wrong = read(["604799.5", "604799.9", "0.3", "0.7"], None)
    assert wrong == {} and np.diff(times).tolist() == [4 * 10**8] * 3
    times, _ = time_reader(TimeFormat("UTC", "week", week=2300))(["100.0", "603000", "100.2"], None)
    assert times[2] - times[0] == 2 * 10**8


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"week": files.WEEK}, None),
        ({"date": date(2024, 2, 7)}, None),
        ({}, "which"),
        ({"date": date(2024, 2, 9)}, "Wednesday"),
    ],
)  # fmt: skip
def test_an_sbet_file_needs_its_week(settings: dict[str, Any], expected: str | None, tmp_path: Path) -> None:
    path = files.write_sbet(tmp_path)
    if expected is None:
        np.testing.assert_array_equal(
            read_trajectory(path, TrajectoryFile(**settings)).times_ns, files.known().times_ns
        )
    else:
        with pytest.raises(InputError, match=expected):
            read_trajectory(path, TrajectoryFile(**settings))


def test_an_sbet_file_of_seconds_of_the_day_in_utc(tmp_path: Path) -> None:
    rows = files.sbet_rows(files.known())
    rows[:, 0] -= 3 * 86_400 + 18
    rows.astype("<f8").tofile(tmp_path / "sbet.out")
    found = read_trajectory(tmp_path / "sbet.out", TrajectoryFile(date=date(2024, 2, 7), time="utc"))
    np.testing.assert_array_equal(found.times_ns, files.known().times_ns)
    assert np.isnan(found.sigma).all()


def test_nmea_over_midnight_and_with_its_date_later(tmp_path: Path) -> None:
    start = datetime(2024, 2, 28, 23, 59, 58, tzinfo=UTC)
    for first in (0, 3, 25):
        found = read_trajectory(files.write_nmea(tmp_path, files.known(start=start), rmc_first=first))
        expected = int(start.timestamp()) * SECOND_NS + np.arange(files.COUNT) * 10**8
        np.testing.assert_array_equal(found.times_ns, expected)
    path = files.write_nmea(tmp_path, files.known(start=start), rmc_first=1000)
    with pytest.raises(InputError, match="date"):
        read_trajectory(path)
    assert (
        read_trajectory(path, TrajectoryFile(date=date(2024, 2, 28))).times_ns[0] == int(start.timestamp()) * SECOND_NS
    )


def test_nmea_after_a_gap_of_half_a_day_is_of_the_same_day(tmp_path: Path) -> None:
    text = "".join(
        files.write_nmea(tmp_path, files.known(start=start), rmc_first=1000).read_text()
        for start in (datetime(2024, 2, 7, 0, 30, tzinfo=UTC), datetime(2024, 2, 7, 14, 30, tzinfo=UTC))
    )
    (tmp_path / "log.nmea").write_text(text)
    found = read_trajectory(tmp_path / "log.nmea", TrajectoryFile(date=date(2024, 2, 7)))
    assert found.times_ns[-1] - found.times_ns[0] == (14 * 3600 + 39 * 100 // 1000) * SECOND_NS + 9 * 10**8


@pytest.mark.parametrize(
    ("write", "settings"),
    [
        (files.write_nmea, {}),
        (files.write_rtklib, {}),
        (files.write_inertial_explorer, {}),
        (files.write_sbet, {"week": files.WEEK - 1024}),
    ],
)
def test_weeks_that_rolled_over_are_refused(write: Any, settings: dict[str, Any], tmp_path: Path) -> None:
    path = write(tmp_path, files.known(start=files.START - timedelta(weeks=1024)))
    with pytest.raises(InputError, match=r"before 2008: .* GPS week rolled over"):
        read_trajectory(path, TrajectoryFile(**settings))


@pytest.mark.parametrize(
    ("column", "first", "settings"),
    [
        ("time", "1707297300.0", {}),
        ("timestamp_ms", "1707297300000", {}),
        ("t", "1707297300000000", {}),
        ("stamp", "1707297300000000000", {}),
        ("gps_time", "1391332518", {"time": "gps"}),
        ("utc", "2024-02-07 10:15:00+01:00", {}),
        ("time", "2024-02-07T09:15:18", {"time": "gps"}),
        ("time", "2024-02-07T04:15:00", {"time": "America/New_York"}),
        ("time", "33300.0", {"time": "utc", "date": date(2024, 2, 7)}),
        ("local_time", "2024-02-07 10:15:00+01:00", {}),
        ("Ortszeit", "07.02.2024 10:15:00", {"time": "Europe/Berlin"}),
        ("local_timestamp", "1707297300", {}),
        ("Datum/Zeit", "07.02.2024 09:15:00", {}),
        ("tow", f"{files.TOW}", {"week": files.WEEK}),
    ],
)  # fmt: skip
def test_times_of_tables(column: str, first: str, settings: dict[str, Any], tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", [f"{column},lat,lon,alt", f"{first},49,8.4,110"])
    found = read_trajectory(path, TrajectoryFile(**settings))
    assert found.times_ns[0] == int(files.START.timestamp()) * SECOND_NS


@pytest.mark.parametrize(
    "names",
    ["Datum;Zeit", "date;time", "Tag;Uhrzeit", "Datum [UTC];UTC-Zeit", "Date;Time of day", "GPS-Datum;GPS-Zeit"],
)
def test_dates_and_times_in_two_columns(names: str, tmp_path: Path) -> None:
    path = files.write(tmp_path, "a.csv", [f"{names};Breite;Länge;Höhe", "07.02.2024;09:15:00,250;49,1;8,4;110,5"])
    found = read_trajectory(path, TrajectoryFile(time="utc"))
    assert found.times_ns.tolist() == [int(files.START.timestamp()) * SECOND_NS + SECOND_NS // 4]
    assert trajectory_format(path) == "table"


@pytest.mark.parametrize(
    ("lines", "settings", "expected"),
    [
        (["time,lat,alt", "1707297300,49,110"], {"format": "table"}, r"columns for a position \(lat, .* found time, lat, alt"),
        (["when,lat,lon,alt", "1707297300,49,8,110"], {"format": "table"}, "a column for a time, found when"),
        (["gps_time,lat,lon,alt", "2024-02-07 09:15:18,49,8,110"], {}, "GPS time, which is some seconds ahead"),
        (["local_time,lat,lon,alt", "2024-02-07 10:15:00,49,8,110"], {}, "the time zone of this local time is unknown"),
        (["Messzeit (lokal),lat,lon,alt", "2024-02-07 10:15:00,49,8,110"], {"columns": {"time": "Messzeit (lokal)"}},
         "the time zone of this local time is unknown"),
        (["time,lat,lon,alt", "33300,49,8,110"], {}, "does not state which"),
        (["time,lat,lon,alt", "33300,49,8,110"], {"date": date(2024, 2, 7)}, "GPS time, which"),
        (["time,lat,lon,alt", "07/02/2024 09:15:00,49,8,110"], {}, "two ways"),
        (["time,lat,latitude,lon,alt", "1707297300,49,48,8,110"], {}, "may both be the lat"),
        (["time,lat,lon,h_msl", "1707297300,49,8,110"], {}, "geoid"),
        (["time,lat,lon,h_msl", "1707297300,49,8,110"], {"heights": "EPSG:5773"}, "us_nga_egm96_15.tif"),
        (["time,lat,lon,h_msl", "1707297300,49,8,110"], {"heights": "nowhere.gtx"}, "nowhere.gtx"),
        (["time,lat,lon,h_msl", "1707297300,49,8,110"], {"heights": "../../etc/x.gtx"}, "without a folder"),
        (["time,lat,lon,h_msl", "1707297300,49,8,110"], {"heights": "EPSG:25832"}, "not a CRS of heights"),
        (["time,easting,northing,h", "1707297300,458000,5427000,110"], {}, "crs"),
        (["time,easting,northing,h", "1707297300,458000,5427000,110"], {"crs": "EPSG:4326"}, "projected"),
        (["time,easting,northing,h", "1707297300,3458000,5427000,110"], {"crs": "EPSG:31467"}, "BETA2007"),
        (["time,lat,lon,h", "1707297300,49,8,110"], {"frame": "ITRF2020"}, "belong together"),
        (["time,lat,lon,h", "1707297300,49,8,110"], {"frame": "ITRF2020", "map_frame": "JGD2011"}, "no transformation"),
        (["time,lat,lon,h", "1707297300,49,8,110"], {"frame": "ITRS", "map_frame": "ETRF2000"}, "frame: 'ITRS' is not known"),
        (["time,lat,lon,height_ft", "1707297300,49,8,110"], {}, "unit 'ft'"),
        (["time,lat,lon,alt", "1707297300,49,8,110"], {"columns": {"lat": "Lat"}}, "has no column 'Lat', which"),
        (["time,lat,lon,alt", "1707297300,49,8,110"], {"columns": {"latt": "lat"}}, "'latt' is unknown"),
        (["time,lat,lon", "1707297300,49,8"], {"format": "table"}, "no column for 'height'"),
        (["time,lat,lon,alt", "1707297300,nan,8,110"], {}, "line 2: the latitude"),
        (["time,lat,lon,alt", "1707297300,0,0,0"], {}, "no fix"),
        (["time,lat,lon,alt", "4707297300000000000,49,8,110"], {}, "neither a date and time"),
        (["time,lat,lon,alt"], {}, "no records"),
        (["a,b,c", "1,2,3"], {}, "found a, b, c. Name them in drive.yaml"),
        (["Messzeit;geogr. Breite;Länge [°];H"], {}, r"found Messzeit, geogr. Breite, Länge \[°\], H. Name them"),
        ([], {}, "no line with the names of the columns"),
    ],
)  # fmt: skip
def test_tables_that_may_be_misread_are_refused(
    lines: list[str], settings: dict[str, Any], expected: str, tmp_path: Path
) -> None:
    path = files.write(tmp_path, "a.csv", lines)
    with pytest.raises(InputError, match=expected):
        read_trajectory(path, TrajectoryFile(**settings))


# --------------------------------------------------------------------------- records


def test_a_damaged_line_costs_its_record(tmp_path: Path) -> None:
    path, t = files.write_csv(tmp_path), files.known()
    lines = path.read_text().splitlines()
    lines[7] = lines[7].replace("49.", "x.")
    lines[9] = "2024-02-07T"
    lines[11] = lines[11].replace("2024", "1980")
    lines[20] = lines[19]
    path.write_text("\n".join(lines))
    found = read_trajectory(path)
    assert len(found.times_ns) == files.COUNT - 4
    assert list(found.bad) == [t.times_ns[5], t.times_ns[17]]
    assert found.bad[int(t.times_ns[5])].startswith("line 8: the latitude")
    assert "second record" in found.bad[int(t.times_ns[17])]


def with_second_receiver(path: Path, aside_m: float, alternating: bool) -> Path:
    """The GGA sentences of another receiver, so far north, after or before those of the same epoch."""
    t, lines = files.known(), path.read_text().splitlines()
    moved = t._replace(llh=t.llh + np.array([aside_m / 111_195.0, 0.0, 0.0]))
    other = files.write_nmea(path.parent, moved).read_text().splitlines()
    for i in range(0, len(lines), len(lines) // files.COUNT):
        both = [lines[i], files.sentence(other[i][1:-3].replace("GNGGA", "GPGGA"))]
        lines[i] = "\n".join(both[::-1] if alternating and i % 2 else both)
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("alternating", [False, True])
def test_two_receivers_in_one_log_are_refused(alternating: bool, tmp_path: Path) -> None:
    path = with_second_receiver(files.write_nmea(tmp_path), 1.2, alternating)
    with pytest.raises(InputError, match=r"40 records have the time .* 1.2 m off, the first at 2024-02-07T09:15:00"):
        read_trajectory(path)


def test_two_talkers_with_one_position_are_one_receiver(tmp_path: Path) -> None:
    found = read_trajectory(with_second_receiver(files.write_nmea(tmp_path), 0.05, True))
    assert len(found.times_ns) == files.COUNT


def test_times_without_their_fractions_are_refused(tmp_path: Path) -> None:
    t = files.known()
    path = files.write_csv(tmp_path, t._replace(times_ns=t.times_ns // SECOND_NS * SECOND_NS, sigma=0.1 * t.sigma))
    with pytest.raises(InputError, match=r"36 records have the time of another one.*whole times"):
        read_trajectory(path)


def test_times_of_too_few_digits_are_refused_without_sigmas_too(tmp_path: Path) -> None:
    """A logger of 10 Hz that rounds to tenths of a second: some records share a time, others have none."""
    t = files.known()
    shifted = t.times_ns + 50_000_000 - np.arange(files.COUNT) % 3 * 4_000_000
    rounded = (shifted + SECOND_NS // 20) // (SECOND_NS // 10) * (SECOND_NS // 10)
    path = files.write_csv(tmp_path, t._replace(times_ns=rounded, llh=t.llh + (t.llh - t.llh[0])))
    lines = [",".join(line.split(",")[:4]) for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"records have the time of another one.* rounded, here to 0.1 s.*whole times"):
        read_trajectory(path)


def test_quality_of_rtklib(tmp_path: Path) -> None:
    found = read_trajectory(files.write_rtklib(tmp_path, quality=5))
    np.testing.assert_array_equal(found.sigma[:, :3], np.tile([5.0, 5.0, 10.0], (files.COUNT, 1)))
    with pytest.raises(InputError, match="no solution"):
        read_trajectory(files.write_rtklib(tmp_path, quality=0))
    path = files.write_rtklib(tmp_path)
    path.write_text(path.read_text().replace("latitude(deg)", "e-baseline(m)"))
    with pytest.raises(InputError, match="base"):
        read_trajectory(path)
    path = files.write_rtklib(tmp_path)
    path.write_text(path.read_text().replace("WGS84/ellipsoidal", "WGS84/geodetic"))
    with pytest.raises(InputError, match="above sea level"):
        read_trajectory(path)


def test_nmea_without_gst_has_sigmas_of_its_quality(tmp_path: Path) -> None:
    path = files.write_nmea(tmp_path, attitude=False)
    lines = [line for line in path.read_text().splitlines() if "GST" not in line]
    lines[0] = lines[0].replace("GNGGA", "GNGGB")
    lines.append(files.sentence("GNGGA,091600.00,4900.0,N,00800.0,E,4,17,0.7,high,M,47.9,M,1.0,0123"))
    path.write_text("\n".join(lines))
    found = read_trajectory(path)
    assert len(found.times_ns) == files.COUNT - 1
    np.testing.assert_allclose(found.sigma[:, :3], np.tile([0.05, 0.05, 0.1], (files.COUNT - 1, 1)))
    assert found.rotations is None
    path.write_text("\n".join(files.sentence(line[1:-3].replace(",4,17,", ",0,17,")) for line in lines))
    with pytest.raises(InputError, match="no fix"):
        read_trajectory(path)


def test_a_gpx_height_of_unknown_reference_has_a_sigma_that_covers_the_geoid(tmp_path: Path) -> None:
    path = files.write_gpx(tmp_path, geoid=False)
    assert (read_trajectory(path).sigma[:, 2] == 100.0).all()
    assert np.isnan(read_trajectory(path, TrajectoryFile(heights="ellipsoidal")).sigma).all()
    path.write_text(path.read_text().replace("<gpx ", '<!DOCTYPE gpx [<!ENTITY a "b">]><gpx ', 1))
    with pytest.raises(InputError, match="DOCTYPE"):
        read_trajectory(path)


def test_logs_without_positions_that_count_say_what_to_record(tmp_path: Path) -> None:
    path = files.write_gpx(tmp_path)
    path.write_text(path.read_text().replace("trkpt", "wpt"))
    with pytest.raises(InputError, match=r"no point of a track \(trkpt\): export the track"):
        read_trajectory(path)
    path = files.write_nmea(tmp_path)
    path.write_text("".join(line for line in path.read_text().splitlines(keepends=True) if "RMC" in line[:6]))
    with pytest.raises(InputError, match=r"no GGA or GNS sentence with a time, and others have no heights: log GGA"):
        read_trajectory(path)


def test_a_geoid_grid_beside_the_file(tmp_path: Path) -> None:
    header = np.array([48.0, 7.0, 1.0, 1.0], ">f8").tobytes() + np.array([3, 3], ">i4").tobytes()
    (tmp_path / "geoid.gtx").write_bytes(header + np.full(9, 47.5, ">f4").tobytes())
    path = files.write(tmp_path, "a.csv", ["time,lat,lon,h_msl", "1707297300,49,8.4,110", "1707297301,70,8.4,110"])
    found = read_trajectory(path, TrajectoryFile(heights="geoid.gtx"))
    assert found.positions[0] == pytest.approx([49.0, 8.4, 157.5], abs=1e-9)
    assert "outside the area" in next(iter(found.bad.values()))


def test_frames_are_transformed_at_the_time_of_each_record(tmp_path: Path) -> None:
    """Against the 14 parameters from ITRF2014 to ETRF2000 of EUREF Technical Note 1 (2018), for epoch 2010.0."""
    shift_m, shift_m_a = np.array([0.0547, 0.0522, -0.0741]), np.array([1e-4, 1e-4, -1.9e-3])
    turn, turn_a = (np.radians(np.array(mas) / 3.6e6) for mas in ([1.701, 10.290, -16.632], [0.081, 0.490, -0.792]))
    rows = ["2010-01-01T00:00:00Z,49,8.4,110", "2024-07-01T12:00:00Z,49,8.4,110"]
    path = files.write(tmp_path, "a.csv", ["time,lat,lon,h_ell", *rows])
    found = read_trajectory(path, TrajectoryFile(frame="ITRF2014", map_frame="ETRF2000"))
    xyz = np.array(TO_ECEF.transform(49.0, 8.4, 110.0))
    for position, years in zip(found.positions, (0.0, 14.5), strict=True):
        scale = 2.12e-9 + 0.11e-9 * years
        expected = xyz + shift_m + shift_m_a * years + scale * xyz + np.cross(turn + turn_a * years, xyz)
        assert np.linalg.norm(np.array(TO_ECEF.transform(*position)) - expected) < 1e-3
    assert np.linalg.norm(np.subtract(*(TO_ECEF.transform(*p) for p in found.positions))) > 0.3


def test_geocentric_and_numbered_columns(tmp_path: Path) -> None:
    x, y, z = TO_ECEF.transform(49.0, 8.4, 110.0)
    path = files.write(tmp_path, "a.txt", [f"1707297300 {x:.4f} {y:.4f} {z:.4f}"])
    columns: dict[str, str | int] = {"time": 1, "x": 2, "y": 3, "z": 4}
    found = read_trajectory(path, TrajectoryFile(format="table", columns=columns, crs="EPSG:4978"))
    assert apart_m(found.positions, [[49.0, 8.4, 110.0]]) < 1e-3


def test_yaw_columns_are_those_of_conetl(tmp_path: Path) -> None:
    path = files.write(
        tmp_path,
        "a.csv",
        ["captured_at,lat_deg,lon_deg,height_m,roll_deg,pitch_deg,yaw_deg", "2024-02-07 09:15:00,49,8.4,110,2,3,60"],
    )
    rotations = read_trajectory(path).rotations
    assert rotations is not None
    assert angle_rad(rotations, true_rotations(np.array([[2.0, -3.0, 30.0]]))) < 1e-9


def test_a_local_file_has_no_crs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="local"):
        read_trajectory(files.write_tum(tmp_path), TrajectoryFile(crs="EPSG:25832"))


def write_yaw(folder: Path, course_deg: Any, *, as_heading: bool, offset_deg: float = 0.0) -> Path:
    """A drive of 1 m steps in these directions (clockwise from north), with a yaw as in NED or ENU, and 1 degree of climb."""
    course = np.radians(np.broadcast_to(course_deg, 60))
    east, north = np.cumsum(np.sin(course)), np.cumsum(np.cos(course))
    lat, lon = 49.0 + north / 111_195.0, 8.4 + east / (111_195.0 * np.cos(np.radians(49.0)))
    heading = np.degrees(course) + offset_deg
    angle = (heading if as_heading else 90.0 - heading + 540.0) % 360.0 - (0.0 if as_heading else 180.0)
    pitch = 1.0 if as_heading else -1.0
    rows = [
        f"{1707297300 + 0.1 * i:.1f},{a:.9f},{b:.9f},110,2,{pitch},{c:.4f}"
        for i, (a, b, c) in enumerate(zip(lat, lon, angle, strict=True))
    ]
    return files.write(folder, "a.csv", ["time,lat,lon,alt,roll,pitch,yaw", *rows])


STRAIGHT = [0.0, 10.0, 60.0, 75.0, 90.0, 135.0, 180.0, 200.0, 270.0, 300.0, 350.0]


@pytest.mark.parametrize("as_heading", [True, False])
@pytest.mark.parametrize(
    "course", [*STRAIGHT, *(at + 20.0 * np.sin(np.arange(60) / 10.0) for at in (0.0, 45.0, 130.0, 225.0))]
)
def test_a_yaw_counts_as_the_drive_path_shows(course: Any, as_heading: bool, tmp_path: Path) -> None:
    found = read_trajectory(write_yaw(tmp_path, course, as_heading=as_heading))
    assert found.rotations is not None
    expected = np.column_stack([np.full(60, 2.0), np.ones(60), np.broadcast_to(course, 60)])
    assert angle_rad(found.rotations, true_rotations(expected)) < 1e-5
    assert [*found.notes] == (
        [f"{tmp_path}/a.csv: compared with the drive path, the column 'yaw' counts clockwise from north (NED)"]
        if as_heading
        else []
    )


@pytest.mark.parametrize("as_heading", [True, False])
@pytest.mark.parametrize(("course", "offset"), [(45.0, 0.0), (47.0, 0.0), (225.0, 0.0), (100.0, 30.0)])
def test_a_yaw_whose_axes_the_drive_path_does_not_show_is_asked_for(
    course: float, offset: float, as_heading: bool, tmp_path: Path
) -> None:
    path = write_yaw(tmp_path, course, as_heading=as_heading, offset_deg=offset)
    with pytest.raises(
        InputError, match=r"may count clockwise from north .* \{columns: \{heading: yaw\}\} or \{yaw: yaw\}"
    ):
        read_trajectory(path)
    found = read_trajectory(path, TrajectoryFile(columns={"heading" if as_heading else "yaw": "yaw"})).rotations
    assert found is not None
    assert angle_rad(found, true_rotations(np.array([[2.0, 1.0, course + offset]]))) < 1e-5


def test_a_yaw_that_is_stated_and_contradicts_the_drive_path_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"clockwise from north, as a heading does"):
        read_trajectory(write_yaw(tmp_path, 100.0, as_heading=True), TrajectoryFile(columns={"yaw": "yaw"}))


# --------------------------------------------------------------------------- on the map


def drive_in(folder: Path, **settings: Any) -> Source:
    return Source(folder, folder, DriveYaml.model_validate(settings), ContentHash())


def test_poses_on_the_map_have_lever_arm_and_convergence(tmp_path: Path) -> None:
    t = files.known()
    recorded = read_trajectory(files.write_csv(tmp_path))
    antenna = (0.4, -0.2, 1.1)
    srid, track = placed(recorded, drive_in(tmp_path, antenna_t_m=antenna), np.eye(3))
    assert srid == 32632 and track.times_ns == t.times_ns.tolist()
    back = track.map_SE3_body[:, :3, :3] @ np.array(antenna) + track.map_SE3_body[:, :3, 3]
    east, north = Transformer.from_crs(4326, srid, always_xy=True).transform(t.llh[:, 1], t.llh[:, 0])
    np.testing.assert_allclose(back, np.column_stack([east, north, t.llh[:, 2]]), atol=1e-3)
    yaw = np.arctan2(track.map_SE3_body[:, 1, 0], track.map_SE3_body[:, 0, 0])
    expected = np.radians(90.0 - t.rph[:, 2]) + grid_convergence_rad(srid, t.llh[:, 0], t.llh[:, 1])
    np.testing.assert_allclose(yaw, expected, atol=1e-6)
    tilt, turn = track.sigma[:, 3:5].max(axis=1), track.sigma[:, 5]
    level_m = np.hypot(*antenna[:2])
    added = np.column_stack([*[(level_m * turn) ** 2 + (antenna[2] * tilt) ** 2] * 2, (level_m * tilt) ** 2])
    np.testing.assert_allclose(track.sigma[:, :3] ** 2, recorded.sigma[:, :3] ** 2 + added, rtol=1e-9)


def test_unknown_sigmas_must_be_given(tmp_path: Path) -> None:
    recorded = read_trajectory(files.write_oxts(tmp_path))
    # pos_accuracy is that of north and east.
    np.testing.assert_allclose(recorded.sigma, np.tile([0.011, 0.011, 0.0165, *[np.nan] * 3], (files.COUNT, 1)))
    blind = recorded._replace(sigma=np.full((files.COUNT, 6), np.nan))
    with pytest.raises(InputError, match="horizontal_m"):
        placed(blind, drive_in(tmp_path), np.eye(3))
    _, track = placed(blind, drive_in(tmp_path, sigmas={"horizontal_m": 0.2}), np.eye(3))
    np.testing.assert_allclose(track.sigma[0], [0.2, 0.2, 0.3, *np.radians([0.05, 0.05, 0.15])])
    sea = recorded._replace(sigma=recorded.sigma * [1, 1, 1e4, 1, 1, 1])
    _, track = placed(sea, drive_in(tmp_path, sigmas={"horizontal_m": 0.2}), np.eye(3))
    assert track.sigma[0, 2] > 100.0
    with pytest.raises(InputError, match="attitudes"):
        placed(recorded._replace(rotations=None), drive_in(tmp_path), np.eye(3))


@pytest.mark.parametrize(
    ("recorded_m", "stated", "found_m"),
    [
        # A recorded height stays as uncertain as it is.
        ((0.1, 5.0), {"horizontal_m": 0.2}, (0.2, 5.0)),
        ((0.1, 5.0), {"horizontal_m": 0.2, "vertical_m": 0.4}, (0.2, 0.4)),
        ((0.1, np.nan), {"horizontal_m": 0.2}, (0.2, 0.3)),
        ((0.1, 2000.0), {"horizontal_m": 0.2}, (0.2, 0.3)),
        # Only recorded sigmas have a limit.
        ((2000.0, np.nan), {"horizontal_m": 0.2}, (0.2, 0.3)),
        ((2000.0, np.nan), {"horizontal_m": 5000.0}, (5000.0, 7500.0)),
        ((2000.0, np.nan), {}, (np.nan, np.nan)),
    ],
)
def test_stated_sigmas_take_the_place_of_recorded_ones(
    recorded_m: tuple[float, float], stated: dict[str, float], found_m: tuple[float, float]
) -> None:
    across_m, up_m = recorded_m
    found = stated_sigmas(np.array([[across_m, 0.1, up_m, np.nan, np.nan, np.nan]]), Sigmas(**stated))
    np.testing.assert_allclose(found[0, :3], [found_m[0], *found_m])
