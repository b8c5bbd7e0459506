"""One frame pair searched: one image after the other as in a chunk, or both at the same time as in a watch."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from conetl.model.drive import Drive
from conetl.model.params import IngestParams
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Side
from conetl.perception.detector import load_detector
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_pair_image
from conetl.pipeline.one_pair import (
    SearchedPair,
    first_road_rows,
    images_of,
    map_up_in_left,
    match_searched,
    search_pair,
)
from conetl.readers.drives import read_drive
from tests.arriving_drives import SAMPLE

PARAMS = IngestParams()


@pytest.fixture(scope="module")
def drive() -> Drive:
    return read_drive(SAMPLE, headers_only=True)[0]


def search(drive: Drive, broken: Side | None = None, **options: object) -> SearchedPair:
    pair, detector = drive.frame_pairs[12], load_detector()
    rows = first_road_rows([pair], drive.rig, PARAMS.detection)

    def read(side: Side) -> object:
        if side == broken:
            raise ImageFileError(RejectionReason.IMAGE_TRUNCATED, "half of it")
        return read_pair_image(pair, side, drive.rig)

    return search_pair(12, read, lambda _: detector, drive.rig, PARAMS, rows, **options)  # type: ignore[arg-type]


def test_both_images_at_the_same_time_give_the_same(drive: Drive) -> None:
    """And the right image around possible partners gives the same matches, up to hundredths of a pixel."""
    with ThreadPoolExecutor(2) as pool:
        at_once = search(drive, pool=pool)
    in_turn = search(drive)
    assert [one.detections for one in at_once.values()] == [one.detections for one in in_turn.values()]
    assert all(one.detections and one.processor_s > 0 for one in in_turn.values())
    matched = partial(
        match_searched, rig=drive.rig, params=PARAMS.match, up_left=map_up_in_left(drive.frame_pairs[12], drive.rig)
    )
    everywhere, around = (matched(searched)[0] for searched in (in_turn, search(drive, everywhere=False)))
    assert len(everywhere) == len(around) > 2
    for a, b in zip(everywhere, around, strict=True):
        assert a.left == b.left
        assert a.foot_right_uv_px == pytest.approx(b.foot_right_uv_px, abs=0.5)


@pytest.mark.parametrize("everywhere", [True, False])
def test_a_broken_image_leaves_the_other_one(drive: Drive, everywhere: bool) -> None:
    searched = search(drive, "left", everywhere=everywhere)
    assert searched["left"].image is None and not searched["left"].detections
    assert bool(searched["right"].detections) is everywhere  # no left boxes: there can be no partners
    with pytest.raises(ImageFileError, match="half of it"):
        images_of(searched)
    up = map_up_in_left(drive.frame_pairs[12], drive.rig)
    assert match_searched(searched, drive.rig, PARAMS.match, up)[0] == []
