"""The sidecar `NAME.onnx.json` of a model file: input, head, passes, SHA-256 and the evidence about its scores."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Self

from pydantic import Field, PositiveInt, ValidationError, model_validator

from conetl.files.documents import MAX_JSON_BYTES, first_message, read_limited
from conetl.model.base import Record
from conetl.model.detector_evidence import DetectorEvidence, Share
from conetl.model.errors import InputError, ModelFileError
from conetl.perception.heads import Head, SideDistributionHead

DEFAULT_MODEL = "conetl-road-10.onnx"
_ULTRALYTICS_LAYOUT = "RGB float32 NCHW 0..1"
#: Warning for a model without `evidence` in its sidecar.
NOT_MEASURED = (
    "the model's sidecar does not state what its scores mean (key `evidence`), so existence probabilities use default values; "
    "training/calibrate_scores.py measures it (docs/map/models.md)"
)


class ReScoringPass(Record):
    """Re-scoring pass (`second_passes.py`), key `closer_look`; sizes in pixels of the network's input."""

    cone_px: PositiveInt
    """Height to which the candidate is scaled."""
    window_px: PositiveInt
    """Side of the square window that the network is given."""
    scores: tuple[Share, Share]
    """Candidates from the first to the second score are scored again."""
    share: Share
    """Weight of the second score; the first has the rest."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.cone_px >= self.window_px or self.scores[0] >= self.scores[1]:
            raise ValueError(
                "closer_look: cone_px must be below window_px, and the first of the scores below the second"
            )
        return self


class SmallObjectPass(Record):
    """Small-object pass (`second_passes.py`), key `enlarged_look`; sizes in pixels of the network's input."""

    below_px: PositiveInt
    """Candidates less tall than this are small."""
    from_score: Share
    """Small candidates of at least this score start the pass."""
    around_px: PositiveInt
    """Margin around the candidate."""
    scale: float = Field(gt=1.0, le=8.0)
    """Enlargement."""
    share: Share
    """Weight of this pass; the first has the rest."""


class ModelCard(Record):
    """A model's sidecar. Unknown keys are refused."""

    name: str
    version: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    input_layout: str = Field(pattern=r"^(RGB|BGR) (float32 (NCHW|NHWC) 0\.\.(1|255)|uint8 (NCHW|NHWC) 0\.\.255)$")
    """For instance "RGB float32 NCHW 0..1"."""
    head: Head = Field(discriminator="kind")
    pad_multiple_px: int = Field(ge=1)
    """Both sides of the input are padded to a multiple of it; ignored where the network's input has a fixed size."""
    closer_look: ReScoringPass | None = None
    """None: no re-scoring pass. Only for networks that take images of any size."""
    enlarged_look: SmallObjectPass | None = None
    """None: no small-object pass. Only for networks that take images of any size."""
    class_names: tuple[str, ...] = Field(min_length=1)
    score_scale: str
    licence: str
    evidence: DetectorEvidence | None = None
    """Meaning of scores, boxes and misses of this file, measured by `training/calibrate_scores.py`; None: not measured."""

    def require_categories(self, categories: Iterable[str], *, besides: Iterable[str] = ()) -> None:
        """Raise InputError for classes that neither the model nor `besides` knows."""
        accepted = (*self.class_names, *besides)
        if unknown := sorted(set(categories) - set(accepted)):
            raise InputError(
                f"the model {self.name} has no category {', '.join(unknown)}: choose from {', '.join(accepted)}"
            )

    def require_metadata(self, metadata: Mapping[str, str]) -> None:
        """Raise ModelFileError if the network's own metadata contradict the sidecar: its classes and their order, and for exports
        of Ultralytics the input.

        Ultralytics, YOLOv5 and `training/export.py` write the classes (key `names`). Other names than the sidecar's are no
        contradiction: only that has conetl's names, `traffic_cone` for `cone`.
        """
        layout = self.input_layout
        if metadata.get("author") == "Ultralytics" and "float32 NCHW" in layout and layout != _ULTRALYTICS_LAYOUT:
            raise ModelFileError(
                f"the file is an export of Ultralytics, whose input is {_ULTRALYTICS_LAYOUT!r}, but the sidecar's "
                f"input_layout is {layout!r}: correct that key"
            )
        stated, own = _stated_names(metadata.get("names", "")), list(map(_plain, self.class_names))
        if stated and len(stated) != len(own):
            raise ModelFileError(
                f"the file names {len(stated)} classes ({', '.join(stated)}), class_names of its sidecar {len(own)}: "
                "list all classes of the network there, in its order"
            )
        for k, name in enumerate(stated):
            if name != own[k] and name in own:
                raise ModelFileError(
                    f"class {k} is {name!r} by the file itself and {own[k]!r} by class_names of its sidecar: the classes are in "
                    f"another order there. The file has {', '.join(stated)}"
                )

    @property
    def detections_sha256(self) -> str:
        """Hash of everything that detections depend on: the weights, the passes and the classes, not the evidence."""
        used = {"sha256", "input_layout", "head", "pad_multiple_px", "closer_look", "enlarged_look", "class_names"}
        return hashlib.sha256(self.model_dump_json(include=used).encode()).hexdigest()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(self.class_names) != self.head.class_count:
            raise ValueError(
                f"head.class_count is {self.head.class_count}, class_names has {len(self.class_names)} names"
            )
        if isinstance(self.head, SideDistributionHead) and self.pad_multiple_px % max(self.head.strides_px):
            raise ValueError(
                f"pad_multiple_px must be a multiple of the largest of head.strides_px, {max(self.head.strides_px)}"
            )
        if self.closer_look is not None and self.closer_look.window_px % self.pad_multiple_px:
            raise ValueError(f"closer_look.window_px must be a multiple of pad_multiple_px, {self.pad_multiple_px}")
        if self.evidence is not None and self.evidence.model_sha256 != self.sha256:
            raise ValueError(
                f"evidence was measured on a model file with SHA-256 {self.evidence.model_sha256[:12]}..., this one has "
                f"{self.sha256[:12]}...: run training/calibrate_scores.py on this file, or leave the key `evidence` out"
            )
        return self


def _stated_names(text: str) -> list[str]:
    """Class names by the metadata of a network, `{0: 'car', 1: 'cone'}` or `['car', 'cone']`; none if written otherwise."""
    try:
        found = ast.literal_eval(text[:MAX_JSON_BYTES])
        return [] if isinstance(found, str) else [_plain(found[k]) for k in range(len(found))]
    except (ValueError, SyntaxError, TypeError, KeyError, AttributeError, MemoryError, RecursionError):
        return []


def _plain(name: str) -> str:
    return name.lower().replace(" ", "_").replace("-", "_")


def shipped_model_path() -> Path:
    """The model that comes with conetl: in a checkout under `data/models/`, in an installed wheel inside the package."""
    package = Path(__file__).resolve().parents[1]
    in_wheel = package / "data" / "models" / DEFAULT_MODEL
    in_checkout = package.parents[1] / "data" / "models" / DEFAULT_MODEL
    return in_wheel if in_wheel.exists() else in_checkout


def read_model_card(model_path: Path | None) -> ModelCard:
    """Read and check the sidecar `<model>.json`, of the shipped model where None is given. Raises ModelFileError."""
    model_path = model_path or shipped_model_path()
    card_path = model_path.with_name(model_path.name + ".json")
    try:
        text = read_limited(card_path, MAX_JSON_BYTES)
    except InputError as error:
        raise ModelFileError(
            f"{card_path}: cannot read the model's sidecar ({error}); every model needs one beside it"
        ) from error
    try:
        return ModelCard.model_validate_json(text)
    except ValidationError as error:
        raise ModelFileError(f"{card_path}: not a valid model sidecar: {first_message(error)}") from error
