"""Load Aravis through PyGObject when the first camera is opened; the only module that imports `gi`."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers.errors import CameraUnavailableError, LossCause

PACKAGES = "python3-gi gir1.2-aravis-0.8"


def load_aravis(device: str) -> Any:
    """Return the module `Aravis` 0.8, with USB cameras switched off: every `open` would search that bus.

    Raises
    ------
    CameraUnavailableError
        The packages are not installed; names `device`.
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
def aravis_errors(device: str, doing: str) -> Iterator[None]:
    """Raise errors of Aravis as `CameraUnavailableError`: "`device`: cannot `doing`: reason".

    A camera that stops answering amid the calls is as silent as one that did not answer before them. Numbers beyond 64
    bits and texts that are not UTF-8, which Python and Aravis cannot exchange, are errors of the same class.
    """
    aravis = load_aravis(device)  # raises when there is no `gi` to import
    from gi.repository import GLib

    silent = (aravis.DeviceError.TIMEOUT, aravis.DeviceError.NOT_FOUND)
    try:
        yield
    except GLib.Error as err:
        if any(err.matches(aravis.device_error_quark(), code) for code in silent):
            problem = f"does not answer: cannot {doing} ({err.message})"
            raise CameraUnavailableError(device, problem, LossCause.SILENT) from err
        raise CameraUnavailableError(device, f"cannot {doing}: {err.message}") from err
    except (OverflowError, ValueError) as err:
        raise CameraUnavailableError(device, f"cannot {doing}: {err}") from err


@contextmanager
def cleared_tracebacks() -> Iterator[None]:
    """Clear the local variables of an error's traceback: as long as it lives they would hold Aravis' camera open."""
    try:
        yield
    except CameraUnavailableError as err:
        cause: BaseException | None = err
        while cause is not None:
            traceback.clear_frames(cause.__traceback__)
            cause = cause.__cause__
        raise
