"""The only importer of `gi`: Aravis through PyGObject, when the first camera is opened and not before."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers.errors import CameraUnavailableError

PACKAGES = "python3-gi gir1.2-aravis-0.8"


def load_aravis(device: str) -> Any:
    """Return the module `Aravis` 0.8, told to leave USB alone: every open would search that bus.

    Raises `CameraUnavailableError` in the name of `device` when the packages are not installed.
    """
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as err:
        problem = f"Aravis 0.8 is missing ({err}): apt-get install {PACKAGES}"
        raise CameraUnavailableError(device, problem) from err
    Aravis.disable_interface("USB3Vision")
    return Aravis


@contextmanager
def explained(device: str, doing: str) -> Iterator[None]:
    """Raise Aravis' errors as `CameraUnavailableError`: `device` cannot do so, and why.

    So are numbers beyond 64 bits and texts that are not UTF-8, which Python and Aravis cannot exchange.
    """
    load_aravis(device)  # says so when there is no `gi` to import from
    from gi.repository import GLib

    try:
        yield
    except (GLib.Error, OverflowError, ValueError) as err:
        why = err.message if isinstance(err, GLib.Error) else err
        raise CameraUnavailableError(device, f"cannot {doing}: {why}") from err


@contextmanager
def forgetful() -> Iterator[None]:
    """Clear the local variables an error's traceback keeps: it would keep the camera, and our control of it."""
    try:
        yield
    except CameraUnavailableError as err:
        cause: BaseException | None = err
        while cause is not None:
            traceback.clear_frames(cause.__traceback__)
            cause = cause.__cause__
        raise
