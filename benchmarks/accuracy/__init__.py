"""Accuracy of the estimators, by Monte Carlo: `python -m benchmarks.accuracy`.

Flights are flown once as arrays (`sim_bridge.ensemble`) and get noise many times; the same
estimators that the program uses take them. Case modules hold what is flown and how it is shown.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before NumPy: one thread a process, a process a core
