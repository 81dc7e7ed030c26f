"""Where compiled loops are kept: a folder for every state of the sources.

numba asks whether the file of a function has changed, not those of what the function calls, whose old code it would
go on using after an update; and what it keeps may name classes that are gone.
"""

import hashlib
import os
from pathlib import Path

FOLDER = "NUMBA_CACHE_DIR"
SOURCES = Path(__file__).parents[1] / "pipeline"


def keep_apart() -> None:
    """Lead numba into the folder of these sources within `NUMBA_CACHE_DIR`, for this process and those it starts.

    To be called before numba is imported. Without the variable the folder is beside the sources; where that cannot be
    written, numba finds a place of its own.
    """
    given = os.environ.get(FOLDER)
    if not given and not os.access(SOURCES, os.W_OK):
        return
    digest = hashlib.sha256()
    for path in sorted(SOURCES.rglob("*.py")):
        digest.update(path.read_bytes())
    folder, name = Path(given or SOURCES / "__pycache__"), digest.hexdigest()[:12]
    if folder.name != name:
        os.environ[FOLDER] = str(folder / name)
