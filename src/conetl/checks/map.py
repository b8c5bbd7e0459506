"""Checks of a drive against the map and the other drives on it."""

from __future__ import annotations

from conetl.checks.check import Check
from conetl.model.health import ADJOINING, AGREEMENT, Verdict

_BEYOND = "above {agreement.least_offset_m:g} m and {agreement.sigmas:g} stated sigmas"
_HEIGHTS = {
    "": (
        "Its {what} are {apart} than {those} of the map, with a stated sigma of {sigma:.2f} m: either the heights "
        "refer to another datum (ellipsoid or geoid), or the height of antenna or cameras is wrong."
    ),
}
_ONLY_SOME = "Only {count} of its cones are displaced: did its position jump where no images were taken?"
_CHECK_HEIGHTS = "Check the height system of its log, and its lever arm."
_POSITION = {
    "": (
        "Its cones are {value:.1f} m from those of the map, with a stated sigma of {sigma:.2f} m: either one of the "
        "two has a wrong position, or all cones were moved by the same distance. Check base station, datum and "
        "antenna offset of the drive."
    ),
    "turned": (
        "Its cones are {value:.1f} m from those of the map and rotated by {turn_deg:+.1f} degrees, with a stated "
        "sigma of {sigma:.2f} m: either one of the two has a wrong position, or all cones were moved by the same "
        "distance. Check base station, datum and antenna offset of the drive and heading_deg of its georeference."
    ),
}
_WIDENED = (
    "Its cones are {apart} those of the map, with a stated sigma of {sigma:.2f} m: either the drive or an earlier one is "
    "displaced (%s), or all cones were moved by the same distance. The sigmas of both now cover it, and further drives "
    "do not reduce them. When the cause is known, correct that drive and ingest it again, or revert it: then they are as "
    "small as before."
)
_TREATED = (
    "a displacement of at most {agreement.widened_max_m:g} m of cones {agreement.widened_spacing:g} times as far from "
    "each other, above {agreement.widened_least_m:g} m and {agreement.sigmas:g} stated sigmas: drive and map are fused, "
    "with sigmas enlarged by it; the drive's lane markings are not used"
)

CHECKS = (
    Check(
        name=AGREEMENT, measured="all comparisons below, when drives are merged, and again when an earlier one arrives",
        observable="objects of the map in view", limit="as stated there", effect="as stated there",
        messages={"": "The map contradicts the drive."},
        passed="The map as earlier drives left it does not contradict the drive.",
    ),
    Check(
        name=f"{AGREEMENT}: heights",
        measured="median height difference of cones at the same positions (at least half of those nearby), and from "
                 "the nearest lines of lane markings within 1 m",
        observable="one cone; {agreement.least_pairs} for less than {agreement.gross_rise_m:g} m", limit=_BEYOND,
        unit="m", effect="the difference", treated=_TREATED, remedy=_CHECK_HEIGHTS,
        messages=_HEIGHTS | {
            "widened": _WIDENED % "height of antenna or cameras, datum",
            "part": _ONLY_SOME,
        },
        passed="The heights agree with the map.",
    ),
    Check(
        name=f"{AGREEMENT}: position",
        measured="displacement of the cones at the same positions, or that makes {agreement.least_share:.0%} of the "
                 "cones of the drive, or of a part between which no cone is seen, fit those of the map: up to "
                 "{agreement.max_displacement_m:g} m and {agreement.max_turn_deg:g} degrees, of a few cones up to "
                 "{agreement.lever_m:g} m; offset across the same lane markings",
        observable="{agreement.least_pairs} cones at the same positions; else {agreement.least_agreeing}, with no "
                   "other displacement that fits as well",
        limit=_BEYOND + ", or `max_offset_m`", unit="m", effect="the displacement", treated=_TREATED,
        messages=_POSITION | {
            "widened": _WIDENED % "base station, datum, antenna offset, mount of the cameras",
            "too far": "Its cones are {value:.1f} m from those of the map. Its stated sigmas allow that, but it is too "
                       "far to tell which cone is which: process its GNSS data with corrections, or ingest the drive "
                       "into a separate map.",
            "markings": "Its lane markings are {value:.2f} m beside those of the map, with a stated sigma of "
                        "{sigma:.2f} m: either one of the two has a wrong position, or the road was repainted. Check "
                        "base station, datum and antenna offset of the drive.",
            "part": _ONLY_SOME,
        },
        passed="The positions agree with the map.",
    ),
    Check(
        name="the same cones elsewhere",
        measured="a displacement of 50 to {agreement.elsewhere_m:g} m with any rotation, after which the cones fit "
                 "those of the map to {agreement.same_zone_m:g} m; of a long drive, five parts of 40 cones. Once, when "
                 "the drive arrives",
        observable="{agreement.least_same_of_drive} cones at unequal distances",
        limit="one, and no other (if a work zone really repeats the layout of another one, accept the drive)", unit="m",
        effect="the displacement", messages=_POSITION, passed="The cones do not stand elsewhere on the map.",
    ),
    Check(
        name="heights of another section",
        measured="height difference between each cone and the nearest cone of the map within {agreement.beside_m:g} m. "
                 "Once, when the drive arrives",
        observable="cones of the map nearby",
        limit="all above {agreement.cliff_m:g} m (bridges are lower) and {agreement.sigmas:g} stated sigmas", unit="m",
        effect="the difference", messages=_HEIGHTS, remedy=_CHECK_HEIGHTS,
        passed="The heights are those of this section.",
    ),
    Check(
        name=f"{AGREEMENT}: classes", measured="objects at positions where the map has an object of another class",
        observable="{agreement.least_pairs} of them", limit="more than of the same class", unit="objects",
        effect="none on positions",
        messages={"": "Of {objects} objects at the positions of objects on the map, {others} have another class, such "
                      "as {now} instead of {was}: either the class names in the sidecar of the detector's model are in "
                      "the wrong order, or all objects were replaced."},
        passed="The classes agree with the map.", remedy="Correct the names, or accept the drive.",
    ),
    Check(
        name=f"{AGREEMENT}: moves", measured="cones, or stretches of lane markings, that the drive would move",
        observable="{agreement.least_pairs} of them", limit="more than it confirms",
        effect="the distances by which it would move them",
        messages={"": "The drive would move {moved} of the {shown} {what} that it shows: either its distances or poses "
                      "are wrong (baseline, alignment), or people moved or repainted them."},
        passed="The drive moves few objects.",
        remedy="Compare its images with the map: if people moved them, accept the drive.",
    ),
    Check(
        name=f"{AGREEMENT}: removals",
        measured="probability that the drive could not see the cones that it would remove ([below](#removals))",
        observable="{agreement.least_pairs} of them", limit="above {agreement.max_blind:.0%}",
        unit="% that it could not see them", effect="standing cones are removed",
        messages={"": "The drive would remove {removed} of the {in_view} cones in its view, and shows {seen}: either "
                      "they were cleared, or the cameras could not see them."},
        passed="The drive removes few cones.", remedy="Check the images: if the cones are gone, accept the drive.",
    ),
    Check(
        name=f"{AGREEMENT}: replaced", measured="stretches of lane markings that the drive would remove",
        observable="{agreement.least_pairs} of them",
        limit="more than it confirms, with as many others that it adds; or more than all that it shows",
        unit="stretches of lane markings", effect="standing markings are removed",
        messages={
            "": "The drive would remove {removed} stretches of lane markings, add {added} others and confirm {stayed}: "
                "either its position is wrong, or the road was repainted. Check base station, datum and antenna "
                "offset.",
            "not seen": "The drive would remove {removed} stretches of lane markings, add {added} others and confirm "
                        "{stayed}: either a lens was smeared or covered, or the paint is gone. Check the images.",
        },
        passed="The drive replaces few stretches.",
    ),
    Check(
        name="UTM zone",
        measured="share of the path on roads of the map (within 80 m of a drive) if it were one UTM zone farther. "
                 "Once, when the drive arrives",
        observable="nothing on the map within 1 km", limit="above {region.least_on_roads:.0%}", unit="degrees",
        effect="a zone",
        messages={"": "The drive is more than {far_km:g} km from everything on the map, but would be on roads of the map if it "
                      "were {size:g} degrees farther {direction}, one UTM zone."},
        passed="The drive is in its UTM zone.",
        remedy="Correct the zone of its coordinates (trajectory.crs in drive.yaml).",
    ),
    Check(
        name="distance from the rest of the map",
        measured="distance from everything on the map. Once, when the drive arrives", observable="always",
        limit="above {region.unusual_km:g} km", follows=Verdict.NOTE, effect="any; new regions are usual",
        messages={"": "Nothing else on the map is within {km:g} km of this drive: if this is not a new region, revert "
                      "it and check the CRS, zone and signs of its coordinates."},
        passed="The drive is near the rest of the map.",
    ),
    Check(
        name="one rig in two places",
        measured="distance from a drive of the same `rig_id` within a day. Once, when the drive arrives",
        observable="such a drive",
        limit="above {region.apart_m:g} m plus {region.most_m_s:g} m per second between both", unit="km",
        follows=Verdict.NOTE, effect="times or positions of one of them: any",
        messages={"": "Drive {drive_id} has the same rig (rig_id {rig_id}) and was {value:.1f} km away {when}: the "
                      "times (time zone, date) or positions of one of them are wrong."},
        passed="The rig was in one place.",
        remedy="If they were recorded by two vehicles, give the rig of one a separate rig_id in its drive.yaml.",
    ),
    Check(
        name=ADJOINING,
        measured="distance between where a drive begins and where the one before it, of the same rig and within 5 s, "
                 "leads ([below](#adjoining-drives))",
        observable="such a drive",
        limit="above {jumps.adjoining_m:g} m and {jumps.sigmas:g} sigmas, and more than a vehicle can do", unit="m",
        effect="the size of the jump, in one of both",
        messages={
            "": "This drive and drive {drive_id}, recorded right before or after it by the same cameras, are "
                "{value:.1f} m apart where one continues the other: GNSS/INS jumps there, and conetl cannot tell which "
                "of them is correct. Reprocess the GNSS/INS log and deliver the wrong drive again, or accept the "
                "correct one. If they were recorded by two vehicles, give the rig of one a separate rig_id in its "
                "drive.yaml (rig_id: NAME), and ingest that drive again.",
            "continues": "This drive continues drive {drive_id}, which is on hold because GNSS/INS jumps between it "
                         "and another drive. If that drive has a position error, this one has it too. conetl uses this "
                         "drive as soon as it uses that one.",
        },
        passed="The drive continues those before and after it.",
    ),
)  # fmt: skip
