"""YAML and JSON that a stranger may have written, and a user's YAML file as a model."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from conetl.files.documents import (
    MAX_DEPTH,
    MAX_SHOWN,
    MAX_YAML_BYTES,
    MAX_YAML_VALUES,
    library_errors,
    read_json,
    read_yaml,
    read_yaml_model,
    shown,
)
from conetl.model.errors import InputError, StorageError
from conetl.model.params import IngestParams

BOMB = "\n".join(f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9) if n else 'x'}]" for n in range(10))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, "each alias counts"),
        ("a: &a [*a]", "each alias counts"),
        ("[" * 20_000, "levels"),
        ("{a: " * 20_000, "levels"),
        ("- " * 20_000, "levels"),
        ("x: " + "y" * MAX_YAML_BYTES, "at most 256,000 bytes"),
        ("at: !!timestamp 2026-13-45", "not YAML"),
        ("at: !!timestamp now", "not YAML"),
        (f"n: {'1' + ':59' * 80_000}", "a number has 240,001 characters"),
        (f"n: {'1' + ':59' * 80_000}.5", "a number has 240,003 characters"),
        (f"n: [{'1,' * MAX_YAML_VALUES}]", "exceeds 20,000 values"),
        (f"n: {'9' * 5000}", "not YAML"),
        ("a: !!python/object/apply:os.system [id]", "not YAML"),
        ("a: b: c", "not YAML"),
        (b"\xff\xfe", "not a text file"),
    ],
)
def test_hostile_yaml_is_refused_in_one_sentence(tmp_path: Path, text: str | bytes, said: str) -> None:
    path = tmp_path / "drive.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=said) as refused:
        read_yaml(path)
    assert len(str(refused.value)) < len(str(path)) + MAX_SHOWN + 100


def test_times_keep_their_digits(tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text("start: 2026-03-02 10:00:00.000000250Z\ndate: 2026-03-02\n")
    assert read_yaml(tmp_path / "drive.yaml") == {"start": "2026-03-02 10:00:00.000000250Z", "date": "2026-03-02"}


@pytest.mark.parametrize("text", ["[" * 100_000, "{", '{"a": ' * 50_000, "9" * 5000, "NaN,"])
def test_hostile_json_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calib.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"not JSON|nested"):
        read_json(path)


trees = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.text("abc :#[]{}*&!|>'\"\n", max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("xyz", min_size=1), inner, max_size=4),
    max_leaves=20,
)


@given(trees)
def test_what_was_written_is_read(tmp_path_factory: pytest.TempPathFactory, tree: object) -> None:
    path = tmp_path_factory.getbasetemp() / "tree.yaml"
    path.write_text(yaml.safe_dump(tree))
    assert read_yaml(path) == tree


def test_aliases_within_the_limit_are_read(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("left: &k {fx: 700.5}\nright: *k\n" + f"deep: {'[' * (MAX_DEPTH - 2)}{']' * (MAX_DEPTH - 2)}\n")
    assert read_yaml(path)["right"] == {"fx": 700.5}


def test_messages_quote_little_of_a_value() -> None:
    nested: list[object] = ["x" * 1000]
    for _ in range(30):
        nested = [nested, nested, nested]
    for value in (nested, "x" * 10_000, {str(n): n for n in range(1000)}, b"\0" * 5000, 10**4000, 1 << 20_000):
        assert 0 < len(shown(value)) <= MAX_SHOWN
    assert shown({"fx": [1.0, None]}) == "{'fx': [1.0, None]}"


def test_without_a_file_or_with_an_empty_one_the_defaults_hold(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("# nothing yet\n")
    assert read_yaml_model(None, IngestParams, "parameters") == IngestParams()
    assert read_yaml_model(path, IngestParams, "parameters") == IngestParams()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "reconcile: {min_gate: 1}",
            r"parameters .*params.yaml: reconcile.min_gate: unknown key.*min_gate_m",
        ),
        ("reconcile: {min_gate_m: far}", r"reconcile.min_gate_m: .*number.*found 'far'"),
        ("reconcile: [1, 2]", r"reconcile: .*found \[1, 2\]"),
        ("nonsense: 1", r"nonsense: unknown key; known are .*reconcile"),
        ("- a\n- b", "expected keys and values"),
        ("a: [", "not YAML"),
        (None, r"params\.yaml: cannot be read"),
    ],
)
def test_what_is_wrong_with_a_model_is_named(tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "params.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_yaml_model(path, IngestParams, "parameters")


@pytest.mark.parametrize(
    ("raised", "message"),
    [
        (ValueError("line 1\n  column 2."), "run.bag is damaged (line 1 column 2)"),
        (PermissionError(13, "Permission denied", "run.bag"), "run.bag is damaged (Permission denied)"),
        (KeyError(), "run.bag is damaged (KeyError)"),
        (RuntimeError("x" * 5000), f"run.bag is damaged ({'x' * MAX_SHOWN})"),
    ],
)
def test_an_error_of_a_library_becomes_one_line_of_ours(raised: Exception, message: str) -> None:
    with pytest.raises(InputError) as found, library_errors("run.bag is damaged"):
        raise raised
    assert (str(found.value), found.value.__cause__) == (message, raised)


def test_other_errors_than_those_of_the_library_pass() -> None:
    for kinds, raised in (((), StorageError("full")), ((ValueError,), TypeError("a bug")), ((), KeyboardInterrupt())):
        with pytest.raises(type(raised)) as found, library_errors("run.bag is damaged", *kinds):
            raise raised
        assert found.value is raised
