"""What `conetl init` knows of a folder, and `drive.yaml` for people to complete: its values, places for those that are still
needed, and other keys as comments.

What a key means, and an example, are those of its field in `DriveYaml`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from conetl.files.documents import nested_model
from conetl.model.rig import Rig
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.trajectories.recorded import RecordedTrajectory

#: What is needed beside the keys of drive.yaml: the calibration of the cameras, which becomes rig.yaml.
RIG = "rig"
_MARK = "# How conetl reads this drive, written by 'conetl init'"
_HEADER = f"""{_MARK}.
# A key without a value is as if it were not there. All keys: docs/reference/drive_yaml.md
"""
_HOW_TO_COMPLETE = "# Write the values that are NEEDED behind their keys, and run 'conetl init' again.\n"
#: Sections in their order, with keys that are shown as comments where they are not stated.
_OPTIONAL: dict[str, tuple[str, ...]] = {
    "images": ("start", "right_offset_s", "every", "from_s", "to_s"),
    "trajectory": ("time", "heights"),
    "sigmas": ("horizontal_m", "pitch_deg"),
    "mount": ("yaw_deg", "roll_deg"),
    "clock": ("offset_s",),
    "shutter": ("readout_ms", "stamp_row"),
}
_OPTIONAL_VALUES = ("drive_id", "timestamps_timezone", "common_errors", "control_points")
_WIDTH = 110
#: Keys that name a file or folder of the drive.
FILE_KEYS = (
    "images.left", "images.right", "images.timestamps", "images.right_timestamps", "trajectory.file", "control_points.file",
)  # fmt: skip
#: Suffixes of tables and of files of times.
TABLE_SUFFIXES = frozenset({".csv", ".tsv", ".txt"})


class Missing(NamedTuple):
    """A value that a folder does not show."""

    key: str
    """As in drive.yaml, with dots between the levels; or `RIG`."""
    cause: str | None = None
    """Why, or what was found."""
    suggestion: object = None
    """A value that may be right, which `--yes` takes; otherwise the example of the key."""
    required: bool = True
    """Whether there is no drive without it."""

    @property
    def example(self) -> str:
        """The suggestion or example, in YAML."""
        return in_yaml(_example(self.key) if self.suggestion is None else self.suggestion)

    @property
    def text(self) -> str:
        """What the value is, and the cause."""
        text = "Calibration of the cameras." if self.key == RIG else str(KEYS[self.key].description)
        return text if self.cause is None else f"{text.rstrip('.')} ({self.cause.rstrip('.')})"


class Proposal(NamedTuple):
    """What was found in a folder, what is missing, and the settings so far."""

    found: list[str]
    missing: list[Missing]
    settings: dict[str, Any]
    """Content of drive.yaml."""
    rig: Rig | None = None
    """To be written as rig.yaml; None where there is one."""
    recorded: RecordedTrajectory | None = None
    """The trajectory, where it can be read."""

    def need(self, key: str, cause: str | None = None, suggestion: object = None, *, required: bool = True) -> None:
        """Add a missing value, unless it is stated."""
        if value_at(self.settings, key) is None:
            self.missing.append(Missing(key, cause, suggestion, required))


def value_at(settings: Mapping[str, Any], key: str) -> Any:
    """The value of a key like `images.left`; None where there is none."""
    section, _, name = key.partition(".")
    values = settings.get(section)
    return values if not name else values.get(name) if isinstance(values, Mapping) else None


def _fields_of(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    for name, field in model.model_fields.items():
        yield f"{prefix}{name}", field
        if (inner := nested_model(field.annotation)) is not None:
            yield from _fields_of(inner, f"{prefix}{name}.")


#: All keys of drive.yaml, with dots between the levels.
KEYS: dict[str, FieldInfo] = dict(_fields_of(DriveYaml))


def _example(key: str) -> Any:
    return (KEYS[key].examples or [None])[0]


def is_text(key: str) -> bool:
    """Whether the value of a key is text, and nothing else."""
    annotation = KEYS[key].annotation if key in KEYS else None
    return set(get_args(annotation) or (annotation,)) - {type(None)} == {str}


def is_key(key: str) -> bool:
    """Whether drive.yaml may have this key, with dots between the levels."""
    section = KEYS.get(key.rpartition(".")[0])
    return key in KEYS or (section is not None and get_origin(section.annotation) is dict)


def similar_keys(word: str) -> list[str]:
    """Keys of drive.yaml that are like a word: whose last part is, or which are as a whole."""
    hidden = ("cameras", "streams", "common_errors.", "control_points")
    ends = {key: key.rpartition(".")[2] for key in KEYS if not key.startswith(hidden)}
    near = get_close_matches(word.rpartition(".")[2].replace("-", "_"), ends.values(), n=1, cutoff=0.65)
    found = [key for key, end in ends.items() if [end] == near]
    return get_close_matches(word, found, n=1, cutoff=0.8) or found or get_close_matches(word, KEYS, n=1, cutoff=0.8)


def is_template(path: Path) -> bool:
    """Whether `conetl init` wrote a drive.yaml: its comments can be written anew."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(len(_MARK)) == _MARK


def in_yaml(value: object) -> str:
    """A value in one line of YAML."""
    if isinstance(value, str) and not value.isprintable():
        return json.dumps(value)  # with escapes
    text = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, sort_keys=False, width=2**31)
    return text.removesuffix("\n").removesuffix("\n...")


def template(settings: Mapping[str, Any], missing: Sequence[Missing]) -> str:
    """The text of drive.yaml. settings: as `DriveYaml`; missing: what is still needed."""
    needed = {value.key: value for each in missing if each.key != RIG for value in _values_of(each)}
    text = _HEADER + _HOW_TO_COMPLETE * bool(missing)
    for each in (each for each in missing if each.key == RIG):
        text += _comment(f"NEEDED: conetl init FOLDER --rig FILE. {each.text}")
    for name in [*_OPTIONAL, *(name for name in settings if name not in _OPTIONAL)]:
        text += _section(name, settings.get(name), needed)
    return text + "\n" + "".join(_optional(key) for key in _OPTIONAL_VALUES if key not in settings)


def _values_of(missing: Missing) -> list[Missing]:
    """The values of a section that is missing as a whole, such as a mount: those of its example."""
    if nested_model(KEYS[missing.key].annotation) is None:
        return [missing]
    return [Missing(f"{missing.key}.{name}", None, value) for name, value in _example(missing.key).items()]


def _section(name: str, values: object, needed: Mapping[str, Missing]) -> str:
    """The lines of a key of the highest level, behind an empty one; nothing where it has none. needed: by their keys."""
    if values is not None and (not isinstance(values, Mapping) or (name == "clock" and not values)):
        return f"\n{name}: {in_yaml(values)}\n"  # an empty clock is one to estimate
    stated, lines = values or {}, ""
    # Most rigs have a mount.
    optional = _OPTIONAL.get(name, ()) if name != "mount" or stated or "mount.forward_m" in needed else ()
    for key in KEYS:
        section, _, word = key.rpartition(".")
        if section != name:
            continue  # what is in a section of its section, such as shutter.right, is written with that
        if word in stated:
            lines += f"  {word}: {in_yaml(stated[word])}\n"
        elif key in needed:
            lines += _comment(f"NEEDED, like {needed[key].example}: {needed[key].text}", "  ") + f"  {word}:\n"
        elif word in optional:
            lines += _optional(key, "  ")
    comment = f"  # {KEYS[name].description}" if KEYS[name].description else ""
    return f"\n{name}:{comment}\n{lines}" if lines else ""


def _optional(key: str, indent: str = "") -> str:
    """A key that is not stated, as a comment."""
    return f"{indent}# {key.rpartition('.')[2]}: {in_yaml(_example(key))}  # {KEYS[key].description}\n"


def _comment(text: str, indent: str = "") -> str:
    """Lines of a comment, of a text that may quote any file."""
    text = "".join(c if c.isprintable() else " " for c in text)
    return "".join(f"{indent}# {line}\n" for line in wrap(text, _WIDTH))
