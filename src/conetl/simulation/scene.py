"""A `World` as a Mitsuba scene, and images of it as from a camera. Mitsuba's world frame is the road frame.

Pixel convention of KITTI and OpenCV: an integer coordinate is the centre of a pixel.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.files.documents import library_errors
from conetl.model.arrays import Floats, Image
from conetl.model.rig import Camera
from conetl.simulation import meshes, scenario, textures
from conetl.simulation.parts import BUILDERS, Part, cone_parts, motion

FULL_WELL_ELECTRONS = 9000.0
READ_NOISE_ELECTRONS = 6.0
BLUR_SIGMA_PX = 0.45
"""Blur of lens and pixel together."""


def load_mitsuba() -> Any:
    """The mitsuba module, set to its portable variant. Raises InputError where it is not installed."""
    missing = "rendering needs Mitsuba 3, which is not installed: pip install 'conetl[simulate]', then run this again"
    with library_errors(missing, ImportError):
        import mitsuba as mi
    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    return mi


def build_scene(world: scenario.World) -> Any:
    """The Mitsuba scene of a world, without cameras. Equal worlds give equal scenes."""
    mi = load_mitsuba()
    scene: dict[str, Any] = {"type": "scene", "sky": _sky(world)}
    with tempfile.TemporaryDirectory(prefix="conetl-scene-") as name:
        for number, part in enumerate(_world_parts(world)):
            scene[f"part{number:04d}"] = _shape(mi, part, Path(name) / f"{number:04d}.ply")
        return mi.load_dict(scene)


def render(
    scene: Any, camera: Camera, road_SE3_camera: Floats, *, samples_per_pixel: int, seed: int, fast: bool = False
) -> NDArray[np.float32]:
    """Linear radiance (H, W, 3), direct light of sun and sky. road_SE3_camera: (4, 4), camera axes x right, y down, z forward.

    fast: half the time with more noise, without separate samples of shiny surfaces.
    """
    mi = load_mitsuba()
    method = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0} if fast else {"type": "path", "max_depth": 2}
    image = mi.render(
        scene,
        sensor=sensor(camera, road_SE3_camera, samples_per_pixel),
        integrator=mi.load_dict(method),
        spp=samples_per_pixel,
        seed=seed,
    )
    return np.array(image, dtype=np.float32)[..., :3]


def sensor(camera: Camera, road_SE3_camera: Floats, samples_per_pixel: int = 16) -> Any:
    """Mitsuba's perspective camera of an exterior and interior orientation, without a lens and with square pixels.

    Mitsuba counts pixels from the edge of the film (the centre of pixel 0 is 0.5), has x to the left and y up, and its
    principal point offset moves the image, not the axis.
    """
    mi = load_mitsuba()
    to_world = np.asarray(road_SE3_camera, dtype=float) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return mi.load_dict(
        {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f(to_world.tolist()),
            "fov": math.degrees(2.0 * math.atan(camera.width_px / 2.0 / camera.fx_px)),
            "fov_axis": "x",
            "near_clip": 0.05,
            "far_clip": 1000.0,
            "principal_point_offset_x": 0.5 - (camera.cx_px + 0.5) / camera.width_px,
            "principal_point_offset_y": 0.5 - (camera.cy_px + 0.5) / camera.height_px,
            "film": {
                "type": "hdrfilm", "width": camera.width_px, "height": camera.height_px,
                "pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": samples_per_pixel},
        }
    )  # fmt: skip


def _sky(world: scenario.World) -> dict[str, Any]:
    elevation, azimuth = math.radians(world.sun_elevation_deg), math.radians(world.sun_azimuth_deg)
    direction = [
        math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)
    ]  # fmt: skip
    return {
        "type": "sunsky",
        "sun_direction": direction,
        "turbidity": world.turbidity,
        "sun_scale": world.sun_scale,
        "albedo": {"type": "rgb", "value": 0.2},
    }


def _world_parts(world: scenario.World) -> list[Part]:
    found: list[Part] = []
    for number, cone in enumerate(world.cones):
        found += cone_parts(cone, 1000 * world.texture_seed + number)
    for number, item in enumerate(world.objects):
        found += BUILDERS[item.kind](item, 1000 * world.texture_seed + 500 + number)
    return found + _ground(world)


def _flat(x0: float, x1: float, y0: float, y1: float, z: float, tile_m: float) -> meshes.Mesh:
    """A horizontal rectangle whose texture repeats every tile_m."""
    middle = (y0 + y1) / 2
    return meshes.ribbon([(x0, middle), (x1, middle)], y1 - y0, z, tile_m)


def _ground(world: scenario.World) -> list[Part]:
    """Asphalt, markings, kerbs, pavement on the right, grass on both sides."""
    road, seed = world.road, world.texture_seed
    x0, x1 = road.start_m, road.end_m
    stone = textures.mottled(seed + 2, (0.58, 0.57, 0.54), 0.10, size=256)
    grass = textures.mottled(seed + 3, road.verge, 0.30, size=1024)
    ground = [Part(_flat(x0, x1, road.right_m, road.left_m, 0.0, 12.0), textures.asphalt(seed, road.asphalt))]
    for marking in road.markings:
        paint = textures.paint(seed + 1, marking, road.asphalt)
        for line in scenario.painted_lines(marking):
            ground.append(Part(meshes.ribbon(line, marking.width_m, scenario.PAINT_HEIGHT_M, 2.0), paint))
    for y, outwards in ((road.right_m, -1.0), (road.left_m, 1.0)):
        kerb = meshes.box([x1 - x0, scenario.KERB_WIDTH_M, scenario.KERB_HEIGHT_M])
        kerb = kerb._replace(uv=kerb.uv * [(x1 - x0) / 1.0, 0.3])
        ground.append(
            Part(meshes.transformed(kerb, motion((x0 + x1) / 2, y + outwards * scenario.KERB_WIDTH_M / 2)), stone)
        )
    ground.append(Part(_flat(-900.0, 900.0, -900.0, 900.0, -0.05, 25.0), grass))  # up to the horizon
    edge, left = road.pavement_edge_m, road.left_m + scenario.KERB_WIDTH_M
    if road.pavement_width_m > 0:
        slabs = textures.slabs(seed + 4)
        ground.append(
            Part(_flat(x0, x1, edge, road.right_m - scenario.KERB_WIDTH_M, scenario.PAVEMENT_HEIGHT_M, 1.8), slabs)
        )
    ground.append(Part(_flat(x0, x1, edge - 90.0, edge, scenario.VERGE_HEIGHT_M, 7.0), grass))
    ground.append(Part(_flat(x0, x1, left, road.left_m + 90.0, scenario.VERGE_HEIGHT_M, 7.0), grass))
    return ground


def _shape(mi: Any, part: Part, path: Path) -> dict[str, Any]:
    meshes.write_ply(part.mesh, path)
    if isinstance(part.surface, tuple):
        reflectance: dict[str, Any] = {"type": "rgb", "value": [_linear(c) for c in part.surface]}
    else:
        reflectance = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(part.surface)),
            "raw": False,
            "wrap_mode": "repeat",
        }
    if part.roughness is None:
        bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": reflectance}
    else:
        bsdf = {"type": "roughplastic", "diffuse_reflectance": reflectance, "alpha": max(part.roughness, 0.05)}
    return {"type": "ply", "filename": str(path), "bsdf": {"type": "twosided", "inner": bsdf}}


def _linear(srgb: float) -> float:
    """Inverse of the sRGB transfer curve (IEC 61966-2-1)."""
    return srgb / 12.92 if srgb <= 0.04045 else ((srgb + 0.055) / 1.055) ** 2.4


def exposure_gain(radiance: NDArray[np.float32], brightness: float = 1.0) -> float:
    """Factor that maps the median of an image's lower two thirds (road and cones) to a mid grey."""
    lower = radiance[radiance.shape[0] // 3 :].mean(axis=-1)
    return brightness * 0.15 / max(float(np.median(lower)), 1e-9)


def develop(
    radiance: NDArray[np.float32], gain: float, rng: np.random.Generator, *, blur_sigma_px: float = BLUR_SIGMA_PX
) -> Image:
    """8-bit BGR image (H, W, 3) of linear RGB radiance: blur, exposure, shot and read noise, soft shoulder, sRGB curve."""
    light = cv2.GaussianBlur(np.maximum(radiance, 0.0) * np.float32(gain), (0, 0), blur_sigma_px).astype(np.float64)
    light = np.where(light < 0.6, light, 0.6 + 0.4 * (1.0 - np.exp(-(light - 0.6) / 0.4)))
    variance = light / FULL_WELL_ELECTRONS + (READ_NOISE_ELECTRONS / FULL_WELL_ELECTRONS) ** 2
    light = np.clip(light + rng.normal(size=light.shape) * np.sqrt(variance), 0.0, 1.0)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(srgb[..., ::-1] * 255.0 + 0.5).astype(np.uint8)
