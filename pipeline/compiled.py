"""Loops over pixels, voxels and faces, compiled."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """The function, compiled by numba at its first call, without holding the GIL.

    What is compiled is kept for later processes in `NUMBA_CACHE_DIR`, else beside the source or in the user's
    cache folder. Where none of these can be written, every process compiles for itself.
    """
    # no fastmath: results are the same bit for bit on any number of workers; no function pointer for C, which
    # nobody asks for and which costs 7 % of the time (numba's types do not know of that option)
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no place to keep it
        return numba.njit(**options)(function)


def compiled_within(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """The function, as it is for Python, and compiled where a compiled one calls it: in a third less time."""
    options = {"error_model": "numpy", "no_cfunc_wrapper": True}
    return numba.extending.register_jitable(**options)(function)


def whole(n: int) -> int:
    """A constant for compiled loops; numba compiles callees anew for each `n` that is written out as an argument."""
    return cast(int, np.int64(n))
