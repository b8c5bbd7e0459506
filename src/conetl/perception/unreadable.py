"""Frame pairs whose images turned out to be broken when they were decoded.

A drive's reader looks at headers and ends only, so such a pair is part of the drive until its images are searched. From then on
it must not be: where nothing could be read nothing was looked at, and a cone that was not found there is not one that is gone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from conetl.model.errors import DriveFolderError
from conetl.model.records import Detection, Drive
from conetl.model.rejections import INPUT_REASONS, Rejection


def without_unread(
    drive: Drive, detections: Sequence[Detection], rejections: Iterable[Rejection]
) -> tuple[Drive, list[Detection]]:
    """The drive and its detections without the frame pairs of which a image could not be read.

    rejections: of the search for detections. A pair is lost where one of its images is, as it is when a drive is read. Raises
    DriveFolderError where no pair is left.
    """
    unread = [r for r in rejections if r.reason in INPUT_REASONS]
    lost = {r.payload["frame_index"] for r in unread}
    if not lost:
        return drive, list(detections)
    kept = tuple(pair for pair in drive.frame_pairs if pair.frame_index not in lost)
    if not kept:
        raise DriveFolderError(
            f"{drive.source_path}: not one of {len(drive.frame_pairs)} frame pairs has two images that can be decoded; "
            f"the first: {unread[0].record}: {unread[0].detail}"
        )
    return drive.model_copy(update={"frame_pairs": kept}), [d for d in detections if d.frame_index not in lost]
