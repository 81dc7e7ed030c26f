"""The server that worker processes are forked from: started before the first one, and again when it was killed."""

import multiprocessing
import os
import sys
from multiprocessing import forkserver


def import_for_workers(module: str) -> None:
    """Start the server that workers are forked from; it imports the module in parallel with this process."""
    multiprocessing.set_forkserver_preload([module])
    ensure_fork_server()


def ensure_fork_server() -> None:
    """Start the server if it does not run, or does not any more; what it imports stays the same."""
    its_own = {
        "PYTHONSAFEPATH": "1",  # otherwise it would import from the working directory first
        "PYTHONPATH": os.pathsep.join(sys.path),
        "OPENBLAS_NUM_THREADS": "1",  # otherwise it has a thread, with which it must not be forked
    }
    before = {name: os.environ.get(name) for name in its_own}
    os.environ |= its_own
    try:
        forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
