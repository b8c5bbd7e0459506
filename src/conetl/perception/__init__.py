"""Images to detections and motions: decoding, the detector with its passes, calibration boards, visual odometry.

It imports `files`, `geometry` and `model`; only `detector.py` imports onnxruntime. Start with `images.py` and
`detector.py`.
"""
