"""Whether kernels are compiled is told by numba's cache."""

import os
import subprocess
import sys

SCRIPT = """
import numpy as np
from localize.compilation import _cached
from localize._numba_propagation import exp_so3
print(_cached(exp_so3))
exp_so3(np.zeros(3), np.empty((3, 3)))
print(_cached(exp_so3))
"""


def test_an_empty_cache_is_told_from_a_filled_one(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for expected in (["False", "True"], ["True", "True"]):
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == expected
