"""What the map makes of a road that changes from day to day; `make bench-changes` is the long version."""

from __future__ import annotations

import pytest

from conetl.perception.model_card import read_model_card
from tests.synthetic.changing_road import simulate


@pytest.mark.release
def test_changes_of_some_days_are_told_rightly() -> None:
    evidence = read_model_card(None).evidence
    assert evidence is not None
    score = simulate(10, evidence, seed=3)
    happened = sum(
        score.confusion[kind, said] for kind in ("added", "moved", "removed") for said in ("added", "moved", "removed")
    )
    assert happened >= 5
    assert score.f1 >= 0.9, score.wrong
    assert score.deleted_recall >= 0.95
    assert score.unseen_removed == 0
    assert not score.held
