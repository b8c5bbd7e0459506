"""Frame pairs, for all drive readers: hash and check images, reject bad pairs and make a drive of the others."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.files.documents import read_table_bytes, table_lines
from conetl.files.storage import fetch, remember
from conetl.geometry.rectification import stored_camera
from conetl.geometry.small_arrays import nearest_index
from conetl.model.drive import Drive, FramePair, Pose
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.image_headers import inspect_image
from conetl.perception.images import ImageFileError, check_image_bytes, check_image_ends, read_bytes
from conetl.readers.drives.camera_files import NO_FILES, Files
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.trajectories.times import misplaced, wrong_clocks

#: The pose of a standing vehicle scatters by less.
MOVED_M = 0.5


def file_digest(path: Path) -> bytes:
    """SHA-256 of a file of any size."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


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
        self._files[name] = file_digest(path)

    def lines(self, folder: Path, name: str, remedy: str, images: int | None = None) -> Iterator[str]:
        """Lines of a required file of the drive, which is added. Raises InputError where it is missing; remedy: what to do.

        images: as of `read_table_bytes`.
        """
        if not (folder / name).is_file():
            raise InputError(f"{folder}: {name} is missing; {remedy}")
        data = read_table_bytes(folder / name, images)
        self.add(name, data)
        return table_lines(data)

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
    files: Files = NO_FILES
    """What the format's `scan` found."""


class ImageFile(NamedTuple):
    """One image of a drive."""

    path: Path
    sha256: str | None = None
    """SHA-256 of its bytes, empty where only its header was read; None before it is checked."""


def by_stem(paths: Iterable[Path]) -> dict[str, list[ImageFile]]:
    """Files by their name without suffix."""
    found: dict[str, list[ImageFile]] = {}
    for path in paths:
        found.setdefault(path.stem, []).append(ImageFile(path))
    return found


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


class RecordedPair(NamedTuple):
    """One frame pair of a recording, before its images are checked."""

    number: int
    """Its frame_index."""
    name: str
    """Of it in messages."""
    left: Sequence[ImageFile]
    right: Sequence[ImageFile]
    """All files that claim to be the image."""
    captured: int | PairError
    """UTC nanoseconds, or what is wrong with the time."""
    pose_at: Callable[[int], Pose]
    """Pose of the body at that time. Raises PairError."""
    problem: PairError | None = None
    """Why its images are not read."""


def _check_images(frame: RecordedPair, rig: Rig, content: ContentHash, root: Path) -> list[ImageFile]:
    """Both images of a pair.

    Header, size (of the images as stored: raw, where the rig was rectified) and end marker are checked, nothing is decoded.
    Both are read (for the content hash) before either is rejected, and their bytes stay in memory for the steps to come.
    Raises PairError.
    """
    if frame.problem is not None:
        raise frame.problem
    problem: PairError | None = None
    good: list[ImageFile] = []
    for side, files in zip(SIDES, (frame.left, frame.right), strict=True):
        if len(files) != 1:
            names = ", ".join(file.path.name for file in files)
            reason = RejectionReason.IMAGE_UNREADABLE if files else RejectionReason.IMAGE_MISSING
            several = f"several {side} images claim this pair: {names}; keep one"
            problem = problem or PairError(reason, several if files else f"there is no {side} image", side=side)
            continue
        (path, sha256), camera = files[0], stored_camera(rig, side)
        size = camera.width_px, camera.height_px
        try:
            if sha256 is None:
                name, sha256 = path.relative_to(root).as_posix(), ""
                if content.headers_only:
                    check_image_ends(path, name, size)
                else:
                    data = content.read_ahead.pop(path, None) or read_bytes(path, name)
                    sha256 = content.add(name, data)
                    remember(path, sha256, data)
                    check_image_bytes(data, name, size)
        except ImageFileError as error:
            problem = problem or PairError(error.reason, str(error), side=side, path=name)
        good.append(ImageFile(path, sha256))
    if problem is not None:
        raise problem
    return good


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


def no_images(path: Path, left: str, right: str) -> InputError:
    """The error of a drive without images, by the names of their streams."""
    return InputError(f"{path}: there are no images in {left} and {right}")


#: Images in object storage are requested for so many frame pairs at a time.
_FRAMES_AT_ONCE = 8


def drive_of_pairs(
    frames: Sequence[RecordedPair], source: Source, rig: Rig, srid: int, rejections: Iterable[Rejection] = ()
) -> tuple[Drive, list[Rejection]]:
    """The drive of the frame pairs that can be used, and the rejections of the others and of files that are of none.

    Raises InputError where no pair is left.
    """
    pairs: list[FramePair] = []
    refused, content = [*rejections], source.content
    for n, frame in enumerate(frames):
        if n % _FRAMES_AT_ONCE == 0 and not content.headers_only:
            near = frames[n : n + _FRAMES_AT_ONCE]
            fetch([file.path for each in near for file in (*each.left, *each.right)], fresh=True)
        try:
            left, right = _check_images(frame, rig, content, source.root)
            if isinstance(frame.captured, PairError):
                raise frame.captured
            pose = frame.pose_at(frame.captured)
        except PairError as error:
            refused.append(error.rejection(f"frame pair {frame.name}", frame.number))
            continue
        paths = {"left_path": str(left.path), "right_path": str(right.path)}
        hashes = {"left_sha256": left.sha256, "right_sha256": right.sha256}
        pairs.append(FramePair(frame_index=frame.number, captured_at_ns=frame.captured, pose=pose, **paths, **hashes))
    if not pairs:
        first = f"; the first: {refused[0].record}: {refused[0].detail}" if refused else ""
        raise InputError(f"{source.root}: none of {len(frames)} frame pairs can be used{first}")
    drive = Drive(
        drive_id=source.settings.id_of(source.root), source_path=str(source.root), rig=rig, map_srid=srid,
        content_sha256=content.hexdigest(), frame_pairs=tuple(pairs), expected_frame_count=len(frames),
    )  # fmt: skip
    return drive, refused


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
    sha256: str | None = None
    """As of `ImageFile`."""

    def later(self, offset_ns: int) -> Image:
        """The same image by another clock."""
        return self if isinstance(self.stamp, str) else self._replace(stamp=self.stamp + offset_ns)


Couple = tuple[Image | None, Image | None]
#: Given the times of all exposures (UTC ns), a function that gives the pose of the body at each of them or raises PairError.
PosesAt = Callable[[Sequence[int]], Callable[[int], Pose]]


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
    poses_at: PosesAt,
) -> tuple[Drive, list[Rejection]]:
    """The drive and the rejections of its pairs. frame_index is the number of the couple, from 0.

    names: of the two image streams. Raises InputError where no pair is left.
    """
    if not couples:
        raise no_images(source.path, names["left"], names["right"])
    times = [time_of(couple) for couple in couples]
    wrong = misplaced({n: time for n, time in enumerate(times) if time is not None})
    pose_at = poses_at([time for time in times if time is not None])
    frames: list[RecordedPair] = []
    for n, (time, images) in enumerate(zip(times, couples, strict=True)):
        problem = next((image.problem for image in images if image is not None and image.problem), None)
        if None in images:
            side = SIDES[images.index(None)]
            text = f"there is no {side} image ({names[side]}) within {source.settings.pair_tolerance_ms:g} ms of the other "
            text += "(pair_tolerance_ms in drive.yaml)"
            problem = PairError(RejectionReason.IMAGE_MISSING, text, side=side)
        if time is None or n in wrong:
            unread = str(images[0].stamp) if images[0] else "the image has no time stamp"
            text = unread if time is None else f"the time {time} ns {wrong[n]}"
            problem = PairError(RejectionReason.TIMESTAMP_INVALID, text)
        # A file that a list names may be missing.
        left, right = (
            [ImageFile(i.path, i.sha256)] if i is not None and (i.sha256 is not None or i.path.is_file()) else []
            for i in images
        )
        frames.append(RecordedPair(n, str(n), left, right, time or 0, pose_at, problem))
    return drive_of_pairs(frames, source, rig, srid)


def time_of(couple: Couple) -> int | None:
    """The left image's time; the right one's where it is alone."""
    image = couple[0] or couple[1]
    return image.stamp if image is not None and isinstance(image.stamp, int) else None
