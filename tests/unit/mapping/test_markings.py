"""Lane markings of drives against those of the map: what is confirmed, added, moved, removed and split, and with what sigmas."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.packing import cov_matrix
from conetl.mapping.history import DriveEvidence, MapHistory, replay_drives
from conetl.mapping.marking_deltas import STRETCH_M
from conetl.mapping.visibility import MarkingView, empty_view
from conetl.model.map_records import Decisions, Delta, Location, MapFeature
from conetl.model.markings import MarkingTrack
from tests.synthetic.painted_road import Paint, painted_drive
from tests.synthetic.world import ORIGIN_M

EDGE, CENTRE, LEFT, YELLOW = Paint(4.5), Paint(1.5, pattern="dashed"), Paint(-2.0), Paint(-4.0, colour="yellow")
ROAD = (EDGE, CENTRE, LEFT, YELLOW)


def drives_of(days: Sequence[Sequence[Paint]], seed: int = 3, **options) -> list[DriveEvidence]:
    rng = np.random.default_rng(seed)
    return [painted_drive(paints, rng, day, day=day, **options) for day, paints in enumerate(days)]


def deltas_of(history: MapHistory, drive: DriveEvidence) -> list[Delta]:
    return history.updates[drive.changeset_id].deltas


def kinds_of(history: MapHistory, drive: DriveEvidence) -> dict[str, int]:
    return dict(Counter(delta.kind.value for delta in deltas_of(history, drive)))


def aside_m(feature: MapFeature) -> float:
    return feature.xyz_m[1] - float(ORIGIN_M[1])


def standing(history: MapHistory) -> list[MapFeature]:
    return [chain[-1].feature for chain in history.chains.values() if chain[-1].present]


def test_a_first_drive_founds_rows_of_stretches_and_the_next_ones_confirm_them() -> None:
    drives = drives_of([ROAD] * 3)
    history = replay_drives(drives)
    first = deltas_of(history, drives[0])
    assert [kinds_of(history, drive) for drive in drives[1:]] == [{"confirmed": len(first)}] * 2
    for track in drives[0].markings:
        ends = [track.marking.vertices_m[0], track.marking.vertices_m[-1]]
        row = sorted(d.new.marking.vertices_m for d in first if d.new.marking.vertices_m[0] in track.marking.vertices_m)
        assert [row[0][0], row[-1][-1]] == ends
        assert all(a[-1] == b[0] for a, b in pairwise(row)), "one stretch goes on where the other ends"
        assert all(np.hypot(*np.subtract(one[-1], one[0])[:2]) <= STRETCH_M + 1e-6 for one in row)
        assert all(len(one) > 2 for one in row)
    for feature in standing(history):
        shape = feature.marking
        assert feature.version == 3 and feature.observation_count >= 15
        assert (feature.xyz_m, feature.cov_m2) == (
            shape.vertices_m[len(shape.vertices_m) // 2],
            shape.cov_m2[len(shape.cov_m2) // 2],
        )
        assert min(abs(aside_m(feature) - paint.aside_m) for paint in ROAD) < 0.2
        assert (shape.pattern == "dashed") == (abs(aside_m(feature) - CENTRE.aside_m) < 0.2)
        assert shape.width_sigma_m == pytest.approx(0.01 / np.sqrt(3))


def test_where_half_of_a_stretch_is_gone_the_rest_is_split_off() -> None:
    gap = (Paint(1.5, (-1e9, 43.0)), Paint(1.5, (61.0, 1e9)))
    drives = drives_of([ROAD, (EDGE, LEFT, YELLOW, *gap), (EDGE, LEFT, YELLOW, *gap)])
    history = replay_drives(drives)
    kinds = kinds_of(history, drives[1])
    assert kinds["removed"] >= 2 and set(kinds) <= {"removed", "split", "confirmed"}
    assert set(kinds_of(history, drives[2])) == {"confirmed"}, "nothing flickers"
    own = [f.marking.vertices_m for f in standing(history) if abs(aside_m(f) - 1.5) < 0.2]
    covered = [(one[0][0] - ORIGIN_M[0], one[-1][0] - ORIGIN_M[0]) for one in own]
    assert not any(begin < 56.0 and end > 48.0 for begin, end in covered), "the middle of the gap is free"
    assert max(end for begin, end in covered if begin < 43.0) > 38.0
    assert min(begin for begin, end in covered if end > 61.0) < 66.0
    [split] = [delta for delta in deltas_of(history, drives[1]) if delta.kind == "split"] or [None]
    if split is not None:
        assert split.other_feature_id in {d.feature_id for d in deltas_of(history, drives[1]) if d.kind == "removed"}


def test_drives_that_show_no_line_at_all_remove_nothing_before_a_person_looks() -> None:
    """As behind a smeared lens: the first ones miss the lines, and the one that would remove them waits."""
    drives = drives_of([ROAD, *[()] * 4])
    history = replay_drives(drives)
    assert set(kinds_of(history, drives[1])) == {"missed"}
    assert len(standing(history)) == len(standing(replay_drives(drives[:1])))
    holds = {d.changeset_id: hold.detail for d in drives if (hold := history.updates[d.changeset_id].hold) is not None}
    assert holds and all("a lens was smeared" in detail for detail in holds.values())
    assert not standing(replay_drives(drives, Decisions(accepted=frozenset(holds))))
    glimpse = replace(drives[1], check_view=lambda v, seen=drives[1].check_view: few_frames(seen(v)))
    assert kinds_of(replay_drives([drives[0], glimpse]), glimpse) == {}
    blind = replace(drives[1], check_view=empty_view)
    assert kinds_of(replay_drives([drives[0], blind]), blind) == {}, "a drive that did not search says nothing"


def test_blurred_images_show_absence_at_a_shorter_range_only() -> None:
    for blur_px, kind in ((0.9, "removed"), (1.5, "removed"), (2.5, None)):
        first, second = drives_of([ROAD, (EDGE, CENTRE, LEFT)], blur_px=blur_px)
        gone = {delta.kind.value for delta in deltas_of(replay_drives([first, second]), second)} - {"confirmed"}
        assert gone == ({kind} if kind else set()), blur_px


def few_frames(view: MarkingView) -> MarkingView:
    return MarkingView(view.captured_at_ns[::5], view.in_view[:, ::5])


def test_a_stretch_that_one_frame_pair_showed_is_not_as_sure_as_its_line() -> None:
    """It is added by the next drive, which shows it more often; one that is already on the map gains nothing by it."""
    first, second = drives_of([ROAD] * 2)

    def seldom(drive: DriveEvidence) -> DriveEvidence:
        def check_view(vertices_m: NDArray[np.float64]) -> MarkingView:
            view = drive.check_view(vertices_m)
            if vertices_m[:, 0].mean() < ORIGIN_M[0] + 70.0:
                return view
            once = np.flatnonzero(view.in_view.any(axis=0))[:1]
            return MarkingView(view.captured_at_ns[once], view.in_view[:, once])

        return replace(drive, check_view=check_view)

    def beyond(history: MapHistory, drive: DriveEvidence) -> list[Delta]:
        return [d for d in deltas_of(history, drive) if d.state_after.xyz_m[0] > ORIGIN_M[0] + 75.0]

    whole = replay_drives([first, second])
    cut = replay_drives([seldom(first), second])
    assert len(beyond(whole, first)) >= 4 * len(ROAD) / 2 and not beyond(cut, first)
    assert {delta.kind.value for delta in beyond(cut, second)} == {"added"}
    seldom_later = seldom(second)
    later = replay_drives([first, seldom_later])
    seen_once = [d for d in beyond(later, seldom_later) if d.evidence is not None and d.evidence.frames_seen == 1]
    assert seen_once and all(d.evidence.log_likelihood_ratio == pytest.approx(0.0, abs=1e-9) for d in seen_once)


def test_decisions_hold_for_stretches() -> None:
    drives = drives_of([ROAD, (EDGE, LEFT, YELLOW), (EDGE, LEFT, YELLOW)])
    first = [delta.new for delta in deltas_of(replay_drives(drives[:1]), drives[0])]
    gone = [feature for feature in first if abs(aside_m(feature) - 1.5) < 0.2]
    place = Location(xy_m=gone[0].xyz_m[:2], radius_m=0.3, of_line=True)
    pinned = replay_drives(drives, Decisions(pinned=(place,)))
    assert {f.feature_id for f in standing(pinned)} == {f.feature_id for f in first} - {f.feature_id for f in gone[1:]}
    there = next(feature for feature in first if abs(aside_m(feature) - 4.5) < 0.2)
    of_cone = Location(xy_m=there.xyz_m[:2], radius_m=0.3)
    assert not any(
        chain[-1].suppressed for chain in replay_drives(drives, Decisions(suppressed=(of_cone,))).chains.values()
    )
    suppressed = replay_drives(drives, Decisions(suppressed=(of_cone.model_copy(update={"of_line": True}),)))
    assert [key for key, chain in suppressed.chains.items() if chain[-1].suppressed] == [there.feature_id]


@pytest.mark.parametrize("sigma_m", [0.05, 0.4])
def test_an_offset_of_the_drive_moves_no_marking(sigma_m: float) -> None:
    for seed in range(4):
        drives = drives_of([ROAD] * 3, seed, sigma_m=sigma_m)
        assert [set(kinds_of(replay_drives(drives), drive)) for drive in drives[1:]] == [{"confirmed"}] * 2


def test_a_drive_that_moves_most_of_what_it_shows_is_left_to_a_person() -> None:
    aside = [replace(paint, aside_m=paint.aside_m + 0.5) for paint in ROAD]
    drives = drives_of([ROAD, aside], sigma_m=0.02)
    held = replay_drives(drives).updates[drives[1].changeset_id]
    assert held.hold is not None and "stretches" in held.hold.detail and not held.deltas
    accepted = replay_drives(drives, Decisions(accepted=frozenset({drives[1].changeset_id})))
    assert set(kinds_of(accepted, drives[1])) == {"moved"}


@pytest.mark.parametrize(
    ("shift_m", "what"),
    [
        ((0.0, 0.0, 48.0), "heights"),
        ((0.0, 0.0, -1.0), "heights"),
        ((0.0, 0.0, 0.25), "heights"),
        ((0.0, 0.2, 0.0), "position"),
        ((0.0, 1.3, 0.0), "replaced"),
    ],
)
def test_a_displaced_drive_without_cones_is_left_to_a_person(shift_m: tuple[float, ...], what: str) -> None:
    paints = (Paint(4.5), Paint(0.5), Paint(-4.0))
    drives = drives_of([paints] * 2, sigma_m=0.01)
    second = replace(
        drives[1], markings=[displaced(track, shift_m) for track in drives[1].markings],
    )  # fmt: skip
    history = replay_drives([drives[0], second])
    hold = history.updates[second.changeset_id].hold
    assert hold is not None and hold.name.endswith(what) and not deltas_of(history, second)
    accepted = replay_drives([drives[0], second], Decisions(accepted={second.changeset_id}))
    assert accepted.updates[second.changeset_id].hold is None and deltas_of(accepted, second)


def displaced(track: MarkingTrack, shift_m: tuple[float, ...]) -> MarkingTrack:
    vertices_m = tuple(tuple(np.add(vertex, shift_m).tolist()) for vertex in track.marking.vertices_m)
    return track.model_copy(update={"marking": track.marking.model_copy(update={"vertices_m": vertices_m})})


def test_markings_of_a_double_line_stay_two() -> None:
    double = (EDGE, Paint(0.14), Paint(-0.14, colour="yellow"), YELLOW)
    drives = drives_of([double] * 3)
    history = replay_drives(drives)
    assert [set(kinds_of(history, drive)) for drive in drives[1:]] == [{"confirmed"}] * 2
    rows = Counter((f.marking.colour, round(aside_m(f), 1)) for f in standing(history) if abs(aside_m(f)) < 0.4)
    assert {colour for colour, _ in rows} == {"white", "yellow"}
    assert all((aside > 0) == (colour == "white") for colour, aside in rows)


def test_the_opposite_direction_confirms_and_the_newest_attributes_hold() -> None:
    drives = drives_of([ROAD, (replace(EDGE, colour="yellow", width_m=0.16), CENTRE, LEFT, YELLOW)])
    back = [
        track.model_copy(
            update={
                "marking": track.marking.model_copy(update={"vertices_m": track.marking.vertices_m[::-1]}),
            }
        )
        for track in drives[1].markings
    ]
    history = replay_drives([drives[0], replace(drives[1], markings=back)])
    assert set(kinds_of(history, drives[1])) == {"confirmed"}
    edge = [f for f in standing(history) if abs(aside_m(f) - 4.5) < 0.2]
    assert {f.marking.colour for f in edge} == {"yellow"}
    assert all(f.marking.width_m == pytest.approx(0.14) for f in edge)
    assert all(f.marking.vertices_m[0][0] < f.marking.vertices_m[-1][0] for f in edge)


def test_sigmas_of_fused_vertices_are_those_of_their_errors() -> None:
    """Normalised estimation error squared, across the line and in height, of maps of four drives each: 1 on average."""
    values = []
    for seed in range(12):
        history = replay_drives(drives_of([(EDGE, CENTRE, LEFT)] * 4, seed))
        for feature in standing(history):
            aside = min((4.5, 1.5, -2.0), key=lambda one: abs(aside_m(feature) - one))
            for vertex, cov in zip(feature.marking.vertices_m, feature.marking.cov_m2, strict=True):
                error = np.subtract(vertex, ORIGIN_M)[1:] - (aside, 0.0)
                values.append(error @ np.linalg.solve(cov_matrix(cov)[1:, 1:], error) / 2)
    assert 0.6 < np.mean(values) < 1.5
