"""The reason for a change of a feature by a drive, in one sentence: the same in the web view, reports and `conetl map log`."""

from __future__ import annotations

from typing import NamedTuple
from uuid import UUID

from conetl.model.map_records import DeltaKind


class ChangeFacts(NamedTuple):
    """What the database stores about one change of a feature by a drive or an imported map."""

    kind: DeltaKind
    drive_id: str
    """Of an imported map, its name."""
    existence_probability: float
    """After the change."""
    is_import: bool = False
    frames_seen: int | None = None
    """Frame pairs in which a cone was observed there; None where that was not stored."""
    frames_empty: int | None = None
    """Frame pairs in which the position was visible and empty."""
    range_m: tuple[float, float] | None = None
    """Nearest and farthest distance from the camera in these frame pairs."""
    shift_m: float | None = None
    sigma_m: float | None = None
    """Along the major axis of the horizontal error ellipse, after the change."""
    object_height_m: float | None = None
    """After the change."""
    other_feature_id: UUID | None = None
    """Of a split, the feature that was both; of a merger, the one that remains."""
    noun: str = "cone"


def explain_change(facts: ChangeFacts) -> str:
    """One sentence: what happened, by which drive, what it observed from where, the existence probability after it, and
    the largest horizontal sigma."""
    if facts.is_import:
        observed = f"the imported map {facts.drive_id} states it"
    elif facts.kind in (DeltaKind.REMOVED, DeltaKind.MISSED):
        observed = _absence(facts)
    elif facts.kind is DeltaKind.MERGED:
        observed = (
            f"drive {facts.drive_id} observed one {facts.noun} where the map had two{_other(facts, '; {} remains')}"
        )
    else:
        observed = (
            f"drive {facts.drive_id} observed it{_frames(facts.frames_seen)}{_range(facts)}{_what_changed(facts)}"
        )
    end = f"sure it stands: {sure_text(facts.existence_probability)}"
    if facts.sigma_m is not None and not (facts.kind.ends or facts.kind is DeltaKind.MISSED):
        end += f", accuracy ±{length_text(facts.sigma_m)}"
    if facts.kind is DeltaKind.MISSED:
        end += ", it stays on the map"
    head = "not observed" if facts.kind is DeltaKind.MISSED else facts.kind.replace("_", " ")
    return f"{head.capitalize()}: {observed}; {end}."


def _absence(facts: ChangeFacts) -> str:
    seen, empty = facts.frames_seen or 0, facts.frames_empty
    passed = f"drive {facts.drive_id} passed{_range(facts)}, "
    if not empty:
        return f"{passed}the position was visible, no {facts.noun} was observed"
    it = f"{_article(facts.noun)} {facts.noun}"
    shown = f"none showed {it}" if not seen else f"{seen} of them showed {it}"
    return f"{passed}the position was visible{_frames(seen + empty)}, {shown}"


def _what_changed(facts: ChangeFacts) -> str:
    if facts.kind is DeltaKind.MOVED and facts.shift_m is not None:
        return f", {facts.shift_m:.2f} m from its earlier position"
    if facts.kind is DeltaKind.HEIGHT_CHANGED and facts.object_height_m is not None:
        return f", as {_article(facts.noun)} {facts.noun} {facts.object_height_m:.2f} m high"
    if facts.kind is DeltaKind.SPLIT:
        return _other(facts, f", as a second {facts.noun} beside {{}}")
    return ""


def _other(facts: ChangeFacts, text: str) -> str:
    return "" if facts.other_feature_id is None else text.format(str(facts.other_feature_id)[:8])


def _frames(count: int | None) -> str:
    return "" if not count else f" in {count} frame pair{'' if count == 1 else 's'}"


def _range(facts: ChangeFacts) -> str:
    if facts.range_m is None:
        return ""
    near, far = (f"{metres:.0f}" for metres in facts.range_m)
    return f" at {near} m" if near == far else f" at {near}\u2013{far} m"


def _article(noun: str) -> str:
    return "an" if noun[0] in "aeiou" else "a"


def sure_text(probability: float) -> str:
    """The existence probability in words for everybody; never certainty. The same in web/src/dom.ts."""
    return "<1 %" if probability < 0.005 else ">99 %" if probability >= 0.995 else f"{100 * probability:.0f} %"


def length_text(metres: float) -> str:
    """A sigma in the unit in which people say it; the same in web/src/dom.ts."""
    if metres < 0.0095:
        return f"{1000 * metres:.0f} mm"
    return f"{100 * metres:.0f} cm" if metres < 0.995 else f"{metres:.1f} m"


def probability_text(value: float) -> str:
    """Three decimals that never read as certainty; the same in web/src/dom.ts."""
    return "<0.001" if value < 0.0005 else ">0.999" if value >= 0.9995 else f"{value:.3f}"
