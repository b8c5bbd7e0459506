"""Which boxes of an image are shown whole to those who may see no faces and number plates."""

from __future__ import annotations

from conetl.web.frames import _is_near
from tests.synthetic.world import make_rig


def test_a_box_that_fills_the_image_or_is_outside_shows_nothing() -> None:
    rig = make_rig()
    width, height = rig.left.width_px, rig.left.height_px
    least = width / 3
    assert _is_near((10.0, 10.0, least - 1, 20.0), rig) and _is_near((10.0, 10.0, 20.0, least - 1), rig)
    assert not _is_near((10.0, 10.0, least, 20.0), rig) and not _is_near((10.0, 10.0, 20.0, least), rig)
    for x, y in ((-20.0, 10.0), (width, 10.0), (10.0, -20.0), (10.0, height)):
        assert not _is_near((x, y, 20.0, 20.0), rig)
