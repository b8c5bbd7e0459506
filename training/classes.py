"""What is labelled, taught and found."""

#: In the order of the network's score channels.
CLASSES = (
    "traffic_cone", "tubular_marker", "drum", "vertical_panel", "barricade", "work_zone_sign", "arrow_board", "traffic_sign",
)  # fmt: skip
ALL_CLASSES = 2 ** len(CLASSES) - 1
#: What labels/CLIP.csv holds besides: regions of objects that cannot be separated, and frames without anything.
IGNORED, NOTHING = "ignore", "nothing"
