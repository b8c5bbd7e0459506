"""Heights of another unit or sign on hilly roads, where the images show how far the vehicle climbs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conetl.geometry import pose as se3
from conetl.geometry.packing import vec3
from conetl.model.health import HealthCheck, Verdict
from tests.cases import cases
from tests.synthetic import good_drives
from tests.synthetic.good_drives import GoodDrive, checked, draw_drive
from tests.synthetic.world import ORIGIN_M


class HillyPath(good_drives.Path):
    """The same over hills of 200 m, 2 m high; the vehicle pitches with the road."""

    def poses_at(self, times_s: good_drives.Floats) -> good_drives.Floats:
        poses = super().poses_at(times_s)
        phase = 2 * np.pi * (poses[:, 0, 3] - ORIGIN_M[0] + poses[:, 1, 3] - ORIGIN_M[1]) / 200.0
        poses[:, 2, 3] = ORIGIN_M[2] + np.sin(phase)
        ahead = poses[:, :2, 0].sum(axis=1)
        slope = np.arctan(2 * np.pi / 200.0 * np.cos(phase) * ahead)
        poses[:, :3, :3] = poses[:, :3, :3] @ se3.rotation_from_rpy(0 * slope, -slope, 0 * slope)
        return poses


def of_heights(seed: int, factor: float, monkeypatch: pytest.MonkeyPatch) -> tuple[GoodDrive, HealthCheck]:
    """A drive of 20 s whose log has so many times the heights, with what the check says."""
    monkeypatch.setattr(good_drives, "Path", HillyPath)
    drive = draw_drive(np.random.default_rng(seed), offset_s=0.0, lasts_s=20.0, sigma_rad=0.0009)
    logged = []
    for pair in drive.logged:
        off_m = np.subtract(pair.pose.map_t_body_m, ORIGIN_M) * (1.0, 1.0, factor)
        pose = pair.pose.model_copy(update={"map_t_body_m": vec3(off_m + ORIGIN_M)})
        logged.append(pair.model_copy(update={"pose": pose}))
    drive = replace(drive, logged=logged)
    _, checks = checked(drive)
    [check] = [check for check in checks if check.name == "heights of GNSS/INS"]
    return drive, check


RTK = [3000, 3001, 3008]


@pytest.mark.parametrize("seed", cases(RTK[0], release=RTK[1:]))
@pytest.mark.parametrize(
    ("factor", "says"), [(1 / 0.3048, "they are in feet"), (0.3048, "from feet twice"), (-1.0, "their sign is wrong")]
)
def test_heights_that_the_images_do_not_climb_are_named(
    seed: int, factor: float, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive, check = of_heights(seed, factor, monkeypatch)
    assert drive.kind.startswith("RTK")
    assert check.verdict is Verdict.HOLD and says in check.detail, check
    assert check.value == pytest.approx(factor, abs=0.2 * abs(factor) + 0.15)


@pytest.mark.parametrize("seed", cases(3000, 3002, release=[3001, *range(3003, 3008)]))
def test_good_heights_pass(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of plain GNSS, whose heights vary by metres."""
    _, check = of_heights(seed, 1.0, monkeypatch)
    assert check.value is not None and check.sigma is not None
    assert check.verdict is Verdict.PASS and abs(check.value - 1) < 4 * check.sigma, check
