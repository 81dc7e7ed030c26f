"""The cache in the home of the user."""

import os
from pathlib import Path


def user_cache() -> Path:
    """Return the folder of what can be fetched or made again (XDG); raise `RuntimeError` if the user has no home."""
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if Path(cache).is_absolute() else Path.home() / ".cache") / "stonefall"
