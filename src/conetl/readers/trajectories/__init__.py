"""Trajectory files: results of GNSS/INS post-processing, receiver logs, tables. One module per format.

All give a `RecordedTrajectory`. Poses at the exposures of a drive are made of it in `readers/drives/poses.py`.
"""
