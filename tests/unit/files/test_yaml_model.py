"""A user's YAML file as a model: what is wrong is named, and what would be right."""

from __future__ import annotations

import pytest

from conetl.files.yaml_model import read_yaml_model
from conetl.model.errors import InputError
from conetl.model.params import IngestParams


def test_without_a_file_or_with_an_empty_one_the_defaults_hold(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text("# nothing yet\n")
    assert read_yaml_model(None, IngestParams, "parameters") == IngestParams()
    assert read_yaml_model(path, IngestParams, "parameters") == IngestParams()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "reconcile: {min_gate: 1}",
            r"parameters .*params.yaml: reconcile.min_gate: there is no such key here.*min_gate_m",
        ),
        ("reconcile: {min_gate_m: far}", r"reconcile.min_gate_m: .*number.*found 'far'"),
        ("reconcile: [1, 2]", r"reconcile: .*found \[1, 2\]"),
        ("nonsense: 1", r"nonsense: there is no such key here; known are .*reconcile"),
        ("- a\n- b", "expected keys and values"),
        ("a: [", "not YAML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, message):
    path = tmp_path / "params.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_yaml_model(path, IngestParams, "parameters")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read"):
        read_yaml_model(tmp_path / "none.yaml", IngestParams, "rules")
