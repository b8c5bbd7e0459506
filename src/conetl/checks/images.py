"""Checks of the images alone, by a few frame pairs; of torn images by all."""

from __future__ import annotations

from conetl.checks.check import SHARE, Check
from conetl.model.health import CALIBRATION, Verdict

_NOT_SHOWN = "The images do not show enough for this check."
_RECORDER = "Check the recorder for buffers that are overwritten while they are read, and for lost packets."

CHECKS = (
    Check(
        name="images that can be decoded", measured="share of five pairs of which an image cannot be decoded",
        observable="always", limit="any", follows=Verdict.NOTE, unit=SHARE, effect="none: such pairs are not used",
        messages={"": "An image cannot be decoded in {lost} of {tried} frame pairs that were tried, frame pairs "
                      "{frames}. Such frame pairs are not used."},
        passed="The images can be decoded.", remedy="Copy the recording again.",
    ),
    Check(
        name="covered parts of the lenses",
        measured="share of squares of 32 px without any detail in the lower half of five pairs",
        observable="images that are sharp elsewhere", least="images.max_blank_share",
        unit=SHARE, effect="cones there are not found, and would be removed",
        messages={"": "{size:.0%} of the lower half of the {sides} images is blank, although the rest is sharp: the "
                      "lens is covered in part or dazzled, and the drive would remove cones there."},
        passed="No part of a lens is covered.",
        remedy="Clean the lens. If the vehicle itself is in view there, accept the drive.", unobserved=_NOT_SHOWN,
    ),
    Check(
        name="blurred parts of the lenses",
        measured="share of squares of 64 px in the lower half of five pairs with little structure finer than 25 px, "
                 "compared with coarser structure and with the other image",
        observable="images with structure", least="images.max_blurred_share", follows=Verdict.NOTE,
        unit=SHARE, effect="none: objects in such squares, however few, do not count as gone",
        messages={"": "{size:.0%} of the lower half of the {sides} images is blurred: a lens is smeared or wet. A cone "
                      "that is not found there does not count as gone."},
        passed="The images are sharp in all parts.", remedy="Clean the lens.",
    ),
    Check(
        name="trigger of both cameras",
        measured="features that match the right images of up to three frames before and after, in five pairs, and in "
                 "parts that visual odometry cannot follow",
        observable="images with structure, a vehicle that moves",
        limit="another frame has {stereo.fits_better} times as many", unit="frames",
        effect="distances are wrong by about the way driven between the frames",
        messages={
            "": "The right images belong to left images {apart} frames {direction}: with these {best} points match, with "
                "those of the same number {own}.",
            "part": "The right images in frame pairs {first} to {last} belong to left images {apart} frames "
                    "{direction}: with these {best} points match, with those of the same number {own}.",
        },
        passed="Left and right images were taken at the same time.", remedy="Correct the numbers of the images, or the trigger.",
        unobserved=_NOT_SHOWN,
    ),
    Check(
        name="seams in the images",
        measured="step of brightness at one row relative to those of the rows around it, in the mean of 25 images of a "
                 "side and in five of six strips",
        observable="images that move", least="images.max_seam",
        effect="cones below the seam are wrong by the way driven between two images",
        messages={"": "The images are torn at {rows}: the part below was taken at another time, usually that of the "
                      "previous image, and cones there would be wrong by the distance driven in between."},
        passed="The images have no seam.", remedy=_RECORDER, unobserved=_NOT_SHOWN,
    ),
    Check(
        name="torn images",
        measured="share of frame pairs of which at least 5 % of an image repeat the previous one with its noise while "
                 "the rest moves; after such an image also those with a seam at that row",
        observable="motion before and after", least="images.max_torn_share",
        treated="torn pairs: rejected (`image_torn`, with file and row)",
        unit=SHARE, effect="cones below are wrong by the way driven between two images",
        messages={"": "{torn} of {pairs} frame pairs are torn: below some row an image shows the previous frame, first "
                      "in {record} from about row {row} on. Other images may be torn, too."},
        passed="{torn} of {pairs} frame pairs were torn and are not used.", remedy=_RECORDER,
    ),
    Check(
        name="columns of the right images",
        measured="share of features farther right in the right image than points at infinity",
        observable="at least 50 features on equal rows", least="stereo.max_beyond_share",
        unit=SHARE, effect="all distances are wrong, in proportion to their square",
        messages={"": "{value:.0%} of the points lie up to {px:.0f} px farther right in the right image, which is "
                      "impossible even on the horizon: either the right images are shifted sideways, or the calibration "
                      "belongs to another rig."},
        passed="No point lies farther right in the right image.",
        remedy="Check whether the images were cropped, or calibrate the rig (conetl calibrate).", unobserved=_NOT_SHOWN,
    ),
    Check(
        name="distortion of the lenses",
        measured="radial distortion (k1) of the right images relative to the left ones, from rows of matched points",
        observable="at least 100 points, also far from the middle", least="stereo.max_k1", sigmas="stereo.k1_sigmas",
        effect="disparities in the corners: 4 px for a k1 of 0.02",
        messages={"": "The right images are distorted by k1 {value:+.3f} +- {sigma:.3f} relative to the left ones, "
                      "which the calibration does not explain: its lens parameters are wrong, or belong to another "
                      "rig."},
        passed="The distortion of both lenses agrees with the calibration.",
        remedy="Calibrate the rig (conetl calibrate).", unobserved=_NOT_SHOWN,
    ),
    Check(
        name="rows of the right images", measured="mean row offset of the features, up to 40 px",
        observable="at least 50 features on equal rows", least="stereo.most_rows_px",
        treated="above {stereo.least_rows_px} px: corrected", unit="px",
        effect="the sigmas include what a correction leaves; beyond it, columns in the corners are wrong, too",
        messages={
            "": "The right images lie {value:+.1f} +- {sigma:.1f} px lower than the left ones, too far to be "
                "corrected. Check whether they were cropped, or recalibrate the rig (conetl calibrate).",
            "turned": "The right images lie {value:+.1f} +- {sigma:.1f} px lower than the left ones: the right camera "
                      "has rotated. Recalibrate the rig (conetl calibrate), or check whether the images were cropped.",
        },
        passed="The rows of both images match.",
    ),
    Check(
        name="exposures of both cameras",
        measured="offset of the right camera along the path from its calibrated position, from rows of points at all "
                 "distances",
        observable="at least eight spans with points above and below the middle row", sigmas="exposures.ahead_sigmas",
        limit="above {exposures.max_ahead_share:.0%} of the baseline", unit="m",
        effect="5 ms at 13 m/s are 0.3 m in cones beside the path",
        treated="above 3 sigmas: the sigmas of all positions are widened by it",
        messages={"": "The right camera is {size:.3f} +- {sigma:.3f} m {where} its calibrated position.",
                  "either": "Either it exposes {late_ms:.1f} ms too {when} (at {speed_m_s:.1f} m/s), or the calibration is "
                            "wrong, or both cameras have different brightness curves (gamma, contrast): the speed changes too "
                            "little to tell which. Check the trigger, then calibrate the rig (conetl calibrate).",
                  "trigger": "The offset grows with the speed: it exposes {late_ms:.1f} ms too {when} (at {speed_m_s:.1f} "
                             "m/s). Trigger both cameras together.",
                  "mount": "The offset does not grow with the speed: either the camera was moved, the calibration is wrong, or "
                           "both cameras have different brightness curves (gamma, contrast). Calibrate the rig (conetl "
                           "calibrate).",
                  "covered": "The sigmas of all positions include such an offset."},
        passed="The position of the right camera agrees with the calibration.",
    ),
    Check(
        name="images of one instant",
        measured="share of objects that form pairs at the distance driven in one interval, without a third one in that "
                 "row",
        observable="more than 0.3 m driven per interval",
        limit="above {exposures.max_doubled_share:.0%} of the objects, and {exposures.least_doubled_pairs} pairs",
        unit=SHARE, effect="each object stands twice",
        messages={"": "{doubled} of {objects} objects form pairs at the distance driven in one interval: each image "
                      "shows two instants, either because the video is interlaced, or because frames were blended "
                      "when the frame rate was converted."},
        passed="No objects appear twice.", remedy="Deinterlace the video, or export it at its original frame rate.",
        unobserved="No objects appear twice.",
    ),
    Check(
        name="readout of the images",
        measured="time in which the rows of an image are exposed, from points that move by some rows over 2 m of the path, less "
                 "the stated one (`shutter`)",
        observable="a stated shutter; eight spans with points at several distances",
        treated="above `self_calibration_readout_sigmas` of its own sigmas: estimated as if it were not stated", unit="ms",
        effect="the distance driven in that time",
        messages={"": "By what moves in the images, their rows are exposed within {found_ms:.0f} +- {sigma:.0f} ms, not within "
                      "the {stated_ms:g} ms that `shutter` states. conetl uses what the images show. State readout_ms of the "
                      "data sheet of the camera (0: global shutter)."},
        passed="The images agree with the stated readout.",
    ),
    Check(
        name=CALIBRATION,
        measured="rotation and bend of the right camera, from points that are followed over 2 m of the path",
        observable="eight spans with points at several distances",
        limit="beyond its stated accuracy (chi-square `self_calibration_max_chi2`). Significant smaller ones are "
              "corrected",
        effect="the sigmas include what a correction leaves",
        messages={
            "": "{outcome}",
            "implausible": "The images contradict the calibration of the right camera by more than it is ever corrected. "
                           "{outcome} Calibrate the rig (conetl calibrate), or check whether the images were cropped or "
                           "shifted.",
        },
        passed="{outcome}",
    ),
)  # fmt: skip
