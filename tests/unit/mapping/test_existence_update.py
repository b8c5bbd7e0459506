"""Stored evidence of a feature after a drive that observed it, missed it, or ended it."""

from __future__ import annotations

from math import exp

import pytest

from conetl.mapping.existence_update import confirmation_evidence, ended, miss_evidence, missed, observed
from conetl.mapping.visibility import NotObserved
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from tests import records

ABSENT = records.ABSENT
TWICE = records.feature(version=3, existence_probability=0.9, seen_count=4, missed_count=2)


def evidence_of(feature: MapFeature) -> tuple[int, int, int | None]:
    return feature.seen_count, feature.missed_count, feature.first_missed_ns


@pytest.mark.parametrize(("frames", "seen"), [(3, 1), (0, 0)], ids=["a drive", "an imported map"])
@pytest.mark.parametrize("feature", [None, TWICE, missed(TWICE, 0.6, 5)], ids=["new", "known", "missed"])
def test_only_drives_count_as_observing(feature: MapFeature | None, frames: int, seen: int) -> None:
    evidence = confirmation_evidence(feature, 0.8, frames)
    before = (0, 0) if feature is None else (feature.seen_count, feature.missed_count)
    assert observed(feature, evidence) == {
        "existence_probability": evidence.existence_probability,
        "seen_count": before[0] + seen,
        "missed_count": before[1],
        "first_missed_ns": None,
    }


def test_a_miss_changes_the_evidence_alone_and_remembers_the_first_instant() -> None:
    once = missed(TWICE, 0.6, 70)
    assert evidence_of(once) == (4, 3, 70)
    assert once.existence_probability == 0.6
    assert once.model_copy(update=observed(None, ABSENT)) == TWICE.model_copy(update=observed(None, ABSENT))
    assert evidence_of(missed(once, 0.4, 90)) == (4, 4, 70)
    assert evidence_of(missed(once, 0.4, 50)) == (4, 4, 50), "an overlapping drive, that came to it before"


@pytest.mark.parametrize(("ratio", "odds"), [(-2.0, 9 * exp(-2)), (-100.0, exp(-7))], ids=["some", "no end of"])
def test_misses_add_up_to_a_limit_from_which_later_drives_come_back(ratio: float, odds: float) -> None:
    params = ReconcileParams(vanished_probability=0.05)
    after = miss_evidence(TWICE, NotObserved(3, 1, ratio, 0), params).existence_probability
    assert after == pytest.approx(odds / (1 + odds))


def test_a_feature_that_is_gone_keeps_what_is_known_of_it() -> None:
    doubted = missed(TWICE, 0.6, 70)
    removed, merged = ended(doubted, ABSENT), ended(doubted, None)
    assert (removed.version, *evidence_of(removed)) == (4, 4, 4, None)
    assert removed.existence_probability == ABSENT.existence_probability
    assert (merged.version, *evidence_of(merged)) == (4, 4, 3, None)
    assert merged.existence_probability == 0.6
