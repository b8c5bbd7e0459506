"""Which wrong recordings there are, and what must become of each: in `make test` some of them, in `make bench-mutants` all.

Poses, clocks and calibration are changed in memory (`recordings.py`), images and files of the log in a copy of the folder
(`images.py`).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from conetl.model.drive import Drive
from conetl.model.rejections import Rejection
from conetl.readers.drives import read_drive
from tests.folders import KITTI, SAMPLES
from tests.mutants import images
from tests.mutants.images import both, changed, only_left, only_right, shifted
from tests.mutants.recordings import (
    Mutant,
    aside,
    baseline,
    climbing,
    climbing_times,
    clock,
    clock_known_to,
    drift,
    farther_east,
    frozen_place,
    images_of,
    images_shifted,
    in_turn,
    jump,
    late,
    lenses,
    lever_arm,
    noise,
    passed_again,
    paused,
    raised,
    repeated,
    reversed_poses,
    right_ahead,
    right_late,
    spread_jump,
    stating,
    turned,
    turned_about_start,
    without,
)  # fmt: skip

_DAY_NS = 86_400_000_000_000


#: What is recorded: the first sample drive on an empty map, the second one on the map of the first, and the real street of
#: KITTI on an empty map, or a day later on its own one.
FIRST, SECOND, STREET, STREET_AGAIN = "drive 1", "drive 2 after 1", "KITTI", "KITTI again"
FOLDERS = {FIRST: SAMPLES[0], SECOND: SAMPLES[1], STREET: KITTI, STREET_AGAIN: KITTI}


@dataclass(frozen=True)
class WrongRecording:
    """A recording that is not what it says it is."""

    name: str
    mutant: Mutant | None = None
    """Of its records, in memory."""
    files: images.FolderMutant | None = None
    """Of its files."""
    cause: str | None = None
    """Regular expression that finds the true cause in what conetl says to a person, who must be asked; None where conetl can
    correct the recording, or state sigmas that cover what is wrong with it."""
    on: tuple[str, ...] = (FIRST, SECOND)
    fast: bool = False
    """Whether `make test` requires that it is held for its cause."""

    def read(self, where: str, folder: Path) -> tuple[Drive, list[Rejection]]:
        """The recording; where: one of `on`. folder: a new one, for changed files. Raises ConetlError."""
        source = FOLDERS[where]
        if self.files:
            self.files(images.copy_drive(source, folder / source.name))
            source = folder / source.name
        drive, rejections = read_drive(source)
        drive = self.mutant(drive) if self.mutant else drive
        if where == STREET_AGAIN:
            pairs = tuple(
                p.model_copy(update={"captured_at_ns": p.captured_at_ns + _DAY_NS}) for p in drive.frame_pairs
            )
            drive = drive.model_copy(update={"frame_pairs": pairs, "drive_id": f"{drive.drive_id}_again"})
        content = hashlib.sha256(f"{self.name} {where} {drive.content_sha256}".encode()).hexdigest()
        return drive.model_copy(update={"content_sha256": content}), rejections


_BLIND, _COVERED, _SIDES = "too little detail", "covered in part", "swapped, mirrored or upside down"
_IMAGES = (SECOND,)
_TRIGGER = "right images belong to left images"
#: What only a drive over the same road shows.
_AGAINST_MAP = "m from those of the map"
#: Both clocks and the order of the records are wrong in the same way: poses that are not those of their images.
_CLOCK = "clock|time stamps"
#: A log that errs by more than it states.
_SIGMAS = "stated sigmas|times as large|positions scatter"


def _jumps() -> list[WrongRecording]:
    return [
        *(
            WrongRecording(
                f"GNSS jumps {m:g} m", jump(m), cause=f"jumps by {m:.1f} m between frame pairs 19", fast=m == 0.3
            )
            for m in (0.3, 0.5, 1.0, 5.0, 50.0)
        ),
        WrongRecording("GNSS jumps 50 m and returns", jump(50.0, 20, 25), cause="GNSS/INS jumps by"),
        WrongRecording("GNSS jumps 1 m and returns", jump(1.0, 20, 25), cause="GNSS/INS jumps by"),
        *(
            WrongRecording(f"height jumps {m:g} m", raised(m, 20), cause="jumps by")
            for m in (1.0, 5.0)
        ),
        *(
            WrongRecording(
                f"GNSS jumps {m:g} m across a gap of {n} pairs", in_turn(jump(m, 20 + n), without(20, 20 + n)), cause="jumps by"
            )
            for n, m in ((2, 1.0), (5, 1.0), (5, 50.0), (10, 3.0), (10, 50.0))
        ),
        WrongRecording(
            "height jumps 1.5 m across a gap of 10 pairs", in_turn(raised(1.5, 30), without(20, 30)), cause="jumps by", fast=True
        ),
        *(
            WrongRecording(
                f"GNSS jumps {m:g} m within a second", spread_jump(m),
                cause=None if m == 0.3 else "times as large|contradict|drifts", fast=m == 1.0,
            )
            for m in (0.3, 1.0, 3.0)
        ),
        WrongRecording("10 pairs lost", without(20, 30)),
        WrongRecording("a minute without images", paused(20, 60.0)),
        WrongRecording(
            "GNSS jumps 0.4 m in a minute without images", in_turn(jump(0.4), paused(20, 60.0)),
            cause="jumps by 0.4 m between frame pairs 19",
        ),
        WrongRecording(
            "GNSS jumps 3 m in a minute without images", in_turn(jump(3.0), paused(20, 60.0)),
            cause="jumps by 3.0 m between frame pairs 19",
        ),
        WrongRecording("the same cones again", passed_again(0.0)),
        *(
            WrongRecording(
                f"the same cones again, {m:g} m {name}", passed_again(*(m * np.array(axis))), fast=m == 1.0 and name == "higher",
                cause=rf"passes \d+ cones again .* {m:.2f} m {text}",
            )
            for name, axis, text in (("north", (1, 0), "from where"), ("higher", (0, 1), "higher or lower"))
            for m in (0.3, 0.6, 1.0, 3.0)
        ),
        WrongRecording("GNSS jumps 5 m in 8 pairs", in_turn(jump(5.0, 4), without(8, 10**6)), cause="jumps by 5", fast=True),
    ]  # fmt: skip


def _logs() -> list[WrongRecording]:
    drifts = {0.5: None, 1.0: r"drifts|differ by -1\.5", 3.0: "drifts|contradict GNSS/INS"}
    return [
        *(WrongRecording(f"GNSS drifts {m:g} m", drift(m), cause=c, fast=m == 1.0) for m, c in drifts.items()),
        WrongRecording("heights drift 0.4 m", climbing(0.4)),
        WrongRecording("heights drift 1 m", climbing(1.0), cause="up or down", fast=True),
        *(
            WrongRecording(f"GNSS noise {m:g} m", noise(m), cause=f"{_SIGMAS}|jumps by", fast=m == 0.3)
            for m in (0.1, 0.3, 1.0)
        ),
        *(
            WrongRecording(f"GNSS of {m:g} m states 0.02", noise(m, 5.0), cause=f"{_SIGMAS}|drifts")
            for m in (0.2, 0.5)
        ),
        *(
            WrongRecording(f"GNSS of {m:g} m states that", in_turn(noise(m, 5.0), stating(m)))
            for m in (0.3, 1.0)
        ),
        *(WrongRecording(f"poses {n} records late", late(n), cause=_CLOCK, fast=n == 10) for n in (5, 10)),
        *(WrongRecording(f"poses {n} records late", late(n)) for n in (1, 2)),
        *(
            WrongRecording(
                f"each pose {n} times", repeated(n), cause=f"change only every {n} frame pairs|positions scatter by", fast=n == 2
            )
            for n in (2, 5)
        ),
        *(
            WrongRecording(f"heights {how}", climbing_times(factor), cause="up or down")
            for how, factor in {"in feet": 1 / 0.3048, "of other sign": -1.0}.items()
        ),
        *(
            WrongRecording(f"clock {ms:+d} ms", clock(ms))
            for ms in (-200, -100, -50, -20, -10, 10, 20, 50, 100, 200)
        ),
        *(WrongRecording(f"clock {ms:+d} ms", clock(ms), cause=_CLOCK) for ms in (-500, 500)),
        WrongRecording("variances as sigmas", files=images.log(lambda p: [p[0] ** 2], 23, 24), cause="a variance"),
        *(
            WrongRecording(f"positions {how}", files=images.log(change, 0, 2), cause=cause)
            for how, change, cause in (
                ("to 6 decimals of a degree", lambda p: [round(v, 6) for v in p], None),
                ("as float32", lambda p: np.float32(p).tolist(), "jumps by|times as large"),
            )
        ),
        *(
            WrongRecording(f"{name} of other sign", files=images.log(lambda p: [-p[0]], k, k + 1),
                           cause="contradict GNSS/INS|roll and pitch")
            for k, name in {3: "roll", 4: "pitch"}.items()
        ),
        WrongRecording("heading from north", files=images.log(lambda p: [np.pi / 2 - p[0]], 5, 6), cause="direction of its cam"),
        WrongRecording("poses in reverse", reversed_poses, cause="reverse order", fast=True),
        WrongRecording("GNSS frozen", frozen_place(), cause="is it frozen", fast=True),
        WrongRecording("GNSS frozen from the middle on", frozen_place(0.5), cause="GNSS/INS"),
    ]  # fmt: skip


def _rigs() -> list[WrongRecording]:
    return [
        *(
            WrongRecording(f"yaw {a:g} degrees", turned(0.0, 0.0, a), cause="alignment", fast=a == 2.0) for a in (2.0, 5.0)
        ),
        WrongRecording("yaw 1 degree", turned(0.0, 0.0, 1.0)),
        WrongRecording("pitch 1 degree", turned(0.0, 1.0, 0.0)),
        WrongRecording("pitch 2 degrees", turned(0.0, 2.0, 0.0), cause="alignment"),
        *(WrongRecording(f"roll {a:g} degrees", turned(a, 0.0, 0.0)) for a in (1.0, 2.0)),
        WrongRecording("roll 3 degrees", turned(3.0, 0.0, 0.0), cause="the cameras rolled by -[23]", fast=True),
        *(
            WrongRecording(f"{name} turns by {a:g} degrees", turned(*(a * np.array(axis)), first=20), cause="turns by|contradict",
                           fast=a == 1.0 and name == "yaw")
            for a in (1.0, 2.0) for name, axis in {"roll": (1, 0, 0), "pitch": (0, 1, 0), "yaw": (0, 0, 1)}.items()
        ),
        *(
            WrongRecording(f"baseline {p:+g} %", baseline(1 + p / 100), cause=c, fast=p == 5)
            for p, c in {-5: "baseline", -1.2: None, 1.2: None, 5: "baseline"}.items()
        ),
        *(WrongRecording(f"focal length {p:+d} %", lenses(1 + p / 100), cause="focal|[Cc]alibrat") for p in (-2, 2)),
        WrongRecording("principal point of the right camera 5 px", lenses(right_column_px=5.0), cause="[Cc]alibrat"),
        WrongRecording("principal points 20 px aside", lenses(columns_px=20.0), cause="alignment|[Cc]alibrat"),
        WrongRecording("principal points 20 px lower", lenses(rows_px=20.0), cause="alignment|[Cc]alibrat"),
        *(
            WrongRecording(
                f"right images {n} rows lower", files=changed(only_right(shifted(n, 0))),
                cause="too far to be corrected" if n > 4 else None,
            )
            for n in (1, 3, 6, 12)
        ),
        *(
            WrongRecording(f"right images {n:+d} columns", files=changed(only_right(shifted(0, n))), cause=cause)
            for n, cause in {-6: "alibrat", 1: None, 3: "alibrat", 6: "shifted sideways", 12: "shifted sideways"}.items()
        ),
        *(
            WrongRecording(f"right lens k1 {k1:+g}", files=changed(only_right(images.distorted(k1))), cause="distorted by k1")
            for k1 in (-0.05, 0.05)
        ),
        *(
            WrongRecording(f"right camera {n} frames late", right_late(n), cause=f"{_TRIGGER} {n} frames earlier", fast=n == 1)
            for n in (1, 2, 3)
        ),
        *(
            WrongRecording(
                f"right camera {ms:+d} ms", right_ahead(13.3 * ms / 1e3), fast=ms == 5,
                cause="ms too (late|early)|does not grow" if abs(ms) == 5 else None,
            )
            for ms in (-5, -2, 2, 5)
        ),
        *(
            WrongRecording(f"both cameras {how} a frame", images_shifted(n, 20), cause="lost a frame or repeated")
            for how, n in (("lose", 1), ("repeat", -1))
        ),
        WrongRecording("right camera 1 frame late from the middle on", right_late(1, 20), cause="1 frames earlier"),
        *(
            WrongRecording(
                f"right camera 1 frame late in {last - first} pairs", right_late(1, first, last), fast=first == 12,
                cause="in frame pairs .* 1 frames earlier",
            )
            for first, last in ((12, 26), (2, 9), (30, 38), (11, 17))
        ),
        *(
            WrongRecording(f"{what} of another drive", images_of(SAMPLES[2], *ends), cause="the images jump")
            for what, ends in {"10 image pairs": (15, 25), "last 10 image pairs": (29, 39)}.items()
        ),
    ]  # fmt: skip


def _cameras() -> list[WrongRecording]:
    def wrong(
        name: str,
        change: images.PairMutant,
        cause: str | None = None,
        first: float = 0.0,
        on: tuple[str, ...] = _IMAGES,
    ) -> WrongRecording:
        return WrongRecording(name, files=changed(change, first), cause=cause, on=on)

    return [
        wrong("both lenses covered", both(images.darker(0.0)), _BLIND),
        wrong("left lens covered", only_left(images.darker(0.0)), _BLIND),
        wrong("right lens covered", only_right(images.darker(0.0)), _BLIND),
        wrong("both lenses covered from the middle on", both(images.darker(0.0)), _BLIND, 0.5),
        wrong("left half of the left lens covered", only_left(images.covered(right=0.5)), _COVERED),
        wrong("left half of the right lens covered", only_right(images.covered(right=0.5)), _COVERED),
        wrong("left half of both lenses covered", both(images.covered(right=0.5)), _COVERED),
        wrong("lower half of both lenses covered", both(images.covered(top=0.5)), _COVERED),
        wrong("images x 0.06", both(images.darker(0.06)), _BLIND),
        wrong("images x 0.3", both(images.darker(0.3))),
        *(wrong(f"fog {s:g}", both(images.foggier(s)), _BLIND if s > 0.8 else None) for s in (0.5, 0.7, 0.9, 0.97)),
        *(
            wrong(f"blur {s:g} px", both(images.blurred(s)), _BLIND if s > 3 else None, on=(FIRST, SECOND))
            for s in (1.0, 3.0, 6.0, 8.0)
        ),
        wrong("images stretched vertically by 10 %", both(images.stretched(1.1))),
        wrong("right images blur 3 px", only_right(images.blurred(3.0))),
        wrong("right images of gamma 0.6", only_right(images.gamma(0.6)), None, on=(FIRST, SECOND)),
        wrong("right images blur 6 px", only_right(images.blurred(6.0)), _BLIND),
        wrong("lower part of the left lens smeared, 5 px", only_left(images.smeared(5.0))),
        wrong("lower part of both lenses smeared, 5 px", both(images.smeared(5.0))),
        wrong("overexposed x 3", both(images.overexposed(3.0))),
        wrong("overexposed x 8", both(images.overexposed(8.0))),
        wrong("low sun", both(images.glare(0.15)), _COVERED),
        wrong("low sun, wide", both(images.glare(0.4)), _BLIND),
        wrong("JPEG quality 10", both(images.compressed(10))),
        wrong("JPEG quality 5", both(images.compressed(5)), _BLIND),
        wrong("JPEG quality 2", both(images.compressed(2)), _BLIND),
        wrong("salt 2 %", both(images.salted(0.02))),
        wrong("salt 20 %", both(images.salted(0.2))),
        wrong("sides swapped", images.swapped, _SIDES),
        wrong("images mirrored", both(images.mirrored), _SIDES),
        wrong("images upside down", both(images.upside_down), _SIDES),
        wrong(
            "right images mirrored from the middle on", only_right(images.mirrored), "none of the .* do not belong together",
            0.5, (FIRST, SECOND),
        ),
        WrongRecording(
            "images blended with those before", files=images.blended, cause="two instants", on=(FIRST, SECOND), fast=True
        ),
        *(
            WrongRecording(f"images torn at {row:.0%}", files=images.torn(row), cause="torn at row")
            for row in (0.4, 0.6, 0.8)
        ),
        WrongRecording("right images torn at 60%", files=images.torn(0.6, "image_03"), cause="torn at row .* right"),
        WrongRecording("every third pair torn", files=images.torn(0.5, pairs=slice(4, None, 3)), cause="pairs are torn"),
        WrongRecording(
            "10 pairs in a row torn", files=images.torn(0.6, pairs=slice(15, 25)), cause="pairs are torn", fast=True
        ),
        WrongRecording("two pairs torn", files=images.torn(0.5, pairs=slice(18, 31, 12))),
        WrongRecording("hood of the vehicle in view", files=images.with_hood(0.92)),
        WrongRecording(
            "drive of the next morning in the same folder", files=images.another_day(SAMPLES[1], 20),
            cause="of another recording: split", on=(FIRST,),
        ),
        WrongRecording(
            "sides swapped from the middle on", files=changed(images.swapped, 0.5), cause="shifted sideways", on=(FIRST, SECOND)
        ),
        WrongRecording("both cameras frozen", files=images.frozen(*images.CAMERAS), cause="repeats its image", on=_IMAGES),
        WrongRecording("left camera frozen", files=images.frozen("image_02"), cause="repeats its image", on=(FIRST, SECOND)),
        WrongRecording("right camera frozen", files=images.frozen("image_03"), cause="repeats its image", on=(FIRST, SECOND)),
        WrongRecording(
            "right camera frozen from the middle on", files=images.frozen("image_03", first=0.5), cause="repeats its image",
            on=_IMAGES,
        ),
    ]  # fmt: skip


def _against_map() -> list[WrongRecording]:
    """Recordings that agree with themselves: only the map contradicts them."""

    def known(name: str, mutant: Mutant, cause: str = _AGAINST_MAP) -> WrongRecording:
        return WrongRecording(name, mutant, cause=cause, on=(SECOND,))

    return [
        # At most 1 m: the sigmas of the drive and of the one before cover both positions.
        WrongRecording("whole drive 0.3 m aside", aside(0.3), on=(SECOND,)),
        *(known(f"whole drive {m:g} m aside", aside(m)) for m in (1.1, 3.0, 10.0, 57.0, 86.0, 100.0)),
        known(
            "second half 0.8 m aside after a minute without images",
            in_turn(jump(0.8, 16), without(16, 25), paused(16, 60.0)), "0.8 m from those of the map.* Only . of its cones",
        ),
        *(known(f"heights {m:+g} m", raised(m), "height") for m in (-48.0, 2.0, 48.0)),
        *(known(f"whole drive turned {a:g} degrees", turned_about_start(a)) for a in (1.0, 3.0, 60.0, 180.0)),
        *(
            WrongRecording(f"lever arm {m:g} m {name}", lever_arm(*(m * np.array(axis))), on=(SECOND,))
            for m in (0.1, 0.3, 0.9) for name, axis in {"aside": (0, 1, 0), "along": (1, 0, 0)}.items()
        ),
        *(
            WrongRecording(f"cameras {m:g} m too high", lever_arm(0, 0, m), on=(SECOND,))
            for m in (0.15, 0.25)
        ),
        *(
            WrongRecording(f"latitude and longitude {how}", files=images.log(change), cause=cause)
            for how, change, cause in (
                ("swapped", lambda p: (p[1], p[0], p[2]), "latitude and longitude (are )?swapped"),
                ("in radians", lambda p: (*np.radians(p[:2]), p[2]), "in radians"),
            )
        ),
        *(known(f"positions {d:+g} degrees of longitude", farther_east(d), "one UTM zone") for d in (-6.0, 6.0)),
    ]  # fmt: skip


def _combinations() -> list[WrongRecording]:
    lower = {n: changed(only_right(shifted(n, 0))) for n in (1, 3, 6)}
    blur = {n: changed(both(images.blurred(n))) for n in (1.0, 3.0)}
    fog, half = changed(both(images.foggier(0.7))), changed(both(images.covered(top=0.5)))
    gnss = in_turn(noise(0.3, 5.0), stating(0.3))
    return [
        WrongRecording("clock +100 ms, right images 3 rows lower", clock(100), lower[3]),
        WrongRecording(
            "clock -50 ms, right images 6 rows lower", clock(-50), lower[6], cause="too far to be corrected", on=_IMAGES
        ),
        WrongRecording("clock +20 ms, baseline +1 %", in_turn(clock(20), baseline(1.01)), cause="baseline"),
        WrongRecording("clock +100 ms, yaw 1 degree", in_turn(clock(100), turned(0.0, 0.0, 1.0))),
        WrongRecording("clock +50 ms, GNSS of 0.3 m states that", in_turn(clock(50), gnss)),
        WrongRecording("jump 1 m, blur 1 px", jump(1.0), blur[1.0], cause="jumps by"),
        WrongRecording("jump 1 m, blur 3 px", jump(1.0), blur[3.0], cause="jumps by|too little detail"),
        WrongRecording("jump 5 m, fog 0.7", jump(5.0), fog, cause="jumps by", on=_IMAGES),
        WrongRecording("jump 5 m, clock +100 ms", in_turn(clock(100), jump(5.0)), cause="jumps by"),
        WrongRecording("noise 0.1 m, baseline -5 %", in_turn(noise(0.1), baseline(0.95)), cause="baseline|[Cc]alibrat"),
        WrongRecording(
            "GNSS of 1 m states that, baseline +5 %", in_turn(noise(1.0, 5.0), stating(1.0), baseline(1.05)), cause="baseline"
        ),
        WrongRecording("yaw 1 degree, pitch 1 degree", turned(0.0, 1.0, 1.0), cause="alignment"),
        WrongRecording("lower half covered, jump 1 m", jump(1.0), half, cause=f"jumps by|{_COVERED}", on=_IMAGES),
        WrongRecording("right camera 1 frame late, 3 rows lower", right_late(1), lower[3], cause="1 frames earlier"),
        WrongRecording("heights +48 m, clock +50 ms", in_turn(clock(50), raised(48.0)), cause="height", on=_IMAGES),
        WrongRecording("3 m aside, GNSS of 0.3 m states that", in_turn(aside(3.0), gnss), cause=_AGAINST_MAP, on=_IMAGES),
        WrongRecording("drift 1 m, right images 1 row lower", drift(1.0), lower[1], cause="drifts"),
    ]  # fmt: skip


def _street() -> list[WrongRecording]:
    """Mutants of KITTI, whose GNSS states 0.3 to 0.5 m."""

    def image(name: str, change: images.PairMutant, cause: str | None = None) -> WrongRecording:
        return WrongRecording(name, files=changed(change), cause=cause, on=(STREET_AGAIN,))

    street, half = (STREET,), 77
    return [
        WrongRecording("jump 1 m at pair 77", jump(1.0, half), on=street),
        WrongRecording("jump 5 m at pair 77", jump(5.0, half), cause="jumps by", on=street),
        WrongRecording("jump 50 m at pair 77", jump(50.0, half), cause="jumps by", on=street),
        WrongRecording("drift 5 m", drift(5.0), cause="drifts|contradict", on=street),
        WrongRecording("clock -100 ms", clock(-100), on=street),
        WrongRecording("clock +100 ms", clock(100), on=street),
        WrongRecording("clock +50 ms", clock(50), on=street),
        WrongRecording(
            "clock -36 ms, estimated to 20 ms", in_turn(clock(-36), clock_known_to(0.02)), cause="beginning of the images",
            on=street,
        ),
        WrongRecording("poses 5 records late", late(5), on=street),
        WrongRecording(
            "GNSS of 0.5 m states 0.03", in_turn(noise(0.5, 5.0), stating(0.03)), cause=f"{_SIGMAS}|No poses", on=street
        ),
        WrongRecording("noise 0.3 m states 0.03", in_turn(noise(0.3), stating(0.03)), cause=f"{_SIGMAS}|jumps by", on=street),
        WrongRecording("states 0.03 m", stating(0.03), cause=_SIGMAS, on=street),
        WrongRecording("poses in reverse", reversed_poses, cause="reverse order", on=street),
        WrongRecording("GNSS frozen", frozen_place(), cause="is it frozen", on=street),
        WrongRecording("yaw 2 degrees", turned(0.0, 0.0, 2.0), cause="alignment", on=street),
        WrongRecording("baseline +5 %", baseline(1.05), cause="baseline", on=street),
        WrongRecording("right camera 1 frames late", right_late(1), cause="1 frames earlier", on=street),
        WrongRecording("whole drive 50 m aside", aside(50.0), cause=_AGAINST_MAP, on=(STREET_AGAIN,)),
        WrongRecording("heights +48 m", raised(48.0), cause="height", on=(STREET_AGAIN,)),
        WrongRecording("right images 3 rows lower", files=changed(only_right(shifted(3, 0))), on=street),
        WrongRecording("right images +6 columns", files=changed(only_right(shifted(0, 6))), cause="shifted sideways", on=street),
        WrongRecording("right lens k1 -0.05", files=changed(only_right(images.distorted(-0.05))), cause="distorted", on=street),
        WrongRecording("images stretched vertically by 10 %", files=changed(both(images.stretched(1.1))), on=street),
        WrongRecording("images torn at 60%", files=images.torn(0.6), cause="torn at row", on=street),
        WrongRecording("10 pairs in a row torn", files=images.torn(0.6, pairs=slice(60, 70)), on=street),
        image("both lenses covered", both(images.darker(0.0)), _BLIND),
        image("fog 0.9", both(images.foggier(0.9)), _BLIND),
        image("sides swapped", images.swapped, _SIDES),
        image("left half of both lenses covered", both(images.covered(right=0.5)), _COVERED),
    ]  # fmt: skip


#: Good drives, which must pass.
GOOD = WrongRecording("good", on=(FIRST, SECOND, STREET, STREET_AGAIN))
RECORDINGS = (*_jumps(), *_logs(), *_rigs(), *_cameras(), *_against_map(), *_combinations(), *_street())
