"""A MuJoCo workcell in which tele-operated and autonomous arms share one space without colliding."""

import os

__version__ = "0.2.0"

# No product here is large enough to share between threads: waking OpenBLAS's costs more than the
# product, up to milliseconds on a busy machine from about 700 watched pairs on. Sums made in one
# thread are also the same on every machine. Takes effect if NumPy has not been imported yet.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
