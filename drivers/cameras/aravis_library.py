"""The only importer of `gi`: Aravis through PyGObject, when the first camera is opened and not before."""

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
    """Raise Aravis' errors as `CameraUnavailableError`: `device` cannot do so, and why."""
    from gi.repository import GLib

    try:
        yield
    except GLib.Error as err:
        raise CameraUnavailableError(device, f"cannot {doing}: {err.message}") from err
