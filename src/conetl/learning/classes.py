"""What is labelled, taught and found."""

#: In the order of the network's score channels.
CLASSES = (
    "traffic_cone", "tubular_marker", "drum", "vertical_panel", "barricade", "work_zone_sign", "arrow_board", "traffic_sign",
)  # fmt: skip
ALL_CLASSES = 2 ** len(CLASSES) - 1
#: All of them, also where large objects are searched: what is nobody's judgement is not taught at any size.
EVERY_SIZE = ALL_CLASSES + 2 ** len(CLASSES)
