"""Which labelled images are kept out of training, to measure on: whole recordings where there are several."""

from __future__ import annotations

from collections.abc import Sequence

from conetl.learning.images import LabelledImage

#: Share of the labelled objects (or of the images, without any) that is kept out.
SHARE = 0.25
#: A recording with more than this share of the objects is never kept out whole.
_MAX_SHARE = 0.45


def hold_out(images: Sequence[LabelledImage]) -> tuple[list[LabelledImage], list[LabelledImage]]:
    """Images to train on, and those kept out, in the order given.

    Recordings are kept out from the smallest on until they hold SHARE of the objects. Where that is not possible, because there
    is one recording or one holds nearly everything, the last images of every recording by name are kept out: neighbours in time
    resemble each other, so that figures on them are optimistic.
    """
    recordings: dict[str, list[int]] = {}
    for number, image in enumerate(images):
        recordings.setdefault(image.source, []).append(number)
    weight = {name: sum(1 + 4 * len(images[k].boxes) for k in numbers) for name, numbers in recordings.items()}
    total = sum(weight.values())
    out: set[int] = set()
    if len(recordings) > 1:
        kept_out = 0
        for name in sorted(recordings, key=lambda name: (weight[name], name)):
            if kept_out >= SHARE * total or kept_out + weight[name] > _MAX_SHARE * total:
                break
            kept_out += weight[name]
            out |= set(recordings[name])
    if not out:
        for numbers in recordings.values():
            ordered = sorted(numbers, key=lambda k: images[k].name)
            out |= set(ordered[len(ordered) - int(SHARE * len(ordered)) :])
    return [one for k, one in enumerate(images) if k not in out], [one for k, one in enumerate(images) if k in out]
