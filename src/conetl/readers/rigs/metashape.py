"""Cameras of an Agisoft Metashape project (File > Export > Export Cameras, XML) with a multi-camera system.

Metashape's frame camera (Appendix C of its manual) differs from OpenCV's in three points: (cx, cy) is an offset from the centre
of the image, whose first pixel's centre is (0.5, 0.5); fx is f + b1, with b2 the skew; and p1, p2 are OpenCV's p2, p1. `rotation`
and `location` of a sensor with `master_id` are its pose in the master camera, `p_master = R p_slave + t`, in x right, y down,
z forward. The chunk's own unit need not be the metre: with a scale in the file, the unit of `location` has to be confirmed.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from conetl.files.documents import shown
from conetl.geometry import pose as se3
from conetl.model.errors import InputError
from conetl.model.rig import Camera, Lens, Rig
from conetl.readers.rigs.common import Node, Pair, choose_pair

_FISHEYES = ("fisheye", "equidistant_fisheye")
_NUMBERS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
_SCALE_SHARE = 1e-6


def read_metashape_rig(file: Node, *, pair: Pair | None = None) -> Rig:
    """Raw rig of two sensors; pair: their labels or numbers. Raises InputError."""
    path, root = file.path, file.value
    chunks = root.findall("chunk")
    if len(chunks) != 1:
        raise InputError(f"{path}: expected the export of one chunk, found {len(chunks)}")
    sensors = {sensor.get("id", ""): sensor for sensor in chunks[0].findall("sensors/sensor")}
    labels = [sensor.get("label", "") for sensor in sensors.values()]
    names = {
        number: label if label and labels.count(label) == 1 else number
        for number, label in zip(sensors, labels, strict=True)
    }
    chosen = None if pair is None else tuple(names.get(name, name) for name in pair)
    left, right = choose_pair(path, [*names.values()], chosen)
    _require_unit(file, chunks[0])
    poses = {}
    for number, sensor in sensors.items():
        master = sensor.get("master_id", number)
        if master != number and names[number] in (left, right):
            turn = _of_sensor(path, sensor, "rotation", names[number], (3, 3)).rotation()
            shift = _of_sensor(path, sensor, "location", names[number], (3,)).numbers()
            poses[master, number] = se3.se3(turn, shift)  # master_SE3_sensor
    numbers_of = {name: number for number, name in names.items()}
    right_SE3_left = se3.find_pose(poses, numbers_of[right], numbers_of[left])
    if right_SE3_left is None:
        raise InputError(
            f"{path}: the sensors {shown(left)} and {shown(right)} are not in one multi-camera system: neither is the master "
            "(master_id) of the other, nor do they have the same one"
        )
    left_camera, right_camera = (_camera(path, sensors[numbers_of[name]], name) for name in (left, right))
    return file._replace(key=f"{right}.location").stereo_rig("metashape", left_camera, right_camera, right_SE3_left)


def _require_unit(file: Node, chunk: Element) -> None:
    """Raise InputError where the unit of `location` is known only to the user, who does not state it."""
    places = ("transform/scale", "components/component/transform/scale") if file.length_unit is None else ()
    for scale in (scale for place in places for scale in chunk.findall(place)):
        value = Node(file.path, (scale.text or "").strip(), "transform.scale").number()
        if abs(value - 1.0) > _SCALE_SHARE:
            raise Node(file.path, None, "location").bad(
                f"may be in the chunk's own unit, which is {value:g} m. If Slave Offset in Camera Calibration shows the same "
                "numbers in metres, add --unit m to conetl rig convert"
            )


def _of_sensor(path: Path, sensor: Element, key: str, name: str, shape: tuple[int, ...]) -> Node:
    node = Node(path, sensor.findtext(key), f"{name}.{key}")
    if node.value is None:
        raise node.bad("is missing: align the project with the relative position of the slave cameras")
    count = int(np.prod(shape))
    return node._replace(value=node._replace(value=node.value.split()[: count + 1]).numbers((count,)).reshape(shape))


def _camera(path: Path, sensor: Element, name: str) -> Camera:
    node = Node(path, None, f"{name}.calibration")
    found = sorted(sensor.findall("calibration"), key=lambda c: c.get("class") != "adjusted")
    if not found:
        raise node.bad("is missing: calibrate the camera (Align Photos)")
    calibration = found[0]
    kind = calibration.get("type", "frame")
    if kind != "frame" and kind not in _FISHEYES:
        raise node.get("type").bad(f"{shown(kind)} is not supported; known: frame, {', '.join(_FISHEYES)}")
    unknown = {child.tag for child in calibration} - {*_NUMBERS, "resolution", "date"}
    if unknown:
        raise node.bad(f"has {shown(sorted(unknown))}, which conetl does not know")
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    attributes = {} if resolution is None else resolution.attrib
    size = node.get("resolution")._replace(value=[attributes.get("width", ""), attributes.get("height", "")]).size()
    values = node._replace(value={key: (calibration.findtext(key) or "0").strip() for key in _NUMBERS})
    v = {key: values.at(key).number() for key in _NUMBERS}
    k = np.array([
        [v["f"] + v["b1"], v["b2"], size[0] / 2 + v["cx"] - 0.5], [0.0, v["f"], size[1] / 2 + v["cy"] - 0.5], [0.0, 0.0, 1.0],
    ])  # fmt: skip
    return node._replace(value=k).camera(size, _lens(node, v, fisheye=kind in _FISHEYES))


def _lens(node: Node, v: dict[str, float], *, fisheye: bool) -> Lens:
    for key in ("p1", "p2", "p3", "p4") if fisheye else ("k4", "p3", "p4"):
        if v[key] != 0.0:
            text = f"is {v[key]:g}, which conetl's lenses do not have; calibrate with {key} fixed to 0"
            raise node.get(key).bad(text)
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p2", "p1", "k3")
    return node.get("k1")._replace(value=[v[name] for name in names]).lens(fisheye=fisheye)
