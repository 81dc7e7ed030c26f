"""Compiling loops over pixels, voxels and faces with numba."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function with numba at its first call, to run without holding the GIL.

    What is compiled is kept for later processes in `NUMBA_CACHE_DIR`, else beside the source or in the user's
    cache folder. Where none of these can be written, every process compiles for itself.
    """
    # no fastmath: results are the same bit for bit on any number of workers; no function pointer for C, which is
    # not used and costs 7 % of the time (numba's types lack that option)
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder to keep it in can be written
        return numba.njit(**options)(function)


def compiled_within(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function with numba only where a compiled one calls it, which takes a third less time.

    From Python it is called as it is.
    """
    options = {"error_model": "numpy", "no_cfunc_wrapper": True}
    return numba.extending.register_jitable(**options)(function)


def whole(n: int) -> int:
    """Return a constant for compiled loops: numba would compile callees anew for each `n` written as an argument."""
    return cast(int, np.int64(n))
