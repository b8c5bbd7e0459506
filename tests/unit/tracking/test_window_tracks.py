"""Tracks of the last frame pairs of a drive against tracks of the whole drive."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

import numpy as np
import pytest

from conetl.model.detector_evidence import UNMEASURED
from conetl.model.drive import DriveRecords, Track
from conetl.model.params import IngestParams
from conetl.tracking import window_tracks
from conetl.tracking.tracks import drive_data, fuse_tracks
from conetl.tracking.window_tracks import ObservedPair, WindowTracks, add_pair
from tests.cases import cases
from tests.integration.drives_of_days import RIG, survey

PARAMS = IngestParams()
Members = Collection[tuple[int, int]]


def drive() -> DriveRecords:
    """A made-up drive past seven cones in a row, each observed in 23 frame pairs."""
    return survey(0, frames=60, start_m=-20.0)


def without(whole: DriveRecords, missing: Members) -> DriveRecords:
    """A drive without some matches, their boxes and positions."""
    matches = [m for m in whole.matches if (m.frame_index, m.match_index) not in missing]
    boxes = {(d.frame_index, d.side, d.detection_index) for m in matches for d in (m.left, m.right)}
    return whole._replace(
        detections=[d for d in whole.detections if (d.frame_index, d.side, d.detection_index) in boxes],
        matches=matches,
        positions=[p for p in whole.positions if (p.frame_index, p.match_index) not in missing],
    )


def pairs_of(whole: DriveRecords) -> list[ObservedPair]:
    """A drive, pair by pair."""
    found = whole.detections, whole.matches, whole.positions
    return [
        ObservedPair(pair, *([one for one in of_drive if one.frame_index == pair.frame_index] for of_drive in found))  # type: ignore[arg-type]
        for pair in whole.drive.frame_pairs
    ]


def steps(pairs: list[ObservedPair]) -> Iterator[tuple[WindowTracks, set[int]]]:
    """The tracks after every pair, and the numbers of those that it changed."""
    tracks = WindowTracks()
    for pair in pairs:
        tracks, changed = add_pair(tracks, pair, RIG, PARAMS, UNMEASURED)
        yield tracks, changed


def at_end(pairs: list[ObservedPair]) -> WindowTracks:
    return [tracks for tracks, _ in steps(pairs)][-1]


def nearest(track: Track, others: Iterable[Track]) -> tuple[int, float]:
    """Index of the nearest of some tracks, and its distance in m."""
    away = np.linalg.norm(np.array([t.xyz_m for t in others]) - track.xyz_m, axis=1)
    return int(away.argmin()), float(away.min())


@pytest.mark.parametrize("window", cases(window_tracks.WINDOW_PAIRS, release=[20]))
def test_the_tracks_are_those_of_the_whole_drive(window: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the first observations of a cone have left the window before the last ones: all but up to three that
    left it before there was a track."""
    monkeypatch.setattr(window_tracks, "WINDOW_PAIRS", window)
    whole = drive()
    tracks = at_end(pairs_of(whole))
    assert len(tracks.window) == window
    assert len(tracks.standing) == len(whole.tracks)
    assert max(track.observation_count for track in whole.tracks) > 15
    for track in tracks.standing.values():
        number, away_m = nearest(track, whole.tracks)
        assert away_m < 0.1
        wanted = whole.tracks[number]
        assert abs(track.observation_count - wanted.observation_count) <= 3
        assert 0 <= track.first_seen_ns - wanted.first_seen_ns <= 300_000_000
        assert track.last_seen_ns == wanted.last_seen_ns


def test_a_number_is_of_one_cone_while_the_window_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where every third of its observations is missing."""
    monkeypatch.setattr(window_tracks, "WINDOW_PAIRS", 12)
    whole = drive()
    cone_of: dict[int, set[int]] = {}
    for tracks, _ in steps(pairs_of(without(whole, [m for t in whole.tracks for m in t.members[1::3]]))):
        for number, track in tracks.standing.items():
            cone_of.setdefault(number, set()).add(nearest(track, whole.tracks)[0])
    assert [len(cones) for cones in cone_of.values()] == [1] * len(whole.tracks)
    assert len(set.union(*cone_of.values())) == len(whole.tracks)


def test_what_is_not_observed_stays_as_it_is() -> None:
    before = WindowTracks()
    for (tracks, changed), pair in zip(steps(pairs_of(drive())), drive().drive.frame_pairs, strict=True):
        observed_now = {n for n, t in tracks.standing.items() if t.last_seen_ns == pair.captured_at_ns}
        assert observed_now == changed
        assert all(tracks.standing[n] is before.standing[n] for n in tracks.standing.keys() - changed)
        before = tracks


@pytest.mark.parametrize(("window", "gap"), [(20, PARAMS.track.max_gap_frames + 2), (5, 6)])
def test_a_cone_seen_again_after_a_gap_is_the_same_one(window: int, gap: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A gap too long for one chain, within the window and longer than it."""
    monkeypatch.setattr(window_tracks, "WINDOW_PAIRS", window)
    whole = drive()
    hidden = range(54 - gap, 54)
    spanned = [t for t in whole.tracks if t.members[0][0] < hidden[0] and t.members[-1][0] > hidden[-1]]
    assert spanned
    tracks = at_end(pairs_of(without(whole, [m for t in whole.tracks for m in t.members if m[0] in hidden])))
    found = [*tracks.standing.values()]
    assert sorted(nearest(track, whole.tracks)[0] for track in found) == list(range(len(found)))
    for track in spanned:
        again = found[nearest(track, found)[0]]
        assert again.first_seen_ns < whole.drive.frame_pairs[hidden[0]].captured_at_ns
        assert again.last_seen_ns == track.last_seen_ns


def doubtful(whole: DriveRecords, track: Track, first: int) -> DriveRecords:
    """The same drive; a track is observed from its member `first` on only, with a good score three times, then weak ones."""
    score_of = dict(zip(track.members[first:], [0.9] * 3 + [0.2] * len(track.members), strict=False))
    matches = []
    for match in whole.matches:
        score = {"score": score_of.get((match.frame_index, match.match_index), match.left.score)}
        sides = {"left": match.left.model_copy(update=score), "right": match.right.model_copy(update=score)}
        matches.append(match.model_copy(update=sides))
    weak = whole._replace(matches=matches, detections=[d for m in matches for d in (m.left, m.right)])
    return without(weak, track.members[:first])


@pytest.mark.parametrize(("window", "is_taken_back"), [(20, True), (5, False)])
def test_a_track_that_is_not_found_any_more_is_taken_back(
    window: int, is_taken_back: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not where its first observations have left the window: what is left says nothing against them."""
    monkeypatch.setattr(window_tracks, "WINDOW_PAIRS", window)
    whole = drive()
    track = whole.tracks[3]
    stood, gone = [False], []
    for tracks, changed in steps(pairs_of(doubtful(whole, track, 11))):
        stood.append(bool(tracks.standing) and nearest(track, tracks.standing.values())[1] < 1.0)
        gone += changed - tracks.standing.keys()
    assert (True in stood, stood[-1], len(gone)) == (True, not is_taken_back, is_taken_back)


def test_objects_of_one_frame_are_those_of_all_frames() -> None:
    """Also their evidence: boxes of objects without a position in this frame are not theirs."""
    whole = drive()
    data = drive_data(whole.drive.frame_pairs, RIG, whole.detections, whole.matches, PARAMS)
    everything, _ = fuse_tracks(whole.positions, data)
    for frame in (15, 30, 45):
        found, _ = fuse_tracks(whole.positions, data, seen_in=frame)
        wanted = [t for t in everything if frame in dict(t.members)]
        assert 2 < len(found) < len(everything)
        assert [t.model_copy(update={"track_index": 0}) for t in found] == [
            t.model_copy(update={"track_index": 0}) for t in wanted
        ]
