"""Health checks of a drive by the motion that its images show: poses, jumps, mount, exposures, images of another recording.

It imports the rest of `tracking`. Start with `poses.py`.
"""
