"""The lock of a store: on its folder itself, because a file in it can be deleted while a daemon runs."""

import fcntl
import os
from pathlib import Path

from service.base.errors import StoreError


def lock_store(state_dir: Path) -> int:
    """Lock the folder for this process and return the descriptor to close at the end.

    Raises
    ------
    StoreError
        Another process has it locked.
    """
    descriptor = os.open(state_dir, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as err:
        os.close(descriptor)
        raise StoreError(
            f"{state_dir}: another process has the store open: stop it, or choose another store.dir"
        ) from err
    return descriptor


def is_locked(state_dir: Path) -> bool:
    """True while a process has the store open; False when there is no such folder."""
    try:
        descriptor = lock_store(state_dir)
    except StoreError:
        return True
    except OSError:
        return False
    os.close(descriptor)
    return False
