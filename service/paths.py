"""The folder of files that can be fetched or made again."""

import os
from pathlib import Path


def user_cache() -> Path:
    """Return the folder `stonefall` of the user's cache (XDG Base Directory Specification).

    Raises
    ------
    RuntimeError
        The user has no home.
    """
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if Path(cache).is_absolute() else Path.home() / ".cache") / "stonefall"
