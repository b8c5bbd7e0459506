"""Lane markings in a frame pair, without a network: the plane of the road, and bright bands of paint on it.

It imports the rest of `perception` and what that may import. Start with `crossings.py`.
"""
