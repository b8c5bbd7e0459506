"""Images of two cameras with a time stamp each -> frame pairs -> a drive. What EuRoC folders and bags have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from conetl.model.records import Drive, FramePair, Pose, Rig, Side
from conetl.model.rejections import Rejection, RejectionReason
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.drives.pairs import ImageFile, PairError, require_pairs
from conetl.readers.drives.timestamps import misplaced, wrong_clocks
from conetl.readers.drives.trajectories import nearest_index

NS_PER_MS = 1_000_000


class Image(NamedTuple):
    """One image of one camera."""

    stamp: int | str
    """UTC nanoseconds, or what is wrong with the stamp."""
    path: Path
    problem: PairError | None = None
    """What is wrong with the image, where that is known already."""


Couple = tuple[Image | None, Image | None]


def pair_by_stamp(left: Sequence[Image], right: Sequence[Image], tolerance_ns: int) -> list[Couple]:
    """Couples in the order in which they were recorded; every image is in one at most, and alone where it has no partner.

    Two images belong together when each is the other's nearest in time and they are at most tolerance_ns apart. A left image
    without a usable stamp takes the right one that follows the last pair, if that is alone, so that the two are one loss; a right
    one without is left out: its left partner says that it is alone.
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
    # A right image that is alone goes before the first left one that is later.
    for time in right_times:
        if number[time] not in used:
            place = next((i for i, c in enumerate(couples) if (t := _stamp(c)) is not None and t > time), len(couples))
            couples.insert(place, (None, right[number[time]]))
    return couples


def _by_true_clocks(images: Sequence[Image]) -> list[Image]:
    """The same images; a stamp by a wrong clock is none, so that the pair it belongs to is one loss."""
    wrong = wrong_clocks({i: p.stamp for i, p in enumerate(images) if isinstance(p.stamp, int)})
    return [p._replace(stamp=f"the time {p.stamp} ns {wrong[i]}") if i in wrong else p for i, p in enumerate(images)]


def drive_of_couples(
    couples: Sequence[Couple],
    *,
    source: Path,
    settings: DriveYaml,
    rig: Rig,
    srid: int,
    content: ContentHash,
    images_of: Callable[[Couple], tuple[ImageFile, ImageFile]],
    pose_at: Callable[[int], Pose],
) -> tuple[Drive, list[Rejection]]:
    """The drive and the rejections of its pairs. frame_index is the number of the couple, from 0.

    images_of: a couple's images, or PairError; pose_at: pose of the body at a time (UTC ns), or PairError. Raises
    DriveFolderError where not one pair is left.
    """
    stamps = {n: t for n, couple in enumerate(couples) if (t := _stamp(couple)) is not None}
    wrong_times = misplaced(stamps)
    pairs: list[FramePair] = []
    rejections: list[Rejection] = []
    for number, couple in enumerate(couples):
        try:
            captured = _captured_at(number, couple, wrong_times)
            left, right = images_of(couple)
            pose = pose_at(captured)
        except PairError as error:
            rejections.append(error.rejection(f"frame pair {number}", number))
        else:
            pairs.append(
                FramePair(
                    frame_index=number, left_path=str(left.path), right_path=str(right.path), captured_at_ns=captured,
                    pose=pose, left_sha256=left.sha256, right_sha256=right.sha256,
                )
            )  # fmt: skip
    require_pairs(pairs, rejections, len(couples), source)
    drive = Drive(
        drive_id=settings.id_of(source), source_path=str(source), rig=rig, map_srid=srid,
        content_sha256=content.hexdigest(), frame_pairs=tuple(pairs), expected_frame_count=len(couples),
    )  # fmt: skip
    return drive, rejections


def alone(couple: Couple, tolerance_ns: int, names: Mapping[Side, str]) -> PairError:
    """The complaint about a couple of one; names: of the two streams, by side."""
    side: Side = "left" if couple[0] is None else "right"
    return PairError(
        RejectionReason.IMAGE_MISSING,
        f"there is no {side} image ({names[side]}) within {tolerance_ns / NS_PER_MS:g} ms of the other "
        "(pair_tolerance_ms in drive.yaml)",
        side=side,
    )


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
