"""Commands that a user needs once: calibrate, rig, detect, locate, evaluate, lidar-check, simulate."""
