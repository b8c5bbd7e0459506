"""The sidecar `NAME.onnx.json` of a model file: what the network eats and gives, what its bytes hash to, what its scores mean."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, PositiveInt, ValidationError, model_validator

from conetl.model.detector_evidence import DetectorEvidence, Share
from conetl.model.errors import ModelFileError
from conetl.perception.heads import Shape, YoloHead

DEFAULT_MODEL = "conetl-cone-2.onnx"
#: What users are told of a model without `evidence` in its sidecar.
NOT_MEASURED = (
    "the model's sidecar does not say what its scores mean (key `evidence`): existence probabilities rest on a general guess; "
    "training/calibrate_scores.py measures it (docs/how-to/models.md)"
)


class SideDistributionHead(BaseModel):
    """The shipped network's own head: values and places of the best cells of each stride; see `detector_decode.decode_cells`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["side-distributions"] = "side-distributions"
    side_bins: int = Field(ge=2)
    strides_px: tuple[PositiveInt, ...] = Field(min_length=1)
    """In the order of the outputs."""
    foot_and_tip: bool = False
    """Whether the head gives the cone's foot and tip besides its box."""

    @property
    def channels(self) -> int:
        return 4 * self.side_bins + (5 if self.foot_and_tip else 1)


class CloserLook(BaseModel):
    """How candidates of middling score are looked at once more (`closer_look.py`); sizes in pixels of the network's input."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cone_px: PositiveInt
    """Height to which the candidate is scaled."""
    window_px: PositiveInt
    """Side of the square window that the network is given."""
    scores: tuple[Share, Share]
    """Candidates from the first to the second score get a closer look."""
    share: Share
    """Weight of the closer look; the first look has the rest."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.cone_px >= self.window_px or self.scores[0] >= self.scores[1]:
            raise ValueError(
                "closer_look: cone_px must be below window_px, and the first of the scores below the second"
            )
        return self


class EnlargedLook(BaseModel):
    """How parts with small candidates are looked at once more (`enlarged_look.py`); sizes in pixels of the network's input."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    below_px: PositiveInt
    """Candidates less tall than this are small."""
    from_score: Share
    """A small candidate of this score calls for an enlarged look at its surroundings."""
    around_px: PositiveInt
    """So much around it is shown."""
    scale: float = Field(gt=1.0, le=8.0)
    """By how much the surroundings are enlarged."""
    share: Share
    """Weight of the enlarged look; the first look has the rest."""


class ModelCard(BaseModel):
    """A model's sidecar. Unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    version: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    input_layout: str = Field(pattern=r"^(RGB|BGR) (float32 (NCHW|NHWC) 0\.\.(1|255)|uint8 (NCHW|NHWC) 0\.\.255)$")
    """For instance "RGB float32 NCHW 0..1"."""
    head: Annotated[
        SideDistributionHead | YoloHead,
        Field(discriminator="kind"),
    ]
    pad_multiple_px: int = Field(ge=1)
    """Both sides of the input are padded to a multiple of it; of no account where the network's input has a fixed size."""
    closer_look: CloserLook | None = None
    """None: every candidate is judged by one look. Only for networks that take images of any size."""
    enlarged_look: EnlargedLook | None = None
    """None: what is small is judged at the image's own size. Only for networks that take images of any size."""
    class_names: tuple[str, ...] = Field(min_length=1)
    score_scale: str
    licence: str
    evidence: DetectorEvidence | None = None
    """What scores, boxes and misses of this very file mean, as `training/calibrate_scores.py` measured it; None: not measured."""

    @property
    def detections_sha256(self) -> str:
        """Hash of all that detections depend on: the weights and how the sidecar has them used, not what was measured of them."""
        used = {"sha256", "input_layout", "head", "pad_multiple_px", "closer_look"}
        if self.enlarged_look is not None:  # without it detections are those of before there was such a key
            used.add("enlarged_look")
        return hashlib.sha256(self.model_dump_json(include=used).encode()).hexdigest()

    @model_validator(mode="after")
    def _window_fits_the_network(self) -> Self:
        if self.closer_look is not None and self.closer_look.window_px % self.pad_multiple_px:
            raise ValueError(f"closer_look.window_px must be a multiple of pad_multiple_px, {self.pad_multiple_px}")
        return self

    @model_validator(mode="after")
    def _measured_on_this_file(self) -> Self:
        if self.evidence is not None and self.evidence.model_sha256 != self.sha256:
            raise ValueError(
                f"evidence was measured on a model file with SHA-256 {self.evidence.model_sha256[:12]}..., this one has "
                f"{self.sha256[:12]}...: run training/calibrate_scores.py on this file, or leave the key `evidence` out"
            )
        return self


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
        text = card_path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelFileError(
            f"{card_path}: cannot read the model's sidecar ({error}); every model needs one beside it"
        ) from error
    try:
        return ModelCard.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "file"
        raise ModelFileError(f"{card_path}: not a valid model sidecar: {place}: {first['msg']}") from error


def check_own_outputs(head: SideDistributionHead, shapes: list[Shape]) -> None:
    """Check that a network's outputs are values (K, channels) and places (K,) of cells per stride. Raises ModelFileError."""
    if len(shapes) != 2 * len(head.strides_px):
        raise ModelFileError(
            f"the network has {len(shapes)} outputs, the sidecar expects two for each of {len(head.strides_px)} strides"
        )
    for values, cells in zip(shapes[::2], shapes[1::2], strict=True):
        if len(values) != 2 or len(cells) != 1 or (isinstance(values[1], int) and values[1] != head.channels):
            raise ModelFileError(
                f"two outputs have the shapes {list(values)} and {list(cells)}, the sidecar expects (K, {head.channels}) and (K,)"
            )
