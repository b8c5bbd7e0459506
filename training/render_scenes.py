"""Labelled training images from conetl's renderer: random road scenes with exact, occlusion-aware boxes.

    python -m training.render_scenes OUT --count 400 --seed 1

writes OUT/images/*.jpg and OUT/labels/*.txt: `class cx cy w h foot_x foot_y tip_x tip_y`, shares of width and height. The foot
is the centre of the base on the ground, the tip the top of the body, both also where something hides them; signs and boards have
neither (nan). Equal seeds give equal images; images that are there already are kept. The layouts are random: the scenes of
the sample drives and of `conetl simulate --world mixed` are not among them.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.learning.classes import CLASSES
from conetl.model.rig import Camera
from conetl.reports.camera_images import jpeg
from conetl.simulation.meshes import Mesh
from conetl.simulation.parts import BUILDERS, CLASSED_KINDS, cone_parts, true_shape
from conetl.simulation.scenario import Colour, Cone, Road, RoadMarking, RoadObject, World, street_markings
from conetl.simulation.scene import build_scene, develop, exposure_gain, load_mitsuba, render

VIEWS_PER_SCENE = 3
MIN_HEIGHT_PX = 7.0
MIN_VISIBLE_SHARE = 0.25
#: Orange, red-orange, lime, yellow, blue: bodies of cones.
COLOURS = ((0.95, 0.36, 0.08), (0.88, 0.20, 0.07), (0.72, 0.88, 0.10), (0.95, 0.75, 0.05), (0.10, 0.25, 0.80))
COLOUR_SHARES = (0.42, 0.38, 0.1, 0.06, 0.04)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=400, help="number of images")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in ("images", "labels"):
        (options.out / name).mkdir(parents=True, exist_ok=True)
    started, boxes = time.monotonic(), 0
    for scene_number in range(-(-options.count // VIEWS_PER_SCENE)):
        boxes += render_scene_views(options.out, options.seed, scene_number)
        seconds = time.monotonic() - started
        print(f"{(scene_number + 1) * VIEWS_PER_SCENE} pictures, {boxes} new boxes, {seconds:.0f} s", flush=True)


def render_scene_views(out: Path, seed: int, scene_number: int) -> int:
    """All images of one random scene; returns how many boxes were written."""
    names = [f"render_{seed:03d}_{scene_number:05d}_{view}" for view in range(VIEWS_PER_SCENE)]
    if all((out / "images" / f"{name}.jpg").exists() for name in names):
        return 0
    rng = np.random.default_rng([seed, scene_number])
    world = random_world(rng)
    scene = build_scene(world)
    written = 0
    for view, name in enumerate(names):
        view_rng = np.random.default_rng([seed, scene_number, view])
        camera, pose = random_camera(view_rng)
        radiance = render(
            scene,
            camera,
            pose,
            samples_per_pixel=int(view_rng.choice([6, 9, 12])),
            seed=int(view_rng.integers(1 << 30)),
            fast=True,
        )
        grey = radiance[radiance.shape[0] // 3 :].mean(axis=(0, 1))
        radiance *= (grey.mean() / grey) ** np.float32(view_rng.uniform(0.2, 1.0))  # white balance, more or less
        gain = exposure_gain(radiance, float(np.exp(view_rng.normal(0.1, 0.35))))
        picture = develop(radiance, gain, view_rng, blur_sigma_px=float(view_rng.uniform(0.3, 0.9)))
        boxes = np.array(object_boxes(scene, world, camera, pose)).reshape(-1, 9)
        written += len(boxes)
        shares = (boxes[:, 1:].reshape(-1, 2) / [camera.width_px, camera.height_px]).reshape(-1, 8)
        lines = "".join(
            f"{number:.0f} {(a + c) / 2:.6f} {(b + d) / 2:.6f} {c - a:.6f} {d - b:.6f} "
            + " ".join(f"{p:.6f}" for p in points)
            + "\n"
            for number, (a, b, c, d, *points) in zip(boxes[:, 0], shares, strict=True)
        )
        (out / "labels" / f"{name}.txt").write_text(lines)
        partial = out / "images" / f".{name}.part"  # the label is there before its image appears
        partial.write_bytes(jpeg(picture, int(view_rng.integers(60, 96))))
        partial.rename(out / "images" / f"{name}.jpg")
    return written


class Labelled(NamedTuple):
    """What gets a box."""

    category: str
    meshes: list[Mesh]
    """What the box holds."""
    ends: np.ndarray
    """(2, 3) foot and tip in the road frame; NaN for what has none."""


def labelled_things(world: World, eye: np.ndarray) -> Iterator[Labelled]:
    """All objects of a world that have a class, as seen from `eye` (3,): signs and boards only from their front."""
    for number, cone in enumerate(world.cones):
        base, body = cone_parts(cone, 1000 * world.texture_seed + number)
        foot = base.mesh.vertices.mean(axis=0) if cone.fallen else np.array([cone.x_m, cone.y_m, 0.0])
        fewer = body.mesh._replace(vertices=body.mesh.vertices[::3])
        yield Labelled("traffic_cone", [base.mesh, fewer], np.array([foot, body.mesh.vertices[-1]]))
    for number, item in enumerate(world.objects):
        parts = BUILDERS[item.kind](item, 1000 * world.texture_seed + 500 + number)
        if item.kind in ("round_sign", "triangle_sign"):  # a post first, then the plate
            category, plates = "traffic_sign", parts[1:2]
        elif item.kind in CLASSED_KINDS:
            shape = true_shape(item)
            category, plates = shape.category, parts[:1] if shape.foot_m > 0 else []
        else:
            continue
        if not plates:
            ends = np.array([(item.x_m, item.y_m, 0.0), (item.x_m, item.y_m, item.height_m)])
            yield Labelled(category, [part.mesh for part in parts], ends)
            continue
        plate = plates[0].mesh
        towards = eye - plate.vertices.mean(axis=0)
        if -(towards[:2] @ (math.cos(item.yaw_rad), math.sin(item.yaw_rad))) > 0.2 * np.linalg.norm(towards):
            yield Labelled(category, [plate], np.full((2, 3), np.nan))


def object_boxes(scene: Any, world: World, camera: Camera, road_SE3_camera: np.ndarray) -> list[tuple[float, ...]]:
    """[class, x0, y0, x1, y1, foot x, foot y, tip x, tip y] from the edge of the image, in pixels, an object.

    The box holds the visible part. A vertex is hidden where the ray to it meets something that is not the object itself.
    """
    mi = load_mitsuba()
    eye = road_SE3_camera[:3, 3]

    def project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        local = (points - eye) @ road_SE3_camera[:3, :3]
        return local[:, :2] / local[:, 2:] * camera.fx_px + [camera.cx_px + 0.5, camera.cy_px + 0.5], local[:, 2]

    boxes: list[tuple[float, ...]] = []
    for thing in labelled_things(world, eye):
        points = np.vstack([mesh.vertices for mesh in thing.meshes])
        pixels, depth = project(points)
        inside = ((pixels >= 0) & (pixels <= [camera.width_px, camera.height_px])).all(axis=1)
        if (depth < 0.5).any() or not inside.any():
            continue
        centre = points.mean(axis=0)
        reach = np.linalg.norm(points - centre, axis=1).max() * 1.02
        seen = np.array(inside)
        for k in np.flatnonzero(inside):
            step = points[k] - eye
            far = float(np.linalg.norm(step))
            hit = scene.ray_intersect(mi.Ray3f(eye.tolist(), (step / far).tolist()))
            if hit.is_valid() and float(hit.t) < far - 0.01:
                place = eye + step / far * float(hit.t)
                seen[k] = np.linalg.norm(place - centre) < reach
        if seen.mean() < MIN_VISIBLE_SHARE:
            continue
        low, high = pixels[seen].min(axis=0), pixels[seen].max(axis=0)
        if high[1] - low[1] >= MIN_HEIGHT_PX:
            ends = project(thing.ends)[0]
            boxes.append((CLASSES.index(thing.category), *low.tolist(), *high.tolist(), *ends.reshape(-1).tolist()))
    return boxes


def random_camera(rng: np.random.Generator) -> tuple[Camera, np.ndarray]:
    """A camera somewhere on the first metres of the road, looking along it."""
    width = int(rng.choice([640, 736, 960], p=[0.55, 0.25, 0.2]))
    f_px, cx_px, cy_px = width * rng.uniform(0.6, 1.05), width / 2 + rng.uniform(-15, 15), 160 + rng.uniform(-25, 10)
    camera = Camera(width_px=width, height_px=320, fx_px=f_px, fy_px=f_px, cx_px=cx_px, cy_px=cy_px)
    yaw, pitch, roll = rng.normal(0.0, 0.10), rng.uniform(-0.02, 0.13), rng.normal(0.0, 0.015)
    forward = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)])
    right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    down = np.cross(forward, right)
    turned = math.cos(roll) * right + math.sin(roll) * down, math.cos(roll) * down - math.sin(roll) * right
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([*turned, forward])
    pose[:3, 3] = (rng.uniform(-6.0, 2.0), rng.uniform(-3.0, 1.5), rng.uniform(1.1, 2.2))
    return camera, pose


def random_world(rng: np.random.Generator) -> World:
    """0 to 10 cones up to 40 m ahead, and things that are not cones in most scenes."""
    road = Road(
        right_m=rng.uniform(-6.5, -4.0), left_m=rng.uniform(2.5, 5.5), start_m=-30.0, end_m=110.0,
        markings=_random_markings(rng),
        pavement_width_m=float(rng.choice([0.0, rng.uniform(1.2, 3.5)])),
        verge=_near(rng, ((0.30, 0.37, 0.16), (0.45, 0.42, 0.28), (0.38, 0.30, 0.22), (0.5, 0.5, 0.48))[rng.integers(4)]),
        asphalt=rng.uniform(0.28, 0.62),
    )  # fmt: skip
    cones = _random_cones(rng)
    overcast = rng.random() < 0.3
    return World(
        cones=tuple(cones), objects=(*_random_objects(rng, road), *_random_devices(rng, road), *_things_before(cones, rng)),
        sun_elevation_deg=rng.uniform(8, 70),
        sun_azimuth_deg=rng.uniform(-180, 180), turbidity=rng.uniform(2.0, 8.0), sun_scale=0.0 if overcast else 1.0, road=road,
        texture_seed=int(rng.integers(1000, 1 << 20)),
    )  # fmt: skip


def _random_markings(rng: np.random.Generator) -> tuple[RoadMarking, ...]:
    centre_line = bool(rng.random() < 0.8)
    edges = tuple(y for y in (rng.uniform(-3.9, -2.9), rng.uniform(2.2, 3.4)) if rng.random() < 0.7)
    return street_markings(-30.0, 110.0, edges, centre_line=centre_line)


def _near(rng: np.random.Generator, colour: Colour, spread: float = 0.06) -> Colour:
    r, g, b = np.clip(np.array(colour) + rng.normal(0.0, spread, 3), 0.01, 0.98)
    return float(r), float(g), float(b)


def _random_cones(rng: np.random.Generator) -> list[Cone]:
    count = int(rng.choice(11, p=np.array([2, 1, 1, 2, 2, 2, 2, 2, 2, 1, 1]) / 18))
    in_row = rng.random() < 0.6
    start, slope, gap = (rng.uniform(1, 10), rng.uniform(-4.5, 3.0)), rng.uniform(-0.12, 0.12), rng.uniform(2.0, 6.0)
    height, colour = (
        float(rng.choice([0.3, 0.5, 0.7, 0.75, 1.0, 1.2])),
        COLOURS[int(rng.choice(len(COLOURS), p=COLOUR_SHARES))],
    )
    slimness = 1.0 if rng.random() < 0.6 else float(rng.uniform(0.45, 1.0))  # channelizers are slim
    plate = ((0.13, 0.13, 0.13), (0.13, 0.13, 0.13), (0.75, 0.25, 0.08))[rng.integers(3)]
    cones: list[Cone] = []
    for k in range(count):
        if in_row:
            x, y = start[0] + gap * k, start[1] + slope * gap * k + rng.normal(0.0, 0.15)
        else:
            x, y = rng.uniform(1.0, 36.0) * rng.uniform(0.3, 1.0), rng.uniform(-6.0, 4.5)
        if any(math.hypot(x - c.x_m, y - c.y_m) < 0.8 for c in cones) or x > 38.0:
            continue
        cone_height = height if rng.random() < 0.8 else float(rng.uniform(0.3, 1.0))
        cones.append(
            Cone(
                f"R{k}", x, y, cone_height, yaw_rad=rng.uniform(-math.pi, math.pi), tilt_rad=abs(rng.normal(0.0, 0.04)),
                tilt_azimuth_rad=rng.uniform(-math.pi, math.pi), colour=_near(rng, colour, 0.035),
                band_count=int(rng.choice([0, 1, 2], p=[0.2, 0.3, 0.5])), dirt=float(rng.beta(1.2, 2.5)),
                fallen=bool(rng.random() < 0.08), plate_colour=_near(rng, plate, 0.03), slimness=slimness,
            )
        )  # fmt: skip
    return cones


def _random_devices(rng: np.random.Generator, road: Road) -> list[RoadObject]:
    """Rows of one kind of device on the road, barricades, boards and signs beside it; their sizes as on real roads."""
    objects: list[RoadObject] = []
    orange, yellow, lime, white = (0.93, 0.40, 0.08), (0.95, 0.78, 0.1), (0.7, 0.85, 0.15), (0.85, 0.85, 0.83)

    def add(kind: str, x: float, y: float, height: float, colour: Colour, width: float) -> None:
        turn = rng.normal(0.0, 0.25) + (math.pi if rng.random() < 0.15 else 0.0)
        objects.append(RoadObject(kind, x, y, turn, height, _near(rng, colour, 0.05), width))

    for _ in range(int(rng.integers(0, 3))):
        kind = str(rng.choice(("drum", "vertical_panel", "tubular_marker"), p=(0.25, 0.25, 0.5)))
        colour = (orange, yellow, lime, white)[int(rng.choice(4, p=(0.7, 0.14, 0.08, 0.08)))]
        height = rng.uniform(*{"drum": (0.8, 1.15), "vertical_panel": (0.8, 1.4), "tubular_marker": (0.45, 1.2)}[kind])
        start, slope, gap = (
            (rng.uniform(1, 12), rng.uniform(-4.5, 3.0)),
            rng.uniform(-0.12, 0.12),
            rng.uniform(1.5, 6.0),
        )
        for k in range(int(rng.integers(1, 7))):
            y = start[1] + slope * gap * k + rng.normal(0.0, 0.12)
            add(
                kind,
                start[0] + gap * k,
                y,
                height,
                colour if kind == "tubular_marker" else orange,
                rng.uniform(0.2, 0.45),
            )
    for _ in range(int(rng.choice((0, 1, 2), p=(0.5, 0.35, 0.15)))):
        place = rng.uniform(5, 35), rng.uniform(road.right_m, road.left_m)
        add(
            "type_3",
            *place,
            rng.uniform(1.0, 1.6),
            orange if rng.random() < 0.8 else (0.75, 0.1, 0.08),
            rng.uniform(1.0, 2.2),
        )
    kinds = ("diamond", "work_triangle", "arrow_board", "speed_disc", "mandatory_disc", "warning_triangle", "rectangle")
    # Both triangles more often than the rest: they differ by their figure alone.
    for kind in rng.choice(kinds, int(rng.integers(0, 7)), p=(0.14, 0.25, 0.1, 0.12, 0.09, 0.18, 0.12)).tolist():
        y = road.right_m - rng.uniform(0.3, 2.5) if rng.random() < 0.6 else road.left_m + rng.uniform(0.3, 2.5)
        width = rng.uniform(1.8, 2.6) if kind == "arrow_board" else rng.uniform(0.5, 1.2)
        lowest = width * (1.25 if kind == "rectangle" else 1.0) + 0.3
        add(kind, rng.uniform(4, 40), y, rng.uniform(lowest, max(3.2, lowest + 0.2)), orange, width)
    return objects


def _things_before(cones: list[Cone], rng: np.random.Generator) -> list[RoadObject]:
    """Posts, bollards and boards between the camera and some of the cones, so that they hide a part of them."""
    objects = []
    for cone in cones:
        if rng.random() > 0.3 or cone.x_m < 5.0:
            continue
        kind = str(rng.choice(("bollard", "post", "barrier_post", "hydrant", "drum"), p=(0.4, 0.3, 0.15, 0.05, 0.1)))
        before, beside = rng.uniform(0.3, 1.6), rng.normal(0.0, 0.22)
        away = math.atan2(cone.y_m, cone.x_m + 3.0)  # the camera stands somewhere about (-3, 0)
        x = cone.x_m - before * math.cos(away) - beside * math.sin(away)
        y = cone.y_m - before * math.sin(away) + beside * math.cos(away)
        shade = float(rng.uniform(0.1, 0.7))
        height = rng.uniform(0.5, 1.0) if kind == "hydrant" else rng.uniform(0.7, 1.3)
        colour = (0.75, 0.12, 0.08) if rng.random() < 0.4 else (shade, shade, shade)
        objects.append(RoadObject(kind, x, y, rng.uniform(-0.4, 0.4), height, colour))
    return objects


def _random_objects(rng: np.random.Generator, road: Road) -> list[RoadObject]:
    objects: list[RoadObject] = []
    orange, red, white = (0.93, 0.42, 0.08), (0.75, 0.10, 0.08), (0.85, 0.85, 0.85)

    def beside(outer_m: float) -> float:
        return (
            road.right_m - rng.uniform(0.3, outer_m) if rng.random() < 0.6 else road.left_m + rng.uniform(0.3, outer_m)
        )

    def add(
        kind: str, share: float, most: int, heights: tuple[float, float], colours: tuple[Colour, ...], on_road: bool
    ) -> None:
        if rng.random() > share:
            return
        for _ in range(int(rng.integers(1, most + 1))):
            colour = _near(rng, colours[rng.integers(len(colours))])
            y = rng.uniform(road.right_m, road.left_m) if on_road and rng.random() < 0.5 else beside(3.0)
            yaw = rng.uniform(-0.3, 0.3) + (math.pi if rng.random() < 0.4 else 0.0)
            objects.append(RoadObject(kind, rng.uniform(5.0, 45.0), y, yaw, rng.uniform(*heights), colour))

    grey = (0.55, 0.56, 0.57)
    add("bollard", 0.5, 6, (0.7, 1.1), (red,), True)
    add("barrier_post", 0.4, 5, (0.9, 1.3), (red,), True)
    add("round_sign", 0.5, 3, (1.8, 2.8), (grey,), False)
    add("triangle_sign", 0.4, 2, (1.6, 2.7), (grey,), False)
    add("post", 0.5, 6, (0.5, 4.0), (grey, red, white, orange), False)
    add("bin", 0.4, 3, (0.6, 1.2), (grey, orange, (0.15, 0.2, 0.15), red), False)
    add("hydrant", 0.3, 2, (0.6, 0.9), (red, orange, (0.8, 0.7, 0.1)), False)
    add("worker", 0.4, 3, (1.6, 1.95), (orange, (0.8, 0.85, 0.1), red), True)
    add("drum", 0.3, 4, (0.8, 1.1), (orange, red), True)
    for _ in range(int(rng.choice([0, 1, 2], p=[0.5, 0.35, 0.15]))):
        side = rng.choice([road.right_m + 1.3, road.left_m - 1.2])
        objects.append(
            RoadObject(
                "van", rng.uniform(14, 45), side, rng.uniform(-0.1, 0.1) + math.pi * rng.integers(2), rng.uniform(1.9, 2.6),
                _near(rng, (orange, white, red, grey)[rng.integers(4)]), rng.uniform(4.4, 5.8),
            )
        )  # fmt: skip
    for side, edge in ((-1.0, road.right_m), (1.0, road.left_m)):
        x = rng.uniform(-10, 10)
        while x < 95.0 and rng.random() < 0.85:
            length, far = rng.uniform(12, 30), rng.uniform(9, 16)
            wall = _near(
                rng, ((0.78, 0.72, 0.6), (0.62, 0.45, 0.38), (0.7, 0.7, 0.7), (0.75, 0.4, 0.25))[rng.integers(4)]
            )
            x += length / 2
            objects.append(RoadObject("house", x, edge + side * far, 0.0, rng.uniform(3.5, 8.0), wall, length))
            x += length / 2 + rng.uniform(2, 12)
        green = _near(rng, (0.18, 0.28, 0.12), 0.03)
        if rng.random() < 0.6:
            x, y = rng.uniform(10, 40), edge + side * rng.uniform(3.5, 5)
            objects.append(RoadObject("hedge", x, y, 0.0, rng.uniform(0.8, 2.4), green, 50.0))
        for _ in range(int(rng.integers(0, 4))):
            y = edge + side * rng.uniform(3.4, 7)
            objects.append(RoadObject("tree", rng.uniform(3, 80), y, 0.0, rng.uniform(4.5, 9), green))
    return objects


if __name__ == "__main__":
    main()
