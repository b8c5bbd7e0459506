"""Commands that a user needs once: calibrate, detect, locate, evaluate, simulate. Each module is one command."""
