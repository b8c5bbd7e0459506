"""Frame pairs, for all drive readers: hash and check images, reject bad pairs and make a drive of the others."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from conetl.files.documents import read_table_bytes
from conetl.files.storage import fetch, remember
from conetl.geometry.rectification import stored_camera
from conetl.geometry.small_arrays import nearest_index
from conetl.model.drive import Drive, FramePair, Pose
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.image_headers import inspect_image
from conetl.perception.images import ImageFileError, check_image_bytes, check_image_ends, read_bytes
from conetl.readers.drives.camera_files import Files
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.trajectories.times import misplaced, wrong_clocks

#: The pose of a standing vehicle scatters by less.
MOVED_M = 0.5


class ContentHash:
    """Hash of everything that was read of a drive: equal content has an equal hash, wherever the folder is, in any order."""

    def __init__(self, *, headers_only: bool = False) -> None:
        """headers_only: only the first and last bytes of images are checked, and images are not part of the hash."""
        self.headers_only = headers_only
        self._files: dict[str, bytes] = {}
        self.read_ahead: dict[Path, bytes] = {}
        """Images that were read before their turn, for their size."""

    def add(self, name: str, data: bytes) -> str:
        """Add one file that was read. Returns its SHA-256. Names are posix paths relative to the drive folder."""
        found = hashlib.sha256(data)
        self._files[name] = found.digest()
        return found.hexdigest()

    def add_file(self, name: str, path: Path) -> None:
        """Add a file of any size."""
        with path.open("rb") as file:
            self._files[name] = hashlib.file_digest(file, "sha256").digest()

    def text(self, folder: Path, name: str, remedy: str) -> str:
        """Text of a required file of the drive, which is added. Raises InputError where it is missing; remedy: what to do."""
        if not (folder / name).is_file():
            raise InputError(f"{folder}: {name} is missing; {remedy}")
        data = read_table_bytes(folder / name)
        self.add(name, data)
        return data.decode("utf-8-sig", errors="replace")

    def hexdigest(self) -> str:
        """SHA-256 over sorted names and the hashes of their bytes."""
        total = hashlib.sha256()
        for name in sorted(self._files):
            total.update(name.encode() + b"\0" + self._files[name])
        return total.hexdigest()


class Source(NamedTuple):
    """A drive that is being read."""

    path: Path
    """As the user named it; it may be a link."""
    root: Path
    """The folder or file itself."""
    settings: DriveYaml
    content: ContentHash
    map_srid: int | None = None
    """EPSG code of the map, where it is stated."""
    images_folder: Path | None = None
    """Where the images of a bag are unpacked to."""
    files: Files | None = None
    """What the format's `scan` found."""


class ImageFile(NamedTuple):
    """One image of a drive."""

    path: Path
    sha256: str
    """SHA-256 of its bytes; empty where only its header was read."""


class PairError(Exception):
    """Why one frame pair cannot be used."""

    def __init__(self, reason: RejectionReason, detail: str, **payload: Any) -> None:
        super().__init__(detail)
        self.reason, self.payload = reason, payload

    def rejection(self, record: str, frame_index: int) -> Rejection:
        """The rejection of the pair."""
        return Rejection(
            step="frames", reason=self.reason, record=record, detail=str(self),
            payload={"frame_index": frame_index, **self.payload},
        )  # fmt: skip


_Key = TypeVar("_Key", int, str)
_PAIRS_AT_ONCE = 8


def images_ahead(
    keys: Sequence[_Key],
    left: Mapping[_Key, Sequence[Path]],
    right: Mapping[_Key, Sequence[Path]],
    content: ContentHash,
) -> Iterator[_Key]:
    """The same keys of frame pairs; their images in object storage are requested for some pairs at a time."""
    for first in range(0, len(keys), _PAIRS_AT_ONCE):
        batch = keys[first : first + _PAIRS_AT_ONCE]
        if not content.headers_only:
            fetch([path for side in (left, right) for key in batch for path in side.get(key, ())], fresh=True)
        yield from batch


def check_images(
    left: Sequence[Path], right: Sequence[Path], rig: Rig, content: ContentHash, root: Path
) -> tuple[ImageFile, ImageFile]:
    """Both images of a pair, given all files that claim to be them.

    Header, size (of the images as stored: raw, where the rig was rectified) and end marker are checked, nothing is decoded.
    Both are read (for the content hash) before either is rejected, and their bytes stay in memory for the steps to come.
    Raises PairError.
    """
    problem: PairError | None = None
    good: list[ImageFile] = []
    for side, paths in zip(SIDES, (left, right), strict=True):
        camera = stored_camera(rig, side)
        if len(paths) != 1:
            names = ", ".join(path.name for path in paths)
            reason = RejectionReason.IMAGE_UNREADABLE if paths else RejectionReason.IMAGE_MISSING
            detail = (
                f"several {side} images claim this pair: {names}; keep one" if paths else f"there is no {side} image"
            )
            problem = problem or PairError(reason, detail, side=side)
            continue
        name, sha256 = paths[0].relative_to(root).as_posix(), ""
        try:
            if content.headers_only:
                check_image_ends(paths[0], name, (camera.width_px, camera.height_px))
            else:
                data = content.read_ahead.pop(paths[0], None) or read_bytes(paths[0], name)
                sha256 = content.add(name, data)
                remember(paths[0], sha256, data)
                check_image_bytes(data, name, (camera.width_px, camera.height_px))
        except ImageFileError as error:
            problem = problem or PairError(error.reason, str(error), side=side, path=name)
        good.append(ImageFile(paths[0], sha256))
    if problem is not None:
        raise problem
    return good[0], good[1]


def first_size(paths: Iterable[Path], content: ContentHash | None = None) -> tuple[int, int] | None:
    """Width and height of the first image whose header can be read; None where there is none.

    content: of the drive that is read; its image need not be read again.
    """
    for path in paths:
        with suppress(ImageFileError, ValueError):
            data = read_bytes(path)
            header = inspect_image(data)
            if content is not None:
                content.read_ahead[path] = data
            return header.width_px, header.height_px
    return None


#: Left and right image, time (UTC nanoseconds) and pose of the body of one frame pair.
UsablePair = tuple[ImageFile, ImageFile, int, Pose]


def drive_of_pairs(
    usable: Mapping[int, UsablePair], rejections: list[Rejection], expected: int, source: Source, rig: Rig, srid: int
) -> tuple[Drive, list[Rejection]]:
    """The drive of the usable pairs by frame_index, with its rejections. Raises InputError where no pair is left."""
    if not usable:
        first = f"; the first: {rejections[0].record}: {rejections[0].detail}" if rejections else ""
        raise InputError(f"{source.root}: none of {expected} frame pairs can be used{first}")
    pairs = tuple(
        FramePair(
            frame_index=number, left_path=str(left.path), right_path=str(right.path), captured_at_ns=captured, pose=pose,
            left_sha256=left.sha256, right_sha256=right.sha256,
        )
        for number, (left, right, captured, pose) in usable.items()
    )  # fmt: skip
    drive = Drive(
        drive_id=source.settings.id_of(source.root), source_path=str(source.root), rig=rig, map_srid=srid,
        content_sha256=source.content.hexdigest(), frame_pairs=pairs, expected_frame_count=expected,
    )  # fmt: skip
    return drive, rejections


def without_frozen(drive: Drive) -> tuple[Drive, list[Rejection]]:
    """The drive without the pairs of a camera that repeats an image while the vehicle moves: the same bytes, another position.

    What such an image shows is elsewhere. A vehicle that stands still may repeat its images: a simulator and some encoders do.
    """
    first: dict[Side, FramePair] = {}
    refused: list[Rejection] = []
    kept: list[FramePair] = []
    for pair in drive.frame_pairs:
        frozen = None
        for side in SIDES:
            image, since = pair.image(side), first.get(side)
            if since is None or not image[1] or since.image(side)[1] != image[1]:
                first[side] = pair
            elif math.dist(since.pose.map_t_body_m, pair.pose.map_t_body_m) > MOVED_M:
                frozen = side, since.frame_index
        if frozen is None:
            kept.append(pair)
            continue
        side, since_frame = frozen
        detail = (
            f"{Path(pair.image(side)[0]).name}: the {side} camera repeats its image of frame {since_frame}, although the vehicle "
            f"has moved by more than {MOVED_M} m: check the camera and its recorder"
        )
        problem = PairError(RejectionReason.IMAGE_FROZEN, detail, side=side, same_as=since_frame)
        refused.append(problem.rejection(f"frame pair {pair.frame_index}", pair.frame_index))
    return (drive.model_copy(update={"frame_pairs": tuple(kept)}), refused) if refused else (drive, [])


# --------------------------------------------------------------------------- images with times: EuRoC folders, bags, videos


class Image(NamedTuple):
    """One image of one camera."""

    stamp: int | str
    """UTC nanoseconds, or what is wrong with the stamp."""
    path: Path
    problem: PairError | None = None
    """What is wrong with the image, where it is known before the image is read."""


Couple = tuple[Image | None, Image | None]


def pair_by_stamp(left: Sequence[Image], right: Sequence[Image], tolerance_ns: int) -> list[Couple]:
    """Couples in the order of their recording; every image is in at most one, and alone where it has no partner.

    Two images belong together when each is the other's nearest in time and they are at most tolerance_ns apart. A left image
    without a usable stamp is paired with the right one after the last pair, if that is alone, so that both cost one rejection; a
    right one without a stamp is left out: its left partner is rejected as alone.
    """
    left, right = _by_true_clocks(left), _by_true_clocks(right)
    number = {image.stamp: i for i, image in reversed(list(enumerate(right))) if isinstance(image.stamp, int)}
    left_ns, right_ns = (
        np.array(sorted({p.stamp for p in side if isinstance(p.stamp, int)})) for side in (left, right)
    )
    partner_of: dict[int | str, int] = {}
    if len(left_ns) and len(right_ns):
        at = nearest_index(right_ns, left_ns)
        mutual = nearest_index(left_ns, right_ns)[at] == np.arange(len(left_ns))
        near = mutual & (np.abs(right_ns[at] - left_ns) <= tolerance_ns)
        partner_of = {t: number[u] for t, u in zip(left_ns[near].tolist(), right_ns[at[near]].tolist(), strict=True)}
    partners = [partner_of.pop(image.stamp, None) for image in left]  # of several left images of one time the first
    used = {partner for partner in partners if partner is not None}
    last = -1
    for i, image in enumerate(left):
        if isinstance(image.stamp, str) and last + 1 < len(right) and last + 1 not in used:
            partners[i] = last + 1
            used.add(last + 1)
        last = last if (partner := partners[i]) is None else partner
    couples: list[Couple] = [(p, None if i is None else right[i]) for p, i in zip(left, partners, strict=True)]
    # A right image that is alone comes before the first later one.
    latest = list(accumulate((-1 if (t := time_of(c)) is None else t for c in couples), max))
    alone = [time for time in right_ns.tolist() if number[time] not in used]
    couples += [(None, right[number[time]]) for time in alone]
    order = sorted(range(len(couples)), key=(latest + alone).__getitem__)
    return [couples[i] for i in order]


def _by_true_clocks(images: Sequence[Image]) -> list[Image]:
    """The same images; a stamp by a wrong clock counts as missing, so that its pair costs one rejection."""
    wrong = wrong_clocks({i: p.stamp for i, p in enumerate(images) if isinstance(p.stamp, int)})
    return [p._replace(stamp=f"the time {p.stamp} ns {wrong[i]}") if i in wrong else p for i, p in enumerate(images)]


def drive_of_couples(
    couples: Sequence[Couple],
    names: Mapping[Side, str],
    source: Source,
    rig: Rig,
    srid: int,
    pose_at: Callable[[int], Pose],
    hash_of: Callable[[Path], str | None] = lambda _: None,
) -> tuple[Drive, list[Rejection]]:
    """The drive and the rejections of its pairs. frame_index is the number of the couple, from 0.

    names: of the two image streams. pose_at: pose of the body at a time (UTC ns), raises PairError. hash_of: SHA-256 of images
    that were checked before, as of `ImageFile`; None of files that are to be checked. Raises InputError where no pair is left.
    """
    stamps = {n: t for n, couple in enumerate(couples) if (t := time_of(couple)) is not None}
    wrong_times = misplaced(stamps)
    pairs: dict[int, UsablePair] = {}
    rejections: list[Rejection] = []
    for number, couple in enumerate(couples):
        try:
            if number not in stamps:
                text = str(couple[0].stamp) if couple[0] else "the image has no time stamp"
                raise PairError(RejectionReason.TIMESTAMP_INVALID, text)
            captured = stamps[number]
            if number in wrong_times:
                text = f"the time {captured} ns {wrong_times[number]}"
                raise PairError(RejectionReason.TIMESTAMP_INVALID, text)
            left, right = (image.path for image in _both(couple, source.settings, names))
            left_sha256, right_sha256 = hash_of(left), hash_of(right)
            if left_sha256 is None or right_sha256 is None:
                ours, theirs = ([path] if path.is_file() else [] for path in (left, right))
                images = check_images(ours, theirs, rig, source.content, source.root)
            else:
                images = ImageFile(left, left_sha256), ImageFile(right, right_sha256)
            pairs[number] = *images, captured, pose_at(captured)
        except PairError as error:
            rejections.append(error.rejection(f"frame pair {number}", number))
    return drive_of_pairs(pairs, rejections, len(couples), source, rig, srid)


def _both(couple: Couple, settings: DriveYaml, names: Mapping[Side, str]) -> tuple[Image, Image]:
    """Both images. Raises PairError where one is missing or has a known problem."""
    left, right = couple
    if left is None or right is None:
        side: Side = "left" if left is None else "right"
        raise PairError(
            RejectionReason.IMAGE_MISSING,
            f"there is no {side} image ({names[side]}) within {settings.pair_tolerance_ms:g} ms of the other "
            "(pair_tolerance_ms in drive.yaml)",
            side=side,
        )
    for image in (left, right):
        if image.problem is not None:
            raise image.problem
    return left, right


def time_of(couple: Couple) -> int | None:
    """The left image's time; the right one's where it is alone."""
    image = couple[0] or couple[1]
    return image.stamp if image is not None and isinstance(image.stamp, int) else None
