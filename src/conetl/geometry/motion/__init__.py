"""Motion of a stereo rig between frame pairs, and the adjustment of a whole trajectory.

It imports the rest of `geometry` and `model`. The story begins in `stereo_motion.py` and ends in `pose_graph.py`.
"""
