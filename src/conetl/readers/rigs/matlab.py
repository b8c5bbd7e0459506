"""MATLAB's `stereoParameters` as a structure, in JSON (`jsonencode(toStruct(stereoParams))`) or a `.mat` file.

MATLAB differs from OpenCV in three points (MathWorks, stereoParametersToOpenCV): its first pixel is (1, 1), so its principal
point is ours plus one; `IntrinsicMatrix` is the transposed camera matrix ([fx 0 0; s fy 0; cx cy 1]; `K` of newer versions is
not); and points are rows, `[x y z] * RotationOfCamera2 + TranslationOfCamera2`, so that rotation is transposed, too
(`PoseCamera2` of newer versions is not). Lengths are in `WorldUnits`, usually millimetres.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.documents import MAX_DEPTH, MAX_JSON_BYTES, library_errors
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import Camera, Rig
from conetl.readers.rigs.common import Node, Size

#: Added to a camera matrix: MATLAB's first pixel is (1, 1), ours (0, 0).
_ORIGIN = np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 0, 0]])
#: Types of data elements in .mat files, and classes of matrices.
_MATRIX, _COMPRESSED = 14, 15
_NUMBER_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCTURE, _TEXT, _NUMERIC = 2, 4, range(6, 16)
_HOW = "In MATLAB: s = toStruct(stereoParams); then save('stereo.mat', 's', '-v7') or writelines(jsonencode(s), 'stereo.json')"


def read_matlab_rig(file: Node, *, image_size: Size | None = None) -> Rig:
    """Raw rig of camera 1 (left) and camera 2 (right); image_size: where the file has none. Raises InputError."""
    inner = (value for value in file.value.values() if isinstance(value, Mapping) and "CameraParameters1" in value)
    found = file._replace(value=file.value if "CameraParameters1" in file.value else next(inner, None))
    left, right = (_camera(found.at(f"CameraParameters{number}"), image_size) for number in (1, 2))
    key, right_R_left, t = _relative(found)
    return key.stereo_rig("matlab", left, right, se3.se3(right_R_left, t), _unit(found.value))


def _relative(found: Node) -> tuple[Node, Floats, Floats]:
    """Where the pose is, rotation and translation of `p_right = R p_left + t`, in the file's unit."""
    if _given(found.get("RotationOfCamera2")):
        rotation = found.at("RotationOfCamera2").numbers((3, 3)).T
        both = found._replace(key="RotationOfCamera2, TranslationOfCamera2")
        return both, rotation, found.at("TranslationOfCamera2").numbers((3,))
    pose = found.at("PoseCamera2")
    if _given(pose.get("A")):
        a = pose.at("A").numbers((4, 4))
        return pose, a[:3, :3], a[:3, 3]
    return pose, pose.at("R").numbers((3, 3)), pose.at("Translation").numbers((3,))


def _camera(camera: Node, image_size: Size | None) -> Camera:
    name = "K" if _given(camera.get("K")) else "IntrinsicMatrix"
    matrix = camera.at(name)
    k = matrix.numbers((3, 3)) if name == "K" else matrix.numbers((3, 3)).T
    if k[0, 2] == 0.0 and k[1, 2] == 0.0 and k[2, 0] != 0.0:
        raise matrix.bad("is transposed: K has the principal point in its last column, IntrinsicMatrix in its last row")
    key, tangential = camera.at("RadialDistortion"), np.zeros(2)
    radial = key.numbers()
    if radial.size not in (2, 3):
        raise key.bad(f"must be 2 or 3 numbers, found {radial.size}")
    if _given(camera.get("TangentialDistortion")):
        tangential = camera.at("TangentialDistortion").numbers((2,))
    lens = key._replace(value=[*radial[:2], *tangential, radial[2] if radial.size == 3 else 0.0]).lens()
    if image_size is None:
        size = camera.get("ImageSize")
        if not _given(size):
            raise size.bad(
                "is missing or empty; make a rig.yaml from it: conetl rig convert with --image-size 6000x4000"
            )
        rows, columns = size.size()
        image_size = columns, rows
    return matrix._replace(value=k - _ORIGIN).camera(image_size, lens)


def _given(node: Node) -> bool:
    """True where a key exists and not empty (MATLAB writes [] for unknown values)."""
    return node.value is not None and (not hasattr(node.value, "__len__") or len(node.value) > 0)


def _unit(found: Mapping[str, Any]) -> str:
    inner = found.get("CameraParameters1")
    units = (found.get("WorldUnits"), inner.get("WorldUnits") if isinstance(inner, Mapping) else None)
    return next((unit for unit in units if isinstance(unit, str) and unit), "mm")  # MATLAB's own default


def is_mat(data: bytes) -> bool:
    """True for the bytes of a .mat file."""
    return data.startswith(b"MATLAB ") or data[124:128] in (b"\0\1IM", b"\1\0MI", b"\0\2IM", b"\2\0MI")


def variables_of(path: Path, data: bytes) -> Mapping[str, Any]:
    """Variables of a .mat file, structures as dictionaries. Raises InputError."""
    if data[124:128] in (b"\0\2IM", b"\2\0MI"):
        raise InputError(f"{path}: this is a version 7.3 file (HDF5), which is not read. {_HOW}")
    not_mat = f"{path}: this is not a .mat file of version 5 to 7, or not all of it"
    with library_errors(not_mat, ValueError, KeyError, struct.error, zlib.error, hint=f". {_HOW}"):
        variables = _variables(data)
    if not variables:
        raise InputError(f"{path}: only MATLAB itself can read the objects in this file. {_HOW}")
    return variables


def _variables(data: bytes) -> dict[str, Any]:
    """Variables of a .mat file of version 5 to 7. Raises ValueError, KeyError, struct.error and zlib.error.

    MathWorks, MAT-File Format (2024), Level 5. Not by scipy's loadmat, which ends the process at some damaged files.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("its header is incomplete")
    found: dict[str, Any] = {}
    room = MAX_JSON_BYTES
    for kind, content in _elements(data[128:], order):
        parts: Iterable[tuple[int, bytes]] = [(kind, content)]
        if kind == _COMPRESSED:
            plain = zlib.decompressobj().decompress(content, room + 1)
            room -= len(plain)
            if room < 0:
                raise ValueError(f"expected at most {MAX_JSON_BYTES:,} bytes uncompressed")
            parts = _elements(plain, order)
        found.update(_matrix(part, order) for kind, part in parts if kind == _MATRIX)
    found.pop("", None)  # objects
    return found


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of the data elements one after another."""
    at = 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        start, end = at + 8, at + 8 + length
        if kind >> 16:  # a small element: its length is before its type
            start, end, kind = at + 4, at + 4 + (kind >> 16), kind & 0xFFFF
        if end > len(data):
            raise ValueError("it is truncated")
        yield kind, data[start:end]
        at = end if kind == _COMPRESSED else end + -end % 8


def _matrix(data: bytes, order: str, depth: int = 0) -> tuple[str, Any]:
    """Name and value: a dictionary, a text or an array of numbers without axes of length 1; None for other kinds."""
    if depth > MAX_DEPTH:
        raise ValueError("structures are nested too deeply")
    elements = _elements(data, order)
    head = [content for _, content in islice(elements, 3)]
    if len(head) < 3:
        return "", np.empty(0)
    (flags,) = struct.unpack(f"{order}I", head[0][:4])
    name = head[2].decode()
    if flags & 0xFF == _STRUCTURE:
        (_, size), (_, names) = islice(elements, 2)
        width = max(1, *struct.unpack(f"{order}i", size))
        keys = [names[i : i + width].split(b"\0")[0].decode() for i in range(0, len(names), width)]
        values = [_matrix(content, order, depth + 1)[1] for _, content in elements]
        return name, dict(zip(keys, values, strict=True)) if len(keys) == len(values) else None
    if flags & 0xFF not in (_TEXT, *_NUMERIC):
        return name if head[1] else "", None
    ((kind, content),) = islice(elements, 1)
    if flags & 0xFF == _TEXT:
        return name, content.decode({4: "utf-16", 17: "utf-16", 18: "utf-32"}.get(kind, "utf-8"))
    array = np.frombuffer(content, f"{order}{_NUMBER_TYPES[kind]}").astype(np.float64)
    return name, array.reshape(np.frombuffer(head[1], f"{order}i4"), order="F").squeeze()
