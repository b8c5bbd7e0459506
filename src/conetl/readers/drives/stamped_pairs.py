"""Images with time stamps from two cameras -> frame pairs -> a drive, for EuRoC folders and bags."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from conetl.model.records import Drive, Pose, Rig, Side
from conetl.model.rejections import Rejection, RejectionReason
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.drives.pairs import ContentHash, ImageFile, PairError, UsablePair, drive_of_pairs
from conetl.readers.drives.timestamps import misplaced, wrong_clocks
from conetl.readers.drives.trajectories import nearest_index


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
    right_times = sorted(t for t in number if isinstance(t, int))
    left_times = sorted({p.stamp for p in left if isinstance(p.stamp, int)})
    partners: list[int | None] = []
    used: set[int] = set()
    for image in left:
        partner = None
        if isinstance(image.stamp, int) and right_times:
            time = right_times[nearest_index(right_times, image.stamp)]
            mutual = left_times[nearest_index(left_times, time)] == image.stamp
            if mutual and abs(time - image.stamp) <= tolerance_ns and number[time] not in used:
                partner = number[time]
                used.add(partner)
        partners.append(partner)
    last = -1
    for i, image in enumerate(left):
        if isinstance(image.stamp, str) and last + 1 < len(right) and last + 1 not in used:
            partners[i] = last + 1
            used.add(last + 1)
        last = last if (partner := partners[i]) is None else partner
    couples: list[Couple] = [(p, None if i is None else right[i]) for p, i in zip(left, partners, strict=True)]
    # A right image that is alone is inserted before the first later one.
    for time in right_times:
        if number[time] not in used:
            index = next((i for i, c in enumerate(couples) if (t := _stamp(c)) is not None and t > time), len(couples))
            couples.insert(index, (None, right[number[time]]))
    return couples


def _by_true_clocks(images: Sequence[Image]) -> list[Image]:
    """The same images; a stamp by a wrong clock counts as missing, so that its pair costs one rejection."""
    wrong = wrong_clocks({i: p.stamp for i, p in enumerate(images) if isinstance(p.stamp, int)})
    return [p._replace(stamp=f"the time {p.stamp} ns {wrong[i]}") if i in wrong else p for i, p in enumerate(images)]


def drive_of_couples(
    couples: Sequence[Couple],
    names: Mapping[Side, str],
    *,
    source: Path,
    settings: DriveYaml,
    rig: Rig,
    srid: int,
    content: ContentHash,
    images_of: Callable[[Image, Image], tuple[ImageFile, ImageFile]],
    pose_at: Callable[[int], Pose],
) -> tuple[Drive, list[Rejection]]:
    """The drive and the rejections of its pairs. frame_index is the number of the couple, from 0.

    names: of the two image streams. images_of: checked paths of a couple's images; pose_at: pose of the body at a time (UTC ns);
    both raise PairError. Raises DriveFolderError where no pair is left.
    """
    stamps = {n: t for n, couple in enumerate(couples) if (t := _stamp(couple)) is not None}
    wrong_times = misplaced(stamps)
    pairs: dict[int, UsablePair] = {}
    rejections: list[Rejection] = []
    for number, couple in enumerate(couples):
        try:
            captured = _captured_at(number, couple, wrong_times)
            images = images_of(*_both(couple, settings, names))
            pairs[number] = *images, captured, pose_at(captured)
        except PairError as error:
            rejections.append(error.rejection(f"frame pair {number}", number))
    return drive_of_pairs(
        pairs, rejections, len(couples), source=source, settings=settings, rig=rig, srid=srid, content=content
    )


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


def _stamp(couple: Couple) -> int | None:
    """The left image's time; the right one's where it is alone."""
    image = couple[0] or couple[1]
    return image.stamp if image is not None and isinstance(image.stamp, int) else None


def _captured_at(number: int, couple: Couple, wrong_times: Mapping[int, str]) -> int:
    stamp = _stamp(couple)
    if stamp is None:
        detail = str(couple[0].stamp) if couple[0] else "the image has no time stamp"
        raise PairError(RejectionReason.TIMESTAMP_INVALID, detail)
    if number in wrong_times:
        raise PairError(RejectionReason.TIMESTAMP_INVALID, f"the time {stamp} ns {wrong_times[number]}")
    return stamp
