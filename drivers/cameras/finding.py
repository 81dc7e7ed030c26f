"""Find the camera on the network that belongs in a place of the rig."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from drivers import gvcp
from drivers.cameras.genicam import GigeCameraSettings
from drivers.errors import CameraUnavailableError, LossCause

SIMULATED_VENDORS = frozenset({"Stonefall", "Aravis"})
"""Vendors of cameras that are programs: `drivers.gige_simulator`, and Aravis' own fake camera."""


def find_camera(
    settings: GigeCameraSettings, last: gvcp.DiscoveredCamera | None = None
) -> gvcp.DiscoveredCamera:
    """Find the camera that the settings name: at its address, where it was `last`, or by broadcast.

    Raises
    ------
    CameraUnavailableError
        None answers, several match, the one at the address is another one, or it is simulated in a rig that is not.
    """
    found = _find(settings, last)
    if found.vendor in SIMULATED_VENDORS and not settings.may_be_simulated:
        raise CameraUnavailableError(
            settings.id,
            f"is a simulated camera, {_named(found)}, in a rig that is not simulated: switch it off; if it shall be"
            " used, set rig.is_simulated = true, which marks all results",
            LossCause.WRONG_CAMERA,
        )
    return found


def are_simulated(cameras: Sequence[GigeCameraSettings]) -> bool:
    """True when at least one of these cameras answers now, and all that answer are simulated."""
    addresses = [camera.address for camera in cameras if camera.address]
    with ThreadPoolExecutor(max(len(addresses), 1)) as asking:  # those that are off cost their time once
        seen = [there for there in asking.map(gvcp.probe, addresses) if there]
    if not all(camera.address for camera in cameras):
        with suppress(OSError):  # an interface that is down: none answers
            seen += gvcp.discover(cameras[0].interfaces or None)
    ours = [
        device
        for device in seen
        if any(camera.address in (None, device.address) and _agrees(device, camera) for camera in cameras)
    ]
    return bool(ours) and all(device.vendor in SIMULATED_VENDORS for device in ours)


def _find(settings: GigeCameraSettings, last: gvcp.DiscoveredCamera | None) -> gvcp.DiscoveredCamera:
    if settings.address:
        there = gvcp.probe(settings.address)
        if there is None:
            raise CameraUnavailableError(
                settings.id,
                f"does not answer at {settings.address}: check its power, its cable and its IP address",
                LossCause.SILENT,
            )
        if not _agrees(there, settings):
            raise CameraUnavailableError(
                settings.id,
                f"should be {_wanted(settings)}, but the camera there is {_named(there)}",
                LossCause.WRONG_CAMERA,
            )
        return there
    if last is not None and (there := gvcp.probe(last.address)) and _agrees(there, settings):
        return there
    try:
        seen = gvcp.discover(settings.interfaces or None)
    except OSError as err:  # an address of this machine disappears while its network port is down
        raise CameraUnavailableError(settings.id, str(err), LossCause.SILENT) from err
    matching = [device for device in seen if _agrees(device, settings)]
    if len(matching) == 1:
        return matching[0]
    if matching:
        raise CameraUnavailableError(
            settings.id,
            f"is ambiguous: {_wanted(settings)} are {_list(matching)}; give the serial number",
            LossCause.WRONG_CAMERA,
        )
    raise CameraUnavailableError(
        settings.id,
        f"{_wanted(settings)} does not answer; found {_list(seen) or 'no camera at all'}: check its power, its cable, "
        "and that it has an address in the network of this machine's port",
        LossCause.SILENT,
    )


def _agrees(device: gvcp.DiscoveredCamera, settings: GigeCameraSettings) -> bool:
    return settings.serial in (None, device.serial) and settings.user_name in (None, device.user_name)


def _wanted(settings: GigeCameraSettings) -> str:
    parts = (
        ("serial", settings.serial),
        ("user name", settings.user_name),
        ("address", settings.address),
    )
    return ", ".join(f"{what} {value}" for what, value in parts if value)


def _named(device: gvcp.DiscoveredCamera) -> str:
    user_name = f" ({device.user_name})" if device.user_name else ""
    return f"serial {device.serial}{user_name} at {device.address}"


def _list(devices: Iterable[gvcp.DiscoveredCamera]) -> str:
    return ", ".join(map(_named, devices))
