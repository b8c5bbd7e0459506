"""Drives that contradict the map as a whole are one finding; good ones, whatever they change, are none."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.checks.verdict import judge
from conetl.mapping.agreement import check_agreement
from conetl.mapping.changes import reconcile
from conetl.mapping.deltas import ReconcileContext
from conetl.mapping.displacement import check_displacement, check_far_positions, check_same_cones
from conetl.mapping.visibility import NotObserved
from conetl.model.drive import Track
from conetl.model.health import Finding
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from tests import records
from tests.synthetic.world import ORIGIN_M, START_NS

Floats = NDArray[np.float64]
DAY_NS = 86_400_000_000_000
PARAMS = ReconcileParams()
#: A taper and a row of equal distances.
ZONE = np.array([(5.0 * k, 4.0 - 0.4 * min(k, 5), 0.0) for k in range(9)])


def features_at(places: Floats, sigma_m: float = 0.03) -> list[MapFeature]:
    return [
        records.feature(k, seen_ns=START_NS, observation_count=12, **standing(place, sigma_m))
        for k, place in enumerate(places)
    ]


def standing(place: Floats, sigma_m: float) -> dict[str, object]:
    return records.standing_at(ORIGIN_M + place, 0.7, records.cov_of(sigma_m))


def tracks_at(places: Floats, sigma_m: float = 0.03, seed: int = 0) -> list[Track]:
    rng = np.random.default_rng(seed)
    return [
        records.track(
            k, 12, seen_ns=START_NS + DAY_NS, relative_cov_m2=records.cov_of(0.02), members=((10 * k, 0),),
            **standing(place + rng.normal(0, 0.01, 3), sigma_m),
        )
        for k, place in enumerate(places)
    ]  # fmt: skip


def finding(
    places: Floats,
    before: Floats = ZONE,
    *,
    sigma_m: float = 0.03,
    seed: int = 0,
    in_view: bool = True,
    waits_after: int | None = None,
) -> str | None:
    """What a drive that sees cones at `places` (N, 3) finds against a map with cones at `before`.

    waits_after: the drive waits for a minute after so many cones.
    """
    tracks, known = tracks_at(places, sigma_m, seed), features_at(before, sigma_m)
    if waits_after is not None:
        tracks[waits_after:] = [
            track.model_copy(
                update={name: getattr(track, name) + 60 * 10**9 for name in ("first_seen_ns", "last_seen_ns")}
            )
            for track in tracks[waits_after:]
        ]
    unseen = NotObserved(20, START_NS + DAY_NS, -6.0) if in_view else None
    deltas = reconcile(tracks, known, lambda *_: unseen, ReconcileContext(PARAMS, "d"))
    found = check_agreement(tracks, known, deltas, PARAMS)
    backwards = check_agreement(tracks[::-1], known[::-1], deltas[::-1], PARAMS)
    assert found == backwards, "the order matters"
    assert found is None or (found.value is not None and found.limit is not None and abs(found.value) > found.limit)
    return found and judge(found).detail


def turned(places: Floats, degrees: float, about: tuple[float, float] = (-30.0, 0.0)) -> Floats:
    angle = np.radians(degrees)
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    centre = np.array([*about, 0.0])
    return (places - centre) @ rotation.T + centre


@pytest.mark.parametrize(
    ("places", "says"),
    [
        (ZONE - np.array((0, 0, 48.0)), "48.0 m lower"),
        (ZONE[:1] + np.array((0, 0, 48.0)), "48.0 m higher"),
        (ZONE + np.array((0, 0, 1.8)), "1.8 m higher"),
        (ZONE + np.array((0, 0, 0.25)), "0.25 m higher"),  # the height of the cameras above the antenna is wrong
        (ZONE[:3] - np.array((0, 0, 0.25)), "0.25 m lower"),
        (ZONE + np.array((0.2, 0.3, 0)), "0.4 m from those of the map"),
        (ZONE + np.array((0, 3.0, 0)), "3.0 m from those of the map"),
        (ZONE[:6] + np.array((10.0, 2.0, 0)), "m from those of the map"),
        (turned(ZONE, 3.0), "rotated by +3.0 degrees"),
        (turned(ZONE, -1.5), "rotated by -1.5 degrees"),
        (ZONE + np.array((0, 50.0, 0)), "50.0 m from those of the map"),
        (ZONE[:0], "remove 9 of the 9 cones in its view, and shows 0:"),
        (ZONE[:1], "remove 8 of the 9 cones in its view, and shows 1:"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_drive_that_contradicts_the_map_is_one_finding(places: Floats, says: str) -> None:
    for seed in range(3):
        assert says in (finding(places, seed=seed) or "")


MOVED = ZONE.copy()
MOVED[[1, 4]] += np.array((0.4, 1.4, 0.0))


@pytest.mark.parametrize(
    "places",
    [
        ZONE,
        ZONE + np.array((0.05, 0.04, 0.05)),
        ZONE[2:],
        ZONE[3:] + np.array((0, 0, 0.1)),
        ZONE[::2],
        MOVED,
        np.vstack([ZONE[1:], ZONE[-1:] + np.array((5.0, 0, 0))]),  # the row shifted by one, at equal distances
        np.vstack([ZONE[4:], ZONE[-1:] + np.array((5.0, 0, 0)), ZONE[-1:] + np.array((10.0, 0, 0))]),
        1.3 * ZONE[::-1] * (1, -1, 1) + np.array((0, 40.0, 0)),  # cleared, and another zone set up
        np.vstack([ZONE, ZONE[:1] + np.array((0.2, 0.1, 6.0))]),  # one on the bridge above
    ],
    ids=("the same", "within its sigmas", "two gone", "three gone", "every other gone", "two moved", "one further", "four gone",
         "another zone", "on two levels"),
)  # fmt: skip
def test_a_road_that_has_changed_is_none(places: Floats) -> None:
    for seed in range(3):
        assert finding(places, seed=seed) is None


def test_a_row_that_goes_on_is_none() -> None:
    """A closure that is surveyed stretch by stretch: the next cones stand as the last ones do, at the same distances."""
    row = np.array([(2.0 * k, 3.0, 0.0) for k in range(40)])
    for overlap in (0, 1, 3):
        assert finding(row[20 - overlap :], row[:20], in_view=False) is None


#: As people set cones up.
UNEVEN = ZONE + np.random.default_rng(11).normal(0, 0.3, (9, 3)) * (1, 1, 0)


@pytest.mark.parametrize("shift", [(0.3, 0.6), (1.2, -1.5), (3.0, 4.0), (-3.0, 12.0)])
@pytest.mark.parametrize("first", [5, 6])
def test_a_part_of_a_drive_that_lies_aside_is_found(shift: tuple[float, float], first: int) -> None:
    """GNSS found another fix while the vehicle waited; three cones are known to be the same only near where they were."""
    places = np.vstack([UNEVEN[:first], UNEVEN[first:] + np.array((*shift, 0.0))])
    if first == 6 and np.hypot(*shift) > PARAMS.moved_max_m:
        assert finding(places, UNEVEN) is None
        return
    for seed in range(3):
        detail = finding(places, UNEVEN, seed=seed) or ""
        assert f"{np.hypot(*shift):.1f} m from those of the map" in detail
        assert f"Only {9 - first} of its cones" in detail


@pytest.mark.parametrize("in_view", [True, False], ids=("the old cones in view", "out of view"))
@pytest.mark.parametrize("shift", [(1.5, 1.5), (7.0, 0.2), (22.0, -3.0)])
@pytest.mark.parametrize("first", [3, 4, 6])
def test_a_displaced_part_behind_a_pause_is_found(first: int, shift: tuple[float, float], in_view: bool) -> None:
    """Its first part is right, three cones or more stand in its second part, and a new one beside them."""
    places = np.vstack([UNEVEN, UNEVEN[-1:] + np.array((2.0, 1.4, 0.0))])
    for seed in range(3):
        assert finding(places, UNEVEN, seed=seed, in_view=in_view, waits_after=first) is None
        aside = np.vstack([places[:first], places[first:] + np.array((*shift, 0.0))])
        detail = finding(aside, UNEVEN, seed=seed, in_view=in_view, waits_after=first) or ""
        assert f"{np.hypot(*shift):.1f} m from those of the map" in detail


@pytest.mark.parametrize("shift", [(0.55, 0.25), (-1.1, 1.0), (3.0, 1.0)])
def test_a_displaced_drive_that_shows_few_cones_is_found(shift: tuple[float, float]) -> None:
    """Another vehicle's lever arm; it shows the last three cones of the map and a new one."""
    places = np.vstack([UNEVEN[6:], UNEVEN[-1:] + np.array((2.0, 1.4, 0.0))])
    for seed in range(3):
        assert finding(places, UNEVEN, seed=seed, in_view=False) is None
        detail = finding(places + np.array((*shift, 0.0)), UNEVEN, seed=seed, in_view=False) or ""
        assert f"{np.hypot(*shift):.1f} m from those of the map" in detail


def test_another_zone_behind_a_pause_is_none() -> None:
    """It begins where the map's one ends, with distances like those."""
    for seed in range(20, 40):
        other = ZONE[:5] + np.array((50.0, 0.0, 0.0)) + np.random.default_rng(seed).normal(0, 0.3, (5, 3)) * (1, 1, 0)
        assert finding(np.vstack([UNEVEN, other]), UNEVEN, seed=seed, waits_after=len(UNEVEN)) is None


def test_cones_that_people_moved_in_one_direction_are_none() -> None:
    for seed in range(20):
        places = UNEVEN.copy()
        places[5:] += np.array((0.3, 0.8, 0.0)) + np.random.default_rng(seed).normal(0, 0.2, (4, 3)) * (1, 1, 0)
        assert finding(places, UNEVEN, seed=seed) is None


def test_an_offset_that_the_sigmas_cover_is_none() -> None:
    rng = np.random.default_rng(5)
    for _ in range(12):
        assert finding(ZONE + np.array((*rng.normal(0, 0.7, 2), rng.normal(0, 0.7))), sigma_m=0.7) is None


@pytest.mark.parametrize("sigma_m", [0.3, 0.7, 1.5])
def test_another_datum_is_found_beside_an_offset_of_gnss(sigma_m: float) -> None:
    rng = np.random.default_rng(6)
    for _ in range(8):
        offset = np.array([*np.clip(rng.normal(0, sigma_m, 2), -1.4, 1.4), -48.0])
        assert "48.0 m lower" in (finding(ZONE + offset, sigma_m=sigma_m) or "")


@pytest.mark.parametrize("count", [150, 250, 1000])
def test_long_rows_that_lie_aside_are_found(count: int) -> None:
    rng = np.random.default_rng(7)
    row = np.column_stack([np.cumsum(rng.uniform(3.0, 9.0, count)), rng.normal(3.0, 0.5, count), np.zeros(count)])
    found = finding(row + np.array((0, 10.0, 0)), row, in_view=False)
    assert found is not None and re.search(r"(9\.9|10\.[01]) m from those of the map", found)


def test_a_second_row_beside_the_first_one_is_none() -> None:
    """The other carriageway, or the other side of the lane, at the same distances; the first row is not in view."""
    rng = np.random.default_rng(8)
    for aside_m, count in ((3.5, 12), (20.0, 6), (20.0, 30)):
        row = np.column_stack([5.0 * np.arange(count), np.full(count, 3.0), np.zeros(count)])
        other = row + np.array((0, aside_m, 0)) + rng.normal(0, 0.1, (count, 3)) * (1, 1, 0)
        assert finding(other, row, in_view=False) is None


@pytest.mark.parametrize("aside_m", [20.0, 45.0])
def test_the_same_row_aside_is_known_by_small_differences_of_its_distances(aside_m: float) -> None:
    """A copy of a drive with another log: moved by one cone, its row of about equal distances fits nearly as well."""
    along = np.cumsum(np.random.default_rng(3).normal(4.5, 0.15, 9))
    row = np.column_stack([along, np.full(9, 3.0), np.zeros(9)])
    assert f"{aside_m:.1f} m from those of the map" in (
        finding(row + np.array((0, aside_m, 0)), row, in_view=False) or ""
    )


def test_the_same_zone_farther_along_the_road_is_told_from_one_like_it() -> None:
    """The first one is not in view. People who set up a zone twice place its cones at least 0.1 m differently."""
    rng = np.random.default_rng(9)
    for _ in range(10):
        zone = np.column_stack([np.cumsum(rng.uniform(3.0, 9.0, 5)), rng.normal(3.0, 1.0, 5), np.zeros(5)])
        farther = zone + np.array((50.0, 0, 0))
        for places, same in ((farther, True), (farther + rng.normal(0, 0.1, (5, 3)) * (1, 1, 0), False)):
            found = finding(places, zone, in_view=False)
            assert (found is not None) == same
            assert found is None or "50.0 m from those of the map" in found


@pytest.mark.parametrize(("renamed", "found"), [(9, True), (5, True), (4, False), (2, False)])
def test_a_drive_whose_classes_are_others_is_one_finding(renamed: int, found: bool) -> None:
    tracks = tracks_at(ZONE)
    tracks = [one.model_copy(update={"category": "drum"}) for one in tracks[:renamed]] + tracks[renamed:]
    for drive in (tracks, tracks[::-1]):
        check = check_agreement(drive, features_at(ZONE), [], PARAMS)
        said = f"{renamed} have another class, such as drum instead of traffic_cone"
        assert (check is not None and said in judge(check).detail) == found


def test_a_sign_above_a_cone_is_no_cone_of_a_higher_drive() -> None:
    cones = features_at(ZONE[:1])
    above = tracks_at(ZONE[:1] + np.array([0.0, 0.1, 2.0]))
    assert "higher" in str(check_agreement(above, cones, (), PARAMS))
    signs = [track.model_copy(update={"category": "work_zone_sign"}) for track in above]
    assert check_agreement(signs, cones, (), PARAMS) is None


#: The zone as people set it up, and another one like it.
SET_UP, LIKE_IT = (ZONE + np.random.default_rng(seed).normal(0, (0.2, 0.1, 0), ZONE.shape) for seed in (1, 2))


def imported(places: Floats, before: Floats, sigma_m: float = 0.03) -> str | None:
    """What an imported map of cones at `places` (N, 3), measured anew, finds against a map with cones at `before`."""
    stated = features_at(places + np.random.default_rng(5).normal(0, 0.01, places.shape), sigma_m)
    found = check_same_cones(stated, features_at(before), PARAMS)
    return found and judge(found).detail


@pytest.mark.parametrize(
    ("shift_m", "says"),
    [
        ((0.3, 0.2, 0.0), "0.4 m from"),
        ((1.0, 0.0, 0.0), "1.0 m from"),  # ITRF and ETRS89
        ((2.0, 9.0, 0.0), "9.2 m from"),  # feet of two lengths
        ((80.0, 200.0, 0.0), "215.4 m from"),  # ED50
        ((0.0, 0.0, -47.6), "47.6 m lower"),
    ],
)
def test_the_same_cones_in_another_datum_are_found_in_an_imported_map(shift_m: Floats, says: str) -> None:
    assert says in (imported(SET_UP + shift_m, SET_UP) or "")
    assert says in (imported((SET_UP + shift_m)[1:8], np.vstack([SET_UP, LIKE_IT + np.array((0, 12.0, 0))])) or "")


@pytest.mark.parametrize(
    ("places", "before", "sigma_m"),
    [
        (SET_UP, SET_UP, 0.03),
        (SET_UP + np.array((1.0, 1.5, 0)), SET_UP, 0.5),  # within its sigmas
        (ZONE + np.array((45.0, 0, 0)), ZONE, 0.03),  # a plan, section by section
        (ZONE + np.array((0, 3.5, 0)), ZONE, 0.03),  # both sides of a lane
        (LIKE_IT + np.array((0, 90.0, 0)), SET_UP, 0.03),  # another street
        (LIKE_IT + np.array((2.0, 150.0, 0)), np.vstack([SET_UP, SET_UP + np.array((0, 300.0, 0))]), 0.03),
        (np.vstack([SET_UP[:3], SET_UP[3:] + np.array((1.0, 1.0, 0))]), SET_UP, 0.03),  # moved in part
    ],
    ids=("the same", "within its sigmas", "goes on", "two sides", "another zone", "between two", "moved"),
)
def test_other_cones_of_an_imported_map_are_no_displacement(places: Floats, before: Floats, sigma_m: float) -> None:
    assert imported(places, before, sigma_m) is None


@pytest.mark.parametrize(
    ("places", "says"),
    [
        (SET_UP + np.array((80.0, 60.0, 0.0)), "100.0 m from"),
        (np.vstack([SET_UP[1:8], ZONE[8:] + 30.0]) + np.array((0.0, 290.0, 0.0)), "290.0 m from"),
        (SET_UP[:6] + np.array((80.0, 60.0, 0.0)), None),  # too few
        (SET_UP + np.array((240.0, 240.0, 0.0)), None),  # too far
        (LIKE_IT + np.array((80.0, 60.0, 0.0)), None),  # another zone like it
        (np.vstack([SET_UP, SET_UP + np.array((80.0, 60.0, 0.0))]), None),  # the same cones stand where they are
    ],
)
def test_the_same_cones_far_away_are_known_by_their_arrangement(places: Floats, says: str | None) -> None:
    measured = places + np.random.default_rng(6).normal(0, 0.01, places.shape)
    found = check_far_positions(tracks_at(measured), features_at(SET_UP), PARAMS)
    assert (found and found.check) == (says and "the same cones elsewhere")
    assert found is None or str(says) in judge(found).detail


@pytest.mark.parametrize("degrees", [30.0, 90.0, 180.0])
@pytest.mark.parametrize(("zone", "same"), [(SET_UP, True), (LIKE_IT, False)])
def test_the_same_cones_are_known_whatever_the_direction_of_a_local_frame(
    zone: Floats, same: bool, degrees: float
) -> None:
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()

    def near(tracks: list[Track], features: list[MapFeature], params: ReconcileParams) -> Finding | None:
        return check_displacement(tracks, features, (), params)

    for shift_m, check in (((80.0, 60.0, 0.0), check_far_positions), ((5.0, 20.0, 0.0), near)):
        found = check(tracks_at(zone @ turn.T + shift_m), features_at(SET_UP), PARAMS)
        assert (found is not None) == same
        assert found is None or (f"rotated by {degrees:+.1f}" in judge(found).detail.replace("-180", "+180"))
        assert found is None or "heading_deg of its georeference" in judge(found).detail


@pytest.mark.parametrize(
    ("places", "says"),
    [
        (ZONE + np.array((45.0, 0, -47.6)), "47.6 m lower than the nearest ones"),  # the next section, above the geoid
        (ZONE + np.array((45.0, 0, 12.0)), None),  # on a bridge
        (ZONE + np.array((200.0, 0, 47.6)), None),  # the road climbs
        (ZONE + np.array((45.0, 0, 0)), None),
    ],
)
def test_a_section_in_another_height_system_is_known_by_the_cones_before_it(places: Floats, says: str | None) -> None:
    found = check_far_positions(tracks_at(places), features_at(ZONE), PARAMS)
    assert (found and found.check) == (says and "heights of another section")
    assert found is None or str(says) in judge(found).detail
