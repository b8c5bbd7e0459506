"""What is pasted into training samples."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class CutOut:
    """A thing to paste: (h, w, 4) BGRA uint8; its box [x0, y0, x1, y1], foot and tip in its own pixels (NaN: not known)."""

    image: np.ndarray
    category: str = "traffic_cone"
    ends: np.ndarray = field(default_factory=lambda: np.full(4, np.nan))
    box: np.ndarray | None = None
    """None: the whole image."""

    @property
    def box_or_all(self) -> np.ndarray:
        return np.array([0.0, 0.0, self.image.shape[1], self.image.shape[0]]) if self.box is None else self.box
