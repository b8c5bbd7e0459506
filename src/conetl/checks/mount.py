"""Checks of mount and heights against the motion in the images, and of cones against surveyed points and a second pass."""

from __future__ import annotations

from conetl.checks.check import Check
from conetl.model.health import Verdict

CHECKS = (
    Check(
        name="roll of the cameras",
        measured="axis of the turns in the images relative to that in the log",
        observable="20 measured motions with turns",
        least="mount.roll_deg",
        sigmas="mount.sigmas",
        unit="degrees",
        effect="0.3 m per degree",
        messages={
            "": (
                "In turns, the images show the cameras rolled by {value:+.2f} +- {sigma:.2f} degrees (left side up) "
                "relative to the calibration and GNSS/INS."
            ),
        },
        passed="In turns, the images agree with the mount of the cameras.",
        remedy=(
            "Correct body_SE3_left in rig.yaml (mount in drive.yaml; KITTI: calib_imu_to_velo.txt), or the axes of "
            "the GNSS/INS log."
        ),
    ),
    Check(
        name="lever arm of the cameras",
        measured="path of the cameras in turns relative to that of the log",
        observable="turns",
        least="mount.lever_arm_m",
        sigmas="path.sigmas",
        unit="m",
        effect="the error of the lever arm",
        messages={
            "": (
                "In turns, the images show the cameras mounted by {value:+.2f} +- {sigma:.2f} m ({way}) relative to "
                "the calibration and GNSS/INS."
            ),
        },
        passed="In turns, the images agree with the mount of the cameras.",
        remedy=(
            "Correct body_SE3_left in rig.yaml (mount in drive.yaml; KITTI: calib_imu_to_velo.txt), or the antenna "
            "position of the GNSS/INS log."
        ),
    ),
    Check(
        name="aspect ratio of the images",
        measured="pitch of the vehicle in the images beyond that in the log",
        observable="20 measured motions of a vehicle that pitches",
        least="mount.stretch_percent",
        sigmas="mount.stretch_sigmas",
        unit="%",
        effect="heights relative to the cameras are wrong by that percentage",
        messages={
            "": (
                "In the images the vehicle pitches {value:+.0f} +- {sigma:.0f} % more than in GNSS/INS: they were "
                "stretched vertically (wrong aspect ratio of the video?), or fy of the calibration is wrong. Heights "
                "relative to the cameras are wrong by the same percentage."
            ),
        },
        passed="Images and GNSS/INS show the same pitch of the vehicle.",
        remedy="Deliver the original images, or calibrate the rig (conetl calibrate).",
        follows=Verdict.NOTE,
    ),
    Check(
        name="heights of GNSS/INS",
        measured="climbs in the log as a multiple of those in the images",
        observable="hills whose slopes exceed the errors of the attitudes",
        least="mount.climb",
        sigmas="path.sigmas",
        expected=1.0,
        effect="heights of cones are wrong by that factor",
        messages={
            "": "In GNSS/INS the vehicle climbs {value:.2f} +- {sigma:.2f} times as much as in the images.",
            "sign": "Check the heights of the log: perhaps their sign is wrong.",
            "feet": "Check the heights of the log: perhaps they are in feet.",
            "feet twice": "Check the heights of the log: perhaps they were converted from feet twice.",
            "unit": "Check the heights of the log: perhaps they have another unit or are filtered.",
        },
        passed="GNSS/INS and images show the same climbs, or the road is too level for this check.",
    ),
    Check(
        name="driving direction",
        measured="intervals in which the vehicle moves backwards in the images",
        observable="trajectories with sparse records",
        least="odometry.max_reversed",
        effect="poses that look the other way: any",
        messages={
            "": (
                "In {value:.0f} intervals, from frame pair {first} on, the images show the vehicle driving backwards. "
                "Without attitudes, conetl computes the heading of a vehicle that drives forwards."
            ),
        },
        passed="The vehicle drives in the direction of its cameras.",
        remedy="Cut out the part that reverses, or record attitudes.",
    ),
    Check(
        name="cones passed twice",
        measured="common displacement of cones that the drive passes again more than 5 s later",
        observable=(
            "{agreement.least_pairs} of them, or beyond 1.5 m {agreement.least_same} at unequal distances, up to 4 m"
        ),
        limit="above {agreement.least_offset_m:g} m and {agreement.sigmas:g} sigmas of both",
        unit="m",
        effect="the displacement, in one of both passes",
        messages={
            "": (
                "The drive passes {count} cones again from frame pair {first} on, and locates them {size:.2f} m from "
                "where they were: either GNSS/INS drifted or jumped in between, or all cones were moved by the same "
                "distance."
            ),
            "heights": (
                "The drive passes {count} cones again from frame pair {first} on, and locates them {size:.2f} m "
                "higher or lower than before: either GNSS/INS drifted or jumped in between, or all cones were moved "
                "by the same distance."
            ),
        },
        passed="Cones that the drive passes twice are at the same positions.",
        remedy="Reprocess the GNSS/INS log.",
    ),
    Check(
        name="control points",
        measured="how many surveyed cones agree with each other and with the log",
        observable="surveyed points near cones",
        limit="[control points](../reference/drives.md#control-points)",
        effect="the difference between points and log",
        follows=Verdict.NOTE,
        follows_from={
            "not adjusted": Verdict.HOLD,
            "contradict": Verdict.HOLD,
            "in height": Verdict.HOLD,
        },
        messages={
            "none near": "None of the {count} control points is near a cone: check their CRS and height system.",
            "not adjusted": "The poses cannot be adjusted to the control points: {why}.",
            "contradict": "The control points contradict each other or GNSS/INS: {named}.",
            "only": "Only {agreeing} fit.",
            "survey": (
                "Check the points, their datum and that of GNSS/INS, or survey more: {least} points must agree."
            ),
            "ambiguous": "The {count} control points match the cones in more than one way: survey more points.",
            "twins": (
                "The {count} control points match the cones in more than one way: one cone is surveyed twice "
                "({twins}): keep one of the points."
            ),
            "used": "{used} of {count} control points match a cone and agree: the poses are adjusted to them.",
            "in height": (
                "GNSS/INS differs from them by {off_m:.2f} m in height only ({sigmas:.0f} sigmas of both): were feet "
                "surveyed, not tips, with the right pole and height system? If so, accept the drive."
            ),
            "all along": (
                "GNSS/INS differs from them by {off_m:.2f} m, all along the drive ({sigmas:.0f} sigmas of both): one "
                "of the two is wrong, and the map uses the points. Check datum and base station of both."
            ),
            "drift": (
                "GNSS/INS differs from them by {off_m:.2f} m ({sigmas:.0f} sigmas of both): it drifts, or jumps: "
                "check its log."
            ),
            "wrong": "Not used, because the others contradict them: {named}.",
        },
        passed="{used} of {count} control points match a cone and agree: the poses are adjusted to them.",
    ),
)
