"""A road whose cones are set up, moved and taken away from day to day, driven three times a day: truth for the changes.

Boxes are drawn from what was measured of the shipped detector, P(detect | apparent height, hidden share); misses of one cone in
one drive go together (a common factor), nearer cones hide farther ones, some cones get a second box beside them, the first drive
of a day often covers a part of the road only, and every drive has a GNSS offset of its own. The rest is the real thing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from uuid import UUID

import numpy as np
from scipy.optimize import linear_sum_assignment

from conetl.mapping.history import DriveEvidence, MapUpdate, apply_drive
from conetl.mapping.visibility import DriveObservations, check_visibility, observations_of_drive, pairs_in_view
from conetl.model.detector_evidence import AbsenceFigures, DetectorEvidence, detect_probability
from conetl.model.drive import Detection, FramePair
from conetl.model.map_records import Decisions, Delta, DeltaKind, FeatureVersion, MapFeature
from conetl.model.params import IngestParams, ReconcileParams
from conetl.model.rig import Side
from conetl.tracking.matching.apparent_boxes import hidden_share
from tests import records
from tests.synthetic.world import (
    ORIGIN_M,
    START_NS,
    Cone,
    apparent_box,
    evidence_of,
    fuse_logged,
    locate,
    make_path,
    make_rig,
    shifted,
)  # fmt: skip

DAY_NS, HOUR_NS = 86_400_000_000_000, 3_600_000_000_000
RIG = make_rig()
FRAMES, DRIVES_A_DAY = 44, 3
LENGTH_M = (12.0, 50.0)
MISS_CORRELATION = 0.5
"""Share of the common factor of one cone and one drive in whether a look misses it."""
DOUBLED = 0.03
"""Cones that get a second box in a drive."""
WELL_SEEN_FRAMES = 10
HIDDEN = " (hidden)"
Boxes = dict[tuple[int, Side], list[Detection]]
Location = tuple[float, float]


@dataclass
class Road:
    """Cones by number: place (east, north; m) and height, as they stand."""

    places: dict[int, Location] = field(default_factory=dict)
    heights: dict[int, float] = field(default_factory=dict)
    before: dict[int, Location] = field(default_factory=dict)
    """Places of yesterday."""
    next_number: int = 0

    def put(self, place: Location, height_m: float) -> int:
        number, self.next_number = self.next_number, self.next_number + 1
        self.places[number], self.heights[number] = place, height_m
        return number

    def is_free(self, place: Location, apart_m: float) -> bool:
        return all(np.hypot(place[0] - x, place[1] - y) >= apart_m for x, y in self.places.values())

    def cones(self) -> list[Cone]:
        return [
            Cone((x, y, 0.0), height_m=self.heights[n], base_m=0.55 * self.heights[n])
            for n, (x, y) in self.places.items()
        ]


@dataclass
class Score:
    """What the map made of what happened."""

    confusion: Counter[tuple[str, str]] = field(default_factory=Counter)
    """(what happened, what the map says after the day's drives) of cones; 'nothing' happened to what is not a cone. 'hidden':
    no drive of the day had the place from which the cone went in plain view in `WELL_SEEN_FRAMES` frame pairs."""
    removed_well_seen: int = 0
    """Cones taken away whose spot the day's first drive had in view in `WELL_SEEN_FRAMES` frame pairs and more."""
    removed_at_once: int = 0
    """Those of them that it removed."""
    unseen_removed: int = 0
    """Features of standing cones that a drive removed or moved without having had the spot in view."""

    wrong: list[str] = field(default_factory=list)
    held: list[str] = field(default_factory=list)
    """Drives that were held against the map; all of them are good."""

    @property
    def f1(self) -> float:
        changes = ("added", "moved", "removed")
        right = sum(self.confusion[kind, kind] for kind in changes)
        seen = {key: count for key, count in self.confusion.items() if "hidden" not in key[0]}
        happened = sum(count for (truth, _), count in seen.items() if truth in changes)
        told = sum(count for (_, said), count in seen.items() if said in changes)
        return 2 * right / (happened + told)

    @property
    def deleted_recall(self) -> float:
        return self.removed_at_once / self.removed_well_seen


def random_road(rng: np.random.Generator) -> Road:
    """A taper, a chain of near cones, and some more."""
    road = Road()
    at = LENGTH_M[0]
    for k in range(7):
        road.put((at + float(rng.normal(0, 0.2)), 3.4 - 0.15 * k), 0.7)
        at += 5.5
    at = float(rng.uniform(18.0, 40.0))
    for _ in range(3):
        road.put((at, -4.5), 0.5)
        at += float(rng.uniform(0.6, 1.6))
    return road


def change(road: Road, rng: np.random.Generator) -> dict[int, str]:
    """One night's changes; what happened to each cone that stands or stood."""
    fate = dict.fromkeys(road.places, "confirmed")
    numbers = list(road.places)
    rng.shuffle(numbers)
    if len(numbers) > 7 and rng.random() < 0.7:
        gone = numbers.pop()
        fate[gone] = "removed"
        del road.places[gone]
    if rng.random() < 0.6:
        moved = numbers.pop()
        x, y = road.places.pop(moved)
        for _ in range(100):
            place = (x + float(rng.uniform(-2.0, 2.0)), y + float(rng.uniform(-1.2, 1.2)))
            far_enough = 0.9 <= np.hypot(place[0] - x, place[1] - y) <= 2.4
            if far_enough and road.is_free(place, 0.8) and fate_is_clear(place, road, fate):
                fate[moved] = "moved"
                break
        road.places[moved] = place if fate[moved] == "moved" else (x, y)
    if len(road.places) < 12 and rng.random() < 0.8:
        for _ in range(100):
            place = (float(rng.uniform(*LENGTH_M)), float(rng.choice([-4.5, 3.0])) + float(rng.normal(0, 0.4)))
            if road.is_free(place, 0.8) and fate_is_clear(place, road, fate):
                fate[road.put(place, float(rng.choice([0.5, 0.7])))] = "added"
                break
    return fate


def fate_is_clear(place: Location, road: Road, fate: dict[int, str]) -> bool:
    """Whether no other cone that went last night stood so near that it could be this one: nothing tells these apart."""
    return all(
        np.hypot(place[0] - road.before[n][0], place[1] - road.before[n][1]) > 4.0
        for n, kind in fate.items()
        if kind in ("removed", "moved")
    )


def drive_boxes(
    cones: Sequence[Cone], pairs: Sequence[FramePair], figures: AbsenceFigures, rng: np.random.Generator
) -> Boxes:
    """What the detector gives."""
    luck = rng.normal(size=len(cones))
    doubled = rng.random(len(cones)) < DOUBLED
    share, normal = MISS_CORRELATION, NormalDist()
    found: Boxes = {}
    for pair in pairs:
        for side in ("left", "right"):
            boxes = [apparent_box(cone, pair, RIG, side) for cone in cones]
            seen: list[tuple[float, float, float, float]] = []
            for i, box in enumerate(boxes):
                if box is None:
                    continue
                hidden = max(
                    (_covered(box, other) for other in boxes if other is not None and other is not box), default=0
                )
                if hidden > figures.evidence.hidden_most:
                    continue
                chance = detect_probability(figures.evidence, box[3], hidden, figures.score_threshold)
                draw = share**0.5 * luck[i] + (1 - share) ** 0.5 * rng.normal()
                if normal.cdf(draw) >= chance:
                    continue
                seen.append(box)
                if doubled[i] and pair.frame_index % 2:
                    seen.append((box[0] + 0.8 * box[2], box[1], box[2], box[3]))
            found[pair.frame_index, side] = [
                _detection(pair.frame_index, side, index, box, rng) for index, box in enumerate(seen)
            ]
    return found


def _covered(box: tuple[float, ...], other: tuple[float, ...]) -> float:
    """Share of a box behind another one, 0 where the other stands farther."""
    x, y, w, h = box
    u, v, a, b = other
    if v + b <= y + h + 0.1 * h:
        return 0.0
    return max(min(x + w, u + a) - max(x, u), 0.0) * max(min(y + h, v + b) - max(y, v), 0.0) / (w * h)


def _detection(
    frame: int, side: Side, index: int, box: tuple[float, float, float, float], rng: np.random.Generator
) -> Detection:
    x, y, w, h = box
    left, top, right, bottom = np.array([x, y, x + w, y + h]) + rng.normal(0, 0.5, 4)
    return records.box(left, top, right - left, bottom - top, frame=frame, side=side, index=index, score=0.8)


def survey(
    road: Road, evidence: DetectorEvidence, rng: np.random.Generator, *, start_ns: int, span: tuple[int, int]
) -> tuple[DriveEvidence, DriveObservations]:
    """One drive, ready for the replay_drives, and where it truly looked (without its GNSS offset)."""
    params = IngestParams()
    figures = AbsenceFigures(evidence=evidence, score_threshold=params.detection.score_threshold)
    true = make_path(FRAMES, first_ns=start_ns, sigma_m=0.3)[slice(*span)]
    offset = (*rng.normal(0, 0.2, 2).tolist(), 0.0)
    logged = [shifted(pair, offset) for pair in true]
    boxes = drive_boxes(road.cones(), true, figures, rng)
    found, matches, positions = locate(boxes, logged, RIG)
    tracks, _ = fuse_logged(logged, RIG, found, matches, positions, params=params, evidence=evidence)
    view = observations_of_drive(RIG, logged, found, [(p.frame_index, p.category, p.xyz_m) for p in positions], figures)
    drive = evidence_of(
        f"{start_ns}", start_ns, tracks, np.array([pair.pose.map_t_body_m[:2] for pair in logged]),
        check_visibility=lambda f, offset_m, others_m: check_visibility(f, offset_m, others_m, view, params.reconcile),
    )  # fmt: skip
    return drive, observations_of_drive(RIG, true, found, [], figures)


def simulate(days: int, evidence: DetectorEvidence, *, seed: int = 5) -> Score:
    """Drive a changing road for so many days, three times each, and score the map."""
    rng = np.random.default_rng(seed)
    road, score = random_road(rng), Score()
    standing: dict[UUID, FeatureVersion] = {}
    for day in range(days + 1):
        before, known = dict(road.places), owners(standing, road.places)
        road.before = before
        fate = change(road, rng) if day else dict.fromkeys(road.places, "added")
        started, most_plain, happened = set(standing), dict[int, int](), list[tuple[int, Delta]]()
        for number in range(DRIVES_A_DAY):
            span = (0, FRAMES)
            if number == 0 and day and rng.random() < 0.5:  # a part of the road
                span = (0, FRAMES // 2) if rng.random() < 0.5 else (FRAMES // 2, FRAMES)
            start_ns = START_NS + day * DAY_NS + number * HOUR_NS
            drive, view = survey(road, evidence, rng, start_ns=start_ns, span=span)
            extension = apply_drive(standing, drive, Decisions())
            if extension.hold is not None:
                score.held.append(f"seed {seed}, day {day}, drive {number + 1}: {extension.hold.detail}")
            happened += [(number + 1, delta) for delta in extension.deltas]
            gone = {d.feature_id for d in extension.deltas if d.kind in (DeltaKind.REMOVED, DeltaKind.MOVED)}
            for cone, feature_id in known.items() if day else ():
                frames, plain = in_view(before[cone], road.heights[cone], view, drive.params)
                most_plain[cone] = max(most_plain.get(cone, 0), plain)
                if feature_id in gone and frames == 0:
                    score.unseen_removed += 1
                if number == 0 and fate[cone] == "removed" and plain >= WELL_SEEN_FRAMES:
                    score.removed_well_seen += 1
                    score.removed_at_once += feature_id in gone
            take(extension, standing)
        for cone in fate:
            if fate[cone] in ("removed", "moved") and most_plain.get(cone, 0) < WELL_SEEN_FRAMES:
                fate[cone] += HIDDEN
        if day:
            wrong, made_up = count(score, fate, known, owners(standing, road.places), started, set(standing))
            lines = [(line, [at[cone] for at in (before, road.places) if cone in at]) for cone, line in wrong.items()]
            made_up_at = [np.array(standing[feature_id].feature.xyz_m) - ORIGIN_M for feature_id in made_up]
            lines += [("no cone at all", [(float(x), float(y))]) for x, y, _ in made_up_at]
            score.wrong += [f"seed {seed}, day {day}, {line}:{_deltas_near(at, happened)}" for line, at in lines]
    return score


def take(extension: MapUpdate, standing: dict[UUID, FeatureVersion]) -> None:
    """Bring the map up to what a drive made of it."""
    for version in extension.versions:
        standing.pop(version.feature.feature_id, None)
        if version.present:
            standing[version.feature.feature_id] = version


def _deltas_near(places: Sequence[Location], happened: Sequence[tuple[int, Delta]]) -> str:
    """What the day's drives did within reach of some places, for whoever wants to know why."""
    told = []
    for number, delta in happened:
        x, y, _ = np.array(delta.state_after.xyz_m) - ORIGIN_M
        if any(np.hypot(x - a, y - b) < 3.0 for a, b in places):
            existence = "" if delta.evidence is None else f", existence {delta.evidence.existence_probability:.2f}"
            told.append(f"drive {number} {delta.kind} {str(delta.feature_id)[:4]} at ({x:.1f}, {y:.1f}){existence}")
    return "".join(f"\n    {line}" for line in told)


def in_view(place: Location, height_m: float, view: DriveObservations, params: ReconcileParams) -> tuple[int, int]:
    """Frame pairs that had a place in view, and those of them in which no cone in front hid more than an eighth of it."""
    rows, _, boxes = pairs_in_view(ORIGIN_M + np.array([*place, 0.0]), height_m, view, params)
    plain = 0
    for row, pair in zip(rows, boxes, strict=True):
        found = view.detections.get(view.frames[row], ())
        sides = zip(("left", "right"), pair, strict=True)
        plain += all(hidden_share(box, [d for d in found if d.side == side]) < 0.125 for side, box in sides)
    return len(rows), plain


def owners(standing: dict[UUID, FeatureVersion], places: dict[int, Location]) -> dict[int, UUID]:
    """Cone -> the feature that is it, at most 0.5 m off after the map's own offset is taken out."""
    if not standing or not places:
        return {}
    features: list[MapFeature] = [version.feature for version in standing.values()]
    found = np.array([f.xyz_m[:2] for f in features]) - ORIGIN_M[:2]
    true = np.array(list(places.values()))
    apart = found[None] - true[:, None]
    nearest = apart[np.arange(len(true)), np.hypot(*np.moveaxis(apart, 2, 0)).argmin(axis=1)]
    distance = np.hypot(*np.moveaxis(apart - np.median(nearest, axis=0), 2, 0))
    rows, columns = linear_sum_assignment(np.where(distance <= 0.5, distance, 1e6))
    numbers = list(places)
    return {numbers[r]: features[c].feature_id for r, c in zip(rows, columns, strict=True) if distance[r, c] <= 0.5}


def count(
    score: Score,
    fate: dict[int, str],
    known: dict[int, UUID],
    now: dict[int, UUID],
    started: set[UUID],
    ended: set[UUID],
) -> tuple[dict[int, str], set[UUID]]:
    """Add one day to the confusion matrix; what is said wrongly of which cones, and features that are no cone."""
    told: set[UUID] = set()
    wrong: dict[int, str] = {}
    for cone, kind in fate.items():
        old, new = known.get(cone), now.get(cone)
        if kind.startswith("removed"):
            said = "not on the map" if old is None else "confirmed" if old in ended else "removed"
        elif new is None:
            said = "removed" if kind == "confirmed" and old is not None else "not on the map"
        elif kind.startswith("moved") and old == new:
            said = "moved"
        else:
            said = "confirmed" if new in started else "added"
        score.confusion[kind, said] += 1
        if kind.removesuffix(HIDDEN) != said:
            wrong[cone] = f"cone {cone}: {kind}, the map says {said}"
        told |= {feature for feature in (old, new) if feature is not None}
    made_up = ended - started - told
    score.confusion["nothing", "added"] += len(made_up)
    return wrong, made_up
