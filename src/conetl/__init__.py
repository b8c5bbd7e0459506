"""conetl: stereo survey drives in, a versioned HD map of traffic cones out."""

import os

# Tasks run side by side on all cores. A linear algebra library would start as many threads for each of them, and how it shares
# sums among cores shows in their last bits: results would depend on the machine. It reads this when numpy or scipy is imported
# for the first time; a number of one's own stays.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
