"""The errors of a log by the motion that images show: their shares, and what else differs between both paths.

`log_errors.py` has the model, `path_difference.py` what is compared, `path_fit.py` scale, alignment, lever arm and clock.
"""
