"""NMEA logs as receivers write them: any order within an epoch, several talkers, other bytes between, no checksums."""

from __future__ import annotations

import random
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conetl.model.errors import InputError
from conetl.readers.trajectories import read_trajectory, remarks_on, trajectory_format
from conetl.readers.trajectories.recorded import RecordedTrajectory
from conetl.readers.trajectories.settings import TrajectoryFile
from tests.unit.readers.trajectory_files import GEOID_M, minutes, sentence

SECOND_NS = 10**9
PER_EXAMPLE = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
#: Sentences of an epoch; {} are the time of day, the position, the date, the heading and the height.
KINDS = {
    "GGA": "GNGGA,{clock},{place},4,17,0.7,{up:.4f},M,{geoid},M,1.0,0123",
    "GNS": "GNGNS,{clock},{place},RNNN,17,0.7,{up:.4f},{geoid},1.0,0123,V",
    "RMC": "GNRMC,{clock},A,{place},20.0,30.0,{day},,,R,V",
    "ZDA": "GNZDA,{clock},{day:.2},{day[2]}{day[3]},20{day[4]}{day[5]},00,00",
    "GST": "GNGST,{clock},0.02,0.015,0.01,30.0,0.012,0.011,0.025",
    "HDT": "GNHDT,{heading:.3f},T",
    "THS": "GNTHS,{heading:.3f},A",
    "GSA": "GNGSA,A,3,01,02,03,,,,,,,,,,1.2,0.7,1.0,1",
}  # fmt: skip


def truth(epoch: Any) -> Any:
    """Heading in an epoch, degrees."""
    return 60.0 + 50.0 * np.sin(np.asarray(epoch) / 3.0)


def epochs(
    kinds: list[str], count: int = 12, step_s: float = 0.1, start: datetime = datetime(2024, 2, 7, 9, 15, tzinfo=UTC)
) -> list[list[str]]:
    """Bodies of the sentences of each epoch, of a vehicle that goes in bends."""
    found = []
    course = np.radians(truth(np.arange(count)))
    before = np.radians(truth(np.arange(count) - 0.5))
    north, east = np.cumsum(np.cos(before)) * 10 * step_s, np.cumsum(np.sin(before)) * 10 * step_s
    for k in range(count):
        time_ns = int(start.timestamp()) * SECOND_NS + round(k * step_s * 1e9)
        moment = datetime.fromtimestamp(time_ns // SECOND_NS, UTC)
        lat, lon = -49.0 + north[k] / 111_195.0, -8.43 + east[k] / (111_195.0 * np.cos(np.radians(49.0)))
        values: dict[str, Any] = {
            "clock": f"{moment:%H%M%S}.{time_ns % SECOND_NS // 10**7:02d}", "day": f"{moment:%d%m%y}",
            "place": f"{minutes(lat, 2, 'NS')},{minutes(lon, 3, 'EW')}", "geoid": GEOID_M, "up": 68.0 + 0.01 * k,
            "heading": float(np.degrees(course[k])) % 360.0,
        }  # fmt: skip
        found.append([KINDS[kind].format(**values) for kind in kinds])
    return found


def read(path: Path, lines: list[str], **stated: Any) -> RecordedTrajectory:
    path.write_text("\r\n".join(lines) + "\r\n", newline="")
    return read_trajectory(path, TrajectoryFile(**stated))


def same(a: RecordedTrajectory, b: RecordedTrajectory) -> None:
    """Raise AssertionError unless all records are the same."""
    assert a.bad == b.bad == {}
    np.testing.assert_array_equal(a.times_ns, b.times_ns)
    for one, other in ((a.positions, b.positions), (a.rotations, b.rotations), (a.sigma, b.sigma)):
        if one is None or other is None:
            assert one is other
        else:
            np.testing.assert_array_equal(one, other)


def headings(found: RecordedTrajectory) -> Any:
    assert found.rotations is not None
    return np.degrees(np.arctan2(found.rotations[:, 0, 0], found.rotations[:, 1, 0])) % 360.0


@PER_EXAMPLE
@given(
    seed=st.integers(0, 2**32), heading=st.sampled_from(["HDT", "THS"]), fix=st.sampled_from(["GGA", "GNS"]),
    dated=st.sampled_from(["RMC", "ZDA"]),
    start=st.sampled_from([(2024, 2, 7, 9, 15), (2024, 2, 28, 23, 59, 59), (2023, 12, 31, 23, 59, 59)]),
    fixed=st.booleans(),
)  # fmt: skip
def test_any_order_of_the_sentences_of_an_epoch_gives_the_same_records(
    seed: int, heading: str, fix: str, dated: str, start: tuple[int, ...], fixed: bool, tmp_path: Path
) -> None:
    whole = epochs([fix, dated, "GST", "GSA", heading], start=datetime(*start, tzinfo=UTC))  # type: ignore[misc, arg-type]
    rng = random.Random(seed)
    order = rng.sample(range(5), 5)
    mixed = [[one[i] for i in (order if fixed else rng.sample(range(5), 5))] for one in whole]
    expected = read(tmp_path / "a.nmea", [sentence(body) for one in whole for body in one])
    found = read(tmp_path / "b.nmea", [sentence(body) for one in mixed for body in one])
    assert len(found.times_ns) == 12
    assert set(np.diff(found.times_ns)) == {SECOND_NS // 10}
    np.testing.assert_allclose(headings(found), truth(np.arange(12)), atol=1e-3)
    same(found, expected)


@pytest.mark.parametrize("kinds", [["GGA", "RMC", "HDT"], ["HDT", "GGA", "RMC"], ["GGA", "HDT", "RMC"]])
@pytest.mark.parametrize("step_s", [0.1, 1.0])
@pytest.mark.parametrize("first", range(4))
def test_a_log_that_begins_or_ends_inside_an_epoch(kinds: list[str], step_s: float, first: int, tmp_path: Path) -> None:
    lines = [sentence(body) for one in epochs(kinds, 20, step_s) for body in one]
    for last in range(len(lines) - 3, len(lines) + 1):
        found = read(tmp_path / "a.nmea", lines[first:last])
        off = np.abs(headings(found) - truth(np.round((found.times_ns - 1707297300 * SECOND_NS) * 1e-9 / step_s)))
        # At 10 Hz whole epochs at the ends show of which epoch a heading is, one as well if the other was cut before its date.
        shows = [{0: 1, kinds.index("RMC"): 0}.get(number % 3, -1) for number in (first, last)]
        assert off.max() < 1e-3 or (sum(shows) <= 0 and step_s == 0.1) or kinds[1] == "HDT", (first, last)
        assert off[1:-1].max() < 17.0


def test_lost_headings_cost_their_epochs_only(tmp_path: Path) -> None:
    for kinds in (["GGA", "RMC", "HDT"], ["HDT", "GGA", "RMC"]):
        lines = [sentence(body) for one in epochs(kinds, 30) for body in one]
        lost = [i for i, line in enumerate(lines) if "HDT" in line][7:9]
        found = read(tmp_path / "a.nmea", [line for i, line in enumerate(lines) if i not in lost])
        assert len(found.times_ns) == 28 and len(found.bad) == 2
        numbers = np.round((found.times_ns - 1707297300 * SECOND_NS) * 1e-8)
        np.testing.assert_allclose(headings(found), truth(numbers), atol=1e-3)


@PER_EXAMPLE
@given(seed=st.integers(0, 2**32), talkers=st.permutations(["GP", "GN", "GL"]))
def test_talkers_of_one_receiver_are_one(seed: int, talkers: list[str], tmp_path: Path) -> None:
    """Whichever comes first, the records are those of GN."""
    rng = random.Random(seed)
    lines, expected = [], []
    for one in epochs(["GGA", "RMC", "GST", "HDT"]):
        expected += [sentence(body) for body in one]
        several = [(i, talker) for i in (0, 2) for talker in talkers] + [(1, talkers[0]), (3, "GN")]
        for i, talker in rng.sample(several, len(several)):
            worse = (
                one[i].replace("0.012,0.011", "0.112,0.111").replace(",17,0.7,", ",9,1.7,")
                if talker != "GN"
                else one[i]
            )
            lines.append(sentence(talker + worse[2:]))
    found = read(tmp_path / "b.nmea", lines)
    same(found._replace(bad={}), read(tmp_path / "a.nmea", expected))


@PER_EXAMPLE
@given(between=st.lists(st.binary(min_size=1, max_size=300), min_size=1, max_size=6), seed=st.integers(0, 2**32))
def test_other_bytes_between_the_sentences_change_nothing(between: list[bytes], seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    lines = [sentence(body) for one in epochs(["GGA", "RMC", "GST", "HDT"]) for body in one]
    expected = read(tmp_path / "a.nmea", lines)
    path = tmp_path / "b.ubx"
    messages = [b"\xb5\x62\x01\x07\x5c\x00" + rng.choice(between) + b"\0" for _ in lines]
    path.write_bytes(b"".join(a + line.encode() + b"\r\n" for a, line in zip(messages, lines, strict=True)))
    assert trajectory_format(path) == "nmea"
    same(read_trajectory(path), expected)


def test_logs_without_checksums_are_read_with_a_note(tmp_path: Path) -> None:
    lines = [sentence(body) for one in epochs(["GGA", "RMC", "GST", "HDT"]) for body in one]
    bare = [line.partition("*")[0] for line in lines]
    found = read(tmp_path / "a.nmea", bare)
    same(found, read(tmp_path / "b.nmea", lines))
    assert [*found.notes] == remarks_on(tmp_path / "a.nmea", TrajectoryFile())
    assert "no checksums" in found.notes[0]
    # A cut line of a log without checksums, and one without a checksum in a log that has them, are not used.
    assert len(read(tmp_path / "c.nmea", [*bare[:-4], bare[-4][:30], *bare[-3:]]).times_ns) == 11
    assert len(read(tmp_path / "d.nmea", [*lines[:-4], bare[-4], *lines[-3:]]).times_ns) == 11


@pytest.mark.parametrize(
    ("modes", "sigma_m"), [("R", 0.05), ("NF", 0.5), ("AAR", 0.05), ("DNNN", 2.0), ("A", 5.0), ("P", 5.0)]
)
def test_gns_states_its_quality_per_system(modes: str, sigma_m: float, tmp_path: Path) -> None:
    lines = [sentence(body.replace("RNNN", modes)) for one in epochs(["GNS", "RMC"]) for body in one]
    np.testing.assert_allclose(read(tmp_path / "a.nmea", lines).sigma[:, 0], sigma_m)
    lost = [sentence(line[1:-3].replace(f",{modes},", ",N,", 1)) if "GNS" in line else line for line in lines]
    with pytest.raises(InputError, match=r"line 1: GGA quality 0: there was no fix"):
        read(tmp_path / "b.nmea", lost)


def test_two_days_at_the_same_time_of_day_have_their_own_dates(tmp_path: Path) -> None:
    for kinds in (["GGA", "RMC"], ["RMC", "GGA"]):
        parts = [epochs(kinds, 100, start=datetime(2024, 2, day, 9, 15, tzinfo=UTC)) for day in (7, 9)]
        found = read(tmp_path / "a.nmea", [sentence(body) for part in parts for one in part for body in one])
        assert found.times_ns[100] - found.times_ns[0] == 2 * 86_400 * SECOND_NS
        assert found.times_ns[199] - found.times_ns[100] == 99 * SECOND_NS // 10
