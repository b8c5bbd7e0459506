"""A model file for an operator's streets: train, quantise, measure on what was kept out, compare, and only then write."""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from conetl.files.atomic import atomic_files
from conetl.files.documents import library_errors
from conetl.learning.comparison import ModelComparison, compare, require_same_classes, write_comparison_page
from conetl.learning.evidence.again import measure_again
from conetl.learning.evidence.measure import sidecar_text
from conetl.learning.held_out import hold_out
from conetl.learning.images import LabelledImage
from conetl.learning.labels.folder import Unusable, read_label_folder
from conetl.learning.replay import drawn_scenes
from conetl.model.errors import InputError
from conetl.perception.detector import load_detector
from conetl.perception.model_card import shipped_model_path

#: Share of the time for training; the rest is for loading, quantising and measuring.
_TRAINING_SHARE = 0.75
_LEAST_IMAGES = 8
#: Images that give the network its statistics, and the most that are measured.
_STATISTICS, _MEASURED, _DRAWN_SCENES = 24, 60, 24
_HELD_OUT_SEED = 90


class NewModel(NamedTuple):
    """What `train_model` wrote."""

    model: Path
    page: Path
    trained_on: int
    kept_out: list[str]
    """Recordings, or images where there is one recording, that were kept out."""
    evidence: str
    """What it was measured on; or why there is none."""
    is_measured: bool
    comparison: ModelComparison
    unusable: list[Unusable]
    minutes: float


def train_model(
    labels: Path,
    out: Path,
    *,
    base: Path | None = None,
    minutes: float = 12.0,
    threads: int = 2,
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> NewModel:
    """Teach a network the images of a folder of labels; writes the model, its sidecar and a page, and installs nothing.

    base: the model to start from (None: the shipped one). minutes: for everything. progress: is given the share that is done.
    Raises InputError without PyTorch, or too few images; nothing is written then.
    """
    started = time.monotonic()
    missing = (
        "training requires PyTorch and ONNX, which are not installed: pip install 'conetl[train]', then run this again"
    )
    with library_errors(missing, ImportError):
        from conetl.learning.fine_tuning import fine_tune
        from conetl.learning.onnx_export import export_network
        from conetl.learning.quantise import quantise
        from conetl.learning.restore import restored_network
    if out.suffix != ".onnx":
        raise InputError(f"{out}: expected a name that ends with .onnx")
    path = base or shipped_model_path()
    old = load_detector(path)
    require_same_classes(old)
    images, unusable = read_label_folder(labels)
    own, kept_out = hold_out(images)
    judged = sum(len(one.boxes) + len(one.false) for one in own)
    if len(images) < _LEAST_IMAGES or not judged or not kept_out:
        raise InputError(
            f"{labels}: {len(images)} images can be used, with {judged} boxes in those to train on; at least {_LEAST_IMAGES} "
            "images with labelled or refused objects are needed, better 60"
        )
    pixels = [one.image for one in _some(own, _STATISTICS)]
    network = restored_network(path, pixels)
    left = _TRAINING_SHARE * minutes - (time.monotonic() - started) / 60
    network = fine_tune(
        network, own, minutes=max(left, 0.1), threads=threads,
        progress=lambda share, text: progress(_TRAINING_SHARE * share, text),
    )  # fmt: skip
    progress(_TRAINING_SHARE, "measure")
    page_path = out.with_suffix(".html")
    scenes = drawn_scenes(kept_out, _DRAWN_SCENES, _HELD_OUT_SEED)
    measured = [*_some(kept_out, _MEASURED), *scenes]
    with tempfile.TemporaryDirectory() as folder:
        float_file, int8_file = Path(folder) / "float.onnx", Path(folder) / out.name
        export_network(network, float_file)
        ranges = [one.image for one in drawn_scenes(own, _STATISTICS, _HELD_OUT_SEED + 1)]
        quantise(float_file, [*pixels, *ranges], int8_file)
        card = _card(path, int8_file, len(own))
        sidecar = int8_file.with_name(int8_file.name + ".json")
        sidecar.write_text(json.dumps(card))
        new = load_detector(int8_file)
        evidence, about = measure_again(new, old.card.evidence, measured)
        if evidence is not None:
            card["evidence"] = evidence.model_dump(mode="json")
        comparison = compare(old, new, measured)
        content = int8_file.read_bytes()
    with atomic_files(out.with_name(out.name + ".json"), out) as (card_file, model_file):
        card_file.write_text(sidecar_text(card))
        model_file.write_bytes(content)
    names = _names(kept_out, own)
    result = NewModel(
        out,
        page_path,
        len(own),
        names,
        about,
        evidence is not None,
        comparison,
        unusable,
        (time.monotonic() - started) / 60,
    )
    write_comparison_page(
        page_path, f"{old.card.name} and {out.stem}", _summary(result, old.card.name), comparison, _how(result)
    )
    return result


def _some(images: list[LabelledImage], most: int) -> list[LabelledImage]:
    """At most so many images, evenly through the list."""
    return images[:: max(-(-len(images) // most), 1)]


def _card(base: Path, model: Path, count: int) -> dict[str, Any]:
    """The sidecar of a model made from another one, without evidence."""
    card: dict[str, Any] = json.loads(base.with_name(base.name + ".json").read_text())
    card.pop("evidence", None)
    return card | {
        "name": model.stem,
        "version": f"{card['version']}+{count}",
        "sha256": hashlib.sha256(model.read_bytes()).hexdigest(),
        "licence": f"{card['licence'].partition(' (taught')[0]} (taught {count} images of its operator)",
    }


def _names(kept_out: list[LabelledImage], own: list[LabelledImage]) -> list[str]:
    """The recordings that were kept out whole; else the images."""
    recordings = sorted({one.source for one in kept_out})
    return recordings if not set(recordings) & {one.source for one in own} else sorted(one.name for one in kept_out)


def _how(made: NewModel) -> str:
    whole = "Whole recordings were kept out of training" if len(made.kept_out) < 12 else "Kept out of training"
    return f"{whole}: {', '.join(made.kept_out[:12])}{' ...' if len(made.kept_out) > 12 else ''}."


def _summary(made: NewModel, old_name: str) -> list[str]:
    measured = "Evidence in the sidecar (P(detect), calibration of scores): " if made.is_measured else "No evidence: "
    return [
        f"{made.model.name} was taught {made.trained_on} images, from {old_name}, in {made.minutes:.0f} minutes.",
        measured + made.evidence + ".",
        f"It is not installed: set CONETL_MODEL_PATH={made.model} to use it, and conetl backfill --reanalyse for older drives.",
    ]
