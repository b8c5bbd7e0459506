"""Tracks frame by frame against tracks of the whole drive."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from conetl.model.detector_evidence import UNMEASURED
from conetl.model.drive import Track
from conetl.model.params import IngestParams
from conetl.tracking import live_tracks
from conetl.tracking.live_tracks import LiveFrame, LiveTracks, add_frame
from tests.integration.drives_of_days import RIG, survey

PARAMS = IngestParams()


def frames_of(day: int) -> tuple[list[LiveFrame], list[Track]]:
    """A made-up drive, frame by frame, and its tracks as the whole drive has them."""
    whole = survey(day)
    by_frame: dict[str, dict[int, list[object]]] = {
        n: defaultdict(list) for n in ("detections", "matches", "positions")
    }
    for name, found in by_frame.items():
        for record in getattr(whole, name):
            found[record.frame_index].append(record)
    frames = [
        LiveFrame(pair, *(tuple(by_frame[name][pair.frame_index]) for name in ("detections", "matches", "positions")))  # type: ignore[arg-type]
        for pair in whole.drive.frame_pairs
    ]
    return frames, whole.tracks


def run(frames: list[LiveFrame]) -> tuple[LiveTracks, dict[int, Track]]:
    tracks, standing = LiveTracks(), {}
    for frame in frames:
        tracks, changed = add_frame(tracks, frame, RIG, PARAMS, UNMEASURED)
        for number, found in changed.items():
            if isinstance(found, Track):
                standing[number] = found
            else:
                standing.pop(number, None)
    return tracks, standing


def test_the_cones_are_those_of_the_whole_drive() -> None:
    frames, wanted = frames_of(0)
    _, standing = run(frames)
    assert len(standing) == len(wanted)
    for track in wanted:
        away = {n: float(np.linalg.norm(np.subtract(t.xyz_m, track.xyz_m))) for n, t in standing.items()}
        number = min(away, key=lambda n: away[n])
        assert away[number] < 0.1
        # Of the whole drive, lone positions are joined afterwards, too.
        assert abs(standing[number].observation_count - track.observation_count) <= 2
        assert standing[number].last_seen_ns == track.last_seen_ns


def test_a_cone_keeps_its_number_and_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_tracks, "KEPT_FRAMES", 14)
    frames, wanted = frames_of(0)
    tracks, standing = run(frames)
    assert len(tracks.frames) == len(tracks.poses) == 14
    assert all(len(chain.members) <= 15 for chain in tracks.open_chains)
    assert len(standing) == len(wanted)
    assert set(standing) <= set(range(len(tracks.numbers)))


def test_a_cone_seen_again_after_a_gap_is_the_same_one() -> None:
    frames, _ = frames_of(0)
    gap = PARAMS.track.max_gap_frames + 2
    hidden = [LiveFrame(f.pair, (), (), ()) if 12 <= i < 12 + gap else f for i, f in enumerate(frames)]
    _, standing = run(hidden)
    places = np.array([track.xyz_m[:2] for track in standing.values()])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 100 * np.eye(len(places))
    assert apart.min() > 1.0  # none twice


def backwards(frames: list[LiveFrame]) -> list[LiveFrame]:
    """The same drive with the car in reverse."""
    turned = []
    for now, then in zip(frames, reversed(frames), strict=True):
        at = {"frame_index": now.pair.frame_index}
        boxes = tuple(d.model_copy(update=at) for d in then.detections)
        matches = tuple(
            m.model_copy(update=at | {"left": m.left.model_copy(update=at), "right": m.right.model_copy(update=at)})
            for m in then.matches
        )
        pair = then.pair.model_copy(update=at | {"captured_at_ns": now.pair.captured_at_ns})
        turned.append(LiveFrame(pair, boxes, matches, tuple(p.model_copy(update=at) for p in then.positions)))
    return turned


def test_boxes_of_its_own_are_never_anothers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chain is adjusted by its nearest positions only, here the first ones; its other boxes are its own all the same."""
    frames = backwards(frames_of(0)[0])
    _, standing = run(frames)
    assert max(track.observation_count for track in standing.values()) > live_tracks._MOST_MEMBERS
    monkeypatch.setattr(live_tracks, "boxes_in_use", lambda *_: set())
    _, undisputed = run(frames)
    assert {n: t.existence_probability for n, t in standing.items()} == {
        n: t.existence_probability for n, t in undisputed.items()
    }


def test_frames_must_come_in_order() -> None:
    frames, _ = frames_of(0)
    tracks, _ = add_frame(LiveTracks(), frames[3], RIG, PARAMS, UNMEASURED)
    with pytest.raises(ValueError, match="rising"):
        add_frame(tracks, frames[2], RIG, PARAMS, UNMEASURED)
