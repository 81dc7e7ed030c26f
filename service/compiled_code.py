"""Where compiled loops are kept: a folder for every state of the sources.

numba asks whether the file of a function has changed, not those of what the function calls, whose old code it would
go on using after an update; and what it keeps may name classes that are gone.
"""

import hashlib
import os
from pathlib import Path

from service.user_cache import user_cache

FOLDER = "NUMBA_CACHE_DIR"
SOURCES = Path(__file__).parents[1] / "pipeline"


def keep_apart() -> None:
    """Lead numba into the folder of these sources within `NUMBA_CACHE_DIR`, for this process and those it starts.

    To be called before numba is imported. Without the variable the folder is beside the sources; where that cannot be
    written, in the user's cache. For a user without a home numba finds a place of its own.
    """
    if given := os.environ.get(FOLDER):
        folder = Path(given)
    elif os.access(SOURCES, os.W_OK):
        folder = SOURCES / "__pycache__"
    else:
        try:
            folder = user_cache() / "numba"
        except RuntimeError:
            return
    digest = hashlib.sha256()
    for path in sorted(SOURCES.rglob("*.py")):
        digest.update(path.read_bytes())
    name = digest.hexdigest()[:12]
    if folder.name != name:
        os.environ[FOLDER] = str(folder / name)
