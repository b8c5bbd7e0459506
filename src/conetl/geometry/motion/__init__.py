"""Motion of a stereo rig between frame pairs, and the adjustment of a whole trajectory.

It imports the rest of `geometry` and `model`. Start with `stereo_motion.py`; `pose_graph.py` is the last step.
"""
