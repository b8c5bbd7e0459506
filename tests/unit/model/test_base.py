"""Records that are made without checks."""

from __future__ import annotations

import pytest

from conetl.model.base import sound
from conetl.model.map_records import MissSummary


def test_a_sound_record_is_the_checked_one():
    values = {"existence_probability": 0.5, "first_missed_ns": 7}
    made, checked = sound(MissSummary, **values), MissSummary(**values)
    assert made == checked and hash(made) == hash(checked) and made.model_dump_json() == checked.model_dump_json()


def test_a_forgotten_field_is_an_error_at_once():
    with pytest.raises(TypeError, match="MissSummary: expected every field, found existence_probability"):
        sound(MissSummary, existence_probability=0.5)
