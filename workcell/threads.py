"""One thread for linear algebra, set before NumPy is loaded: import this first.

The matrices of a control tick are small. Sharing one among threads gains nothing, and on a busy
machine each product then waits for the slowest thread; a run becomes several times slower.
A value set by the user is kept.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
