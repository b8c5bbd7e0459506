"""Commands that a user needs once: calibrate, detect, locate, evaluate, simulate.

Like all of `cli`, they may import everything; each module is one command.
"""
