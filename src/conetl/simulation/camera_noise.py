"""From linear radiance to the JPEG file a camera would have written."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

FULL_WELL_ELECTRONS = 9000.0
READ_NOISE_ELECTRONS = 6.0
BLUR_SIGMA_PX = 0.45
"""Lens and pixel together."""


def exposure_gain(radiance: NDArray[np.float32], brightness: float = 1.0) -> float:
    """Factor that brings the middle of a image's lower two thirds (road and cones) to a mid grey."""
    lower = radiance[radiance.shape[0] // 3 :].mean(axis=-1)
    return brightness * 0.15 / max(float(np.median(lower)), 1e-9)


def develop(
    radiance: NDArray[np.float32], gain: float, rng: np.random.Generator, *, blur_sigma_px: float = BLUR_SIGMA_PX
) -> NDArray[np.uint8]:
    """8-bit BGR image (H, W, 3) of linear RGB radiance: blur, exposure, shot and read noise, soft shoulder, sRGB curve."""
    light = cv2.GaussianBlur(np.maximum(radiance, 0.0) * np.float32(gain), (0, 0), blur_sigma_px).astype(np.float64)
    light = np.where(light < 0.6, light, 0.6 + 0.4 * (1.0 - np.exp(-(light - 0.6) / 0.4)))
    variance = light / FULL_WELL_ELECTRONS + (READ_NOISE_ELECTRONS / FULL_WELL_ELECTRONS) ** 2
    light = np.clip(light + rng.normal(size=light.shape) * np.sqrt(variance), 0.0, 1.0)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(srgb[..., ::-1] * 255.0 + 0.5).astype(np.uint8)


def encode_jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """JPEG bytes of a BGR image."""
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"a image of shape {image.shape} could not be written as JPEG")
    return bytes(data.tobytes())
