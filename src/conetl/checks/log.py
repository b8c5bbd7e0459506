"""Checks of the log against the motion in the images, and of cones against surveyed points and a second pass."""

from __future__ import annotations

from conetl.checks.check import SHARE, Check
from conetl.model.health import Verdict

_ENOUGH = "images that show structure"
_LONGER = (
    "Either the calibration is wrong (baseline, focal length, lens, or raw images taken for rectified ones), or GNSS/INS drifts. "
    "Calibrate the rig (conetl calibrate), or reprocess the GNSS/INS log."
)

#: Messages on likely causes, of all checks of the log.
COMMON_MESSAGES = {
    "start": (
        "The beginning of the images is only known to {clock_ms:.0f} ms: state it in drive.yaml (images.start, or "
        "clock.offset_s) before you look for other causes."
    ),
    "start is off": (
        "The beginning of the images is only known to {clock_ms:.0f} ms, and the poses show that it is off by "
        "{off_ms:+z.0f} +- {off_sigma_ms:.0f} ms: state it in drive.yaml (images.start, or clock.offset_s) before you look "
        "for other causes."
    ),
    "repeated": (
        "In the log, positions change only every {every:.0f} frame pairs: it has fewer records than there are images, and "
        "each was repeated. Deliver the original log; conetl interpolates."
    ),
    "scatter": (
        "In the log, positions scatter by {scatter_m:.2f} m from one record to the next, with stated sigmas of "
        "{stated_m:.2f} m: reprocess the log, or state its true sigmas (sigmas in drive.yaml)."
    ),
    "standing": "In the log, the vehicle moved {path_m:.1f} m in {duration_s:.0f} s: is it frozen, or in radians?",
    "aside": (
        "In the log, the vehicle moved at {aside_deg:.0f} degrees to the direction of its cameras: are latitude and "
        "longitude swapped, or the records in reverse order?"
    ),
}

CHECKS = (
    Check(
        name="intervals measured by visual odometry",
        measured="share of the intervals between frame pairs that visual odometry measures", observable=_ENOUGH,
        least="odometry.least_measured_share",
        limit="or a run of more than {odometry.max_lost_share:.0%} of the intervals without a measurement",
        is_smallest=True, unit=SHARE, effect="poses of another recording: any",
        messages={
            "": "The images show the motion of the vehicle in only {measured} of {intervals} intervals between frame pairs, "
                "although they have enough structure.",
            "part": "The images show the motion of the vehicle in none of the {lost} intervals from frame pair {first} on, "
                    "although they have enough structure.",
        },
        passed="Visual odometry measured {measured} of {intervals} intervals between frame pairs.",
        remedy="Either the poses do not belong to these images, or left and right images do "
               "not belong together. Check numbers, order and time stamps of images and poses.",
    ),
    Check(
        name="visual odometry against GNSS/INS",
        measured="share of the measured motions that contradict the log beyond the errors of both",
        observable="two measured motions", least="odometry.max_contradicting_share",
        unit=SHARE, effect="poses of another path: any",
        messages={
            "": "{rejected} of {motions} measured motions between frame pairs contradict GNSS/INS beyond the errors of both, by "
                "{metres:.2f} m and {degrees:.2f} degrees in the median.",
            "other path": "The images show a different path than GNSS/INS: check first when they were taken "
                          "(images.start in drive.yaml, its time zone, time stamps, clocks), then the alignment, the "
                          "stated sigmas and the calibration.",
            "scale": "Distances in the images differ by {scale_percent:+.1f} % from GNSS/INS throughout. " + _LONGER,
            "unknown": "They have no common cause that conetl knows. Check the alignment and clocks of cameras and GNSS/INS, "
                       "their stated sigmas, and the calibration.",
        },
        passed="{agreeing} of {motions} measured motions agree with GNSS/INS.",
    ),
    Check(
        name="adjustment of the poses", measured="whether one set of poses fits both the images and the log",
        observable="always", limit="none does", effect="any",
        messages={"": "No path agrees with both the images ({images_m:.0f} m long) and GNSS/INS ({log_m:.0f} m)."},
        passed="The poses fit both images and GNSS/INS.",
        remedy="Check the time stamps of the images (beginning and frame rate; a video can state a wrong rate), the "
               "log and the calibration.",
    ),
    Check(
        name="stated sigmas of the poses",
        measured="factor on the stated sigmas under which the difference between log and images is most likely, whatever "
                 "the spectrum of the errors (constant, slow, fast, white)",
        observable="measured motions", least="path.sigma_factor",
        limit="or a pose is moved by more than the root of `max_shift_chi2` of its sigmas",
        treated="significantly above 1: the sigmas of all positions are widened by it, and reported from "
                "{path.worth_saying:g} on",
        effect="more than the sigmas that the log states; widened ones cover it",
        messages={"": "The errors of {of} in the log are {value:.1f} times as large as its stated sigmas.",
                  "widened": "The sigmas of all positions were enlarged by that factor. State the true sigmas (sigmas in "
                             "drive.yaml).",
                  "beyond": "That is too much to be covered by larger sigmas: reprocess the log, or state its true sigmas "
                            "(sigmas in drive.yaml).",
                  "moved": "{outcome} State the true sigmas (sigmas in drive.yaml), reprocess the log, or calibrate the rig "
                           "(conetl calibrate)."},
        passed="The errors of the log are within its stated sigmas.",
    ),
    Check(
        name="jumps of the poses",
        measured="motion of the log between two frame pairs beyond that in the images; where these do not show it, beyond "
                 "that of the intervals around it",
        observable="always", least="jumps.least_m",
        limit="and {jumps.sigmas:g} stated sigmas of both records; without images also more than a vehicle can do (3.5 "
              "m/s² in addition to a constant acceleration, 1 m/s² in height)",
        unit="m", effect="the size of the jump, in a part of the drive",
        messages={"": "GNSS/INS jumps by {value:.1f} m between frame pairs {first} and {second}, but the images do "
                      "not: either the positions before or those after it are wrong."},
        passed="The poses do not jump.",
        remedy="Reprocess the GNSS/INS log. Do not split the recording into two drives, unless you know that their "
               "positions are correct.",
    ),
    Check(
        name="jumps of the attitude", measured="rotation in the log that no measured rotation confirms",
        observable="measured motions before and after", least="jumps.turn_deg",
        limit="and {jumps.sigmas:g} sigmas of the log", unit="degrees", effect="the distance of a cone times the angle",
        messages={"": "GNSS/INS turns by {value:.1f} degrees between frame pairs {first} and {second}, but the images "
                      "do not: the attitudes before or after it are wrong."},
        passed="The attitudes do not jump.", remedy="Reprocess the GNSS/INS log.",
    ),
    Check(
        name="frames lost by both cameras",
        measured="intervals that are twice or half as long in the images (to {exposures.uneven_share:.0%}) as in a "
                 "uniform log, next to intervals that agree",
        observable="a vehicle that drives at an even speed", limit="one",
        effect="poses of all later images are wrong by the distance of one interval",
        messages={"": "Both cameras lost a frame or repeated one before frame pair {first}: there the images move "
                      "twice or half as far as GNSS/INS, so all later images have wrong poses."},
        passed="No frame was lost or repeated by both cameras.",
        remedy="Correct the numbers or time stamps of the images.",
    ),
    Check(
        name="images of one recording",
        measured="intervals whose images differ by {exposures.elsewhere_m:g} m from a uniform log, or have nothing in "
                 "common, next to intervals that agree",
        observable="a uniform log", limit="one", effect="cones of another recording at poses of this one: any",
        messages={"": "After frame pair {frames} the images jump and GNSS/INS does not, while both agree before and "
                      "after: images of another recording are mixed with these, or frames were lost."},
        passed="Images and GNSS/INS show the same path.", remedy="Check the names and numbers of the images.",
    ),
    Check(
        name="clock of GNSS/INS against the cameras",
        measured="offset of the clocks, from turn rates and speeds of images and log",
        observable="turns or changes of speed",
        limit="beyond 0.4 s: the motions of all images fit the log at one other time, three times as well as at any other",
        treated="above 4 sigmas and 5 ms: corrected; above 2 sigmas: added to the sigmas", unit="ms",
        effect="speed times the offset that remains; the sigmas include it",
        messages={
            "": "The clock of GNSS/INS was {size:.0f} +- {sigma:.0f} ms {order} that of the cameras; this was corrected.",
            "recorder": "Correct the synchronisation of the recorder.",
            "assumed": "The clocks were only known to {clock_ms:.0f} ms.",
            "late": "GNSS/INS shows the motions of the images {lag_s:.1f} s {order}: either the time stamps of one of them are "
                    "off by that, or images and poses were numbered differently. Correct clock.offset_s or images.start in "
                    "drive.yaml, or the numbers.",
        },
        passed="The clocks agree ({value:+.0f} +- {sigma:.0f} ms).",
        unobserved="This drive does not show the offset of the clocks; a sigma of {clock_ms:g} ms is assumed.",
    ),
    Check(
        name="distances by images and by GNSS/INS", measured="scale of the measured path relative to the log",
        observable="a path of some metres", sigmas="path.sigmas", least="path.scale_percent",
        treated="above 2 sigmas of a good calibration (`scale_sigma`) and 3 of its own: the sigmas of all positions are "
                "widened by such a drift", unit="%",
        effect="distances from the camera are wrong by that percentage, or positions drift by it",
        messages={
            "": "Distances in the images differ by {value:+.1f} +- {sigma:.1f} % from GNSS/INS. " + _LONGER,
            "covered": "The sigmas of all positions include such a drift.",
        },
        passed="Images and GNSS/INS show the same distances.",
    ),
    Check(
        name="alignment of cameras and GNSS/INS",
        measured="angle between the paths in the images and in the log",
        observable="a path of some metres", least="path.aside_deg", sigmas="path.sigmas",
        treated="above 2 sigmas of the stated attitudes and 3 of its own: the sigmas of all positions are widened by such a "
                "drift", unit="degrees", effect="the distance of a cone times the angle, or a drift of the positions",
        messages={"": "The directions of motion in the images and in GNSS/INS differ by {value:.1f} degrees {way}, "
                      "with a sigma of {sigma:.2f}: either GNSS/INS drifts by {drift_cm:.1f} cm per metre driven, or the "
                      "alignment of cameras and GNSS/INS is wrong.",
                  "covered": "The sigmas of all positions include such a drift."},
        passed="The direction of the cameras agrees with their alignment with GNSS/INS.",
        remedy="Reprocess the log, calibrate the alignment, or state how well it is known (sigmas in drive.yaml).",
        unobserved="The vehicle does not drive far enough for this check.",
    ),
    Check(
        name="roll of the cameras", measured="axis of the turns in the images relative to that in the log",
        observable="20 measured motions with turns", least="mount.roll_deg", sigmas="mount.sigmas", unit="degrees",
        effect="0.3 m per degree",
        messages={"": "In turns, the images show the cameras rolled by {value:+.2f} +- {sigma:.2f} degrees (positive: "
                      "left side up) relative to the calibration and GNSS/INS."},
        passed="In turns, the images agree with the mount of the cameras.",
        remedy="Correct body_SE3_left in rig.yaml (mount in drive.yaml; KITTI: calib_imu_to_velo.txt), or the axes of "
               "the GNSS/INS log.",
    ),
    Check(
        name="lever arm of the cameras", measured="path of the cameras in turns relative to that of the log",
        observable="turns", least="mount.lever_arm_m", sigmas="path.sigmas", unit="m",
        effect="the error of the lever arm",
        messages={"": "In turns, the images show the cameras mounted by {value:+.2f} +- {sigma:.2f} m (positive: "
                      "{way}) relative to the calibration and GNSS/INS."},
        passed="In turns, the images agree with the mount of the cameras.",
        remedy="Correct body_SE3_left in rig.yaml (mount in drive.yaml; KITTI: calib_imu_to_velo.txt), or the antenna "
               "position of the GNSS/INS log.",
    ),
    Check(
        name="aspect ratio of the images", measured="pitch of the vehicle in the images beyond that in the log",
        observable="20 measured motions of a vehicle that pitches", least="mount.stretch_percent",
        sigmas="mount.stretch_sigmas", unit="%", follows=Verdict.NOTE,
        effect="heights relative to the cameras are wrong by that percentage",
        messages={"": "In the images the vehicle pitches {value:+.0f} +- {sigma:.0f} % more than in GNSS/INS: they "
                      "were stretched vertically (wrong aspect ratio of the video?), or fy of the calibration is "
                      "wrong. Heights relative to the cameras are wrong by the same percentage."},
        passed="Images and GNSS/INS show the same pitch of the vehicle.",
        remedy="Deliver the original images, or calibrate the rig (conetl calibrate).",
    ),
    Check(
        name="heights of GNSS/INS", measured="climbs in the log as a multiple of those in the images",
        observable="hills whose slopes exceed the errors of the attitudes", least="mount.climb",
        sigmas="path.sigmas", expected=1.0, effect="heights of cones are wrong by that factor",
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
        name="driving direction", measured="intervals in which the vehicle moves backwards in the images",
        observable="trajectories with sparse records", least="odometry.max_reversed",
        effect="poses that look the other way: any",
        messages={"": "In {value:.0f} intervals, from frame pair {first} on, the images show the vehicle driving "
                      "backwards. Without attitudes, conetl computes the heading of a vehicle that drives forwards."},
        passed="The vehicle drives in the direction of its cameras.",
        remedy="Cut out the part that reverses, or record attitudes.",
    ),
    Check(
        name="cones passed twice",
        measured="common displacement of cones that the drive passes again more than {agreement.again_s:g} s later",
        observable="{agreement.least_pairs} of them, or beyond {agreement.again_gate_m:g} m {agreement.least_same} at "
                   "unequal distances, up to {agreement.again_m:g} m",
        limit="above {agreement.least_offset_m:g} m and {agreement.sigmas:g} sigmas of both", unit="m",
        effect="the displacement, in one of both passes",
        messages={"": "The drive passes {count} cones again from frame pair {first} on, and locates them {size:.2f} m "
                      "{how}: either GNSS/INS drifted or jumped in between, or all cones were moved by the same "
                      "distance."},
        passed="Cones that the drive passes twice are at the same positions.", remedy="Reprocess the GNSS/INS log.",
    ),
    Check(
        name="control points", measured="how many surveyed cones agree with each other and with the log",
        observable="surveyed points near cones", limit="[control points](../record/check_points.md#control-points)",
        follows=Verdict.NOTE,
        follows_from={
            "not adjusted": Verdict.HOLD,
            "contradict": Verdict.HOLD,
            "in height": Verdict.HOLD,
        },
        effect="the difference between points and log",
        messages={
            "none near": "None of the {count} control points is near a cone: check their CRS and height system.",
            "not adjusted": "The poses cannot be adjusted to the control points: {why}.",
            "contradict": "The control points contradict each other or GNSS/INS: {named}.",
            "only": "Only {agreeing} fit.",
            "survey": "Check the points, their datum and that of GNSS/INS, or survey more: {least} points must agree.",
            "ambiguous": "The {count} control points match the cones in more than one way: survey more points.",
            "twins": "The {count} control points match the cones in more than one way: one cone is surveyed twice "
                     "({twins}): keep one of the points.",
            "used": "{used} of {count} control points match a cone and agree: the poses are adjusted to them.",
            "in height": "GNSS/INS differs from them by {off_m:.2f} m in height only ({sigmas:.0f} sigmas of both): "
                         "were feet surveyed, not tips, with the right pole and height system? If so, accept the "
                         "drive.",
            "all along": "GNSS/INS differs from them by {off_m:.2f} m, all along the drive ({sigmas:.0f} sigmas of "
                         "both): one of the two is wrong, and the map uses the points. Check datum and base station of "
                         "both.",
            "drift": "GNSS/INS differs from them by {off_m:.2f} m ({sigmas:.0f} sigmas of both): it drifts, or jumps: "
                     "check its log.",
            "wrong": "Not used, because the others contradict them: {named}.",
        },
        passed="{used} of {count} control points match a cone and agree: the poses are adjusted to them.",
    ),
)  # fmt: skip
