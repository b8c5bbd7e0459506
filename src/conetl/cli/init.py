"""`conetl init`: make a drive of a folder with stereo video or images and a trajectory file."""

from __future__ import annotations
