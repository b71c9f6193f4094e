"""Whether numba has compiled the kernels before: the first run after an installation takes half a minute longer."""

from __future__ import annotations

from pathlib import Path

from numba.core.dispatcher import Dispatcher

from localize._numba_dust import cubes
from localize._numba_knowledge import beyond_noise, new_share
from localize._numba_propagation import deskew, propagate
from localize._numba_voxels import crosses, downsample, insert, point_to_shape


def kernels_compiled() -> bool:
    """Whether the kernels of the odometry lie in numba's cache, made from their source as it is now."""
    kernels = (propagate, deskew, downsample, insert, point_to_shape, beyond_noise, crosses, cubes, new_share)
    return all(_cached(kernel) for kernel in kernels)


def _cached(kernel: Dispatcher) -> bool:
    code = kernel.py_func.__code__
    source = Path(code.co_filename)
    name = f"{source.stem}.{code.co_name}-{code.co_firstlineno}.*.nbi"
    made = source.stat().st_mtime
    return any(index.stat().st_mtime >= made for index in Path(str(kernel.stats.cache_path)).glob(name))
