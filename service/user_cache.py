"""What can be fetched or made again, in the home of whoever runs this."""

import os
from pathlib import Path


def user_cache() -> Path:
    """The folder for it (XDG Base Directory Specification); `RuntimeError` for a user without a home."""
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if Path(cache).is_absolute() else Path.home() / ".cache") / "stonefall"
