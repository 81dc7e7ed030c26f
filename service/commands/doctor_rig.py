"""Findings of the rig itself while no daemon has it: cameras on the network, the gate's port, a test pulse."""

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from drivers.cameras.finding import find_camera
from drivers.cameras.genicam import GigeCameraSettings
from drivers.errors import DeviceError, DriverError, RecordingError
from drivers.factory import build_devices, build_gate
from drivers.files.rig_file import read_rig
from drivers.gvcp import DiscoveredCamera, discover
from pipeline.frames import BundleKind, CameraId, FrameBundle
from service.acquisition.acquisition import Acquisition
from service.acquisition.empty_rig import EmptyRigParameters
from service.acquisition.triggers import NoAccounting
from service.configuration.rig_settings import AravisRigSettings
from service.configuration.settings import Settings
from service.host.finding import Finding, fault, judged, unknown
from service.host.host import Host
from service.status import AcquisitionTarget

PULSE_S = 30.0
"""Longest time from arming to the bundle of the test pulse: opening sixteen cameras, trigger delay, transfer."""
DARK_GREY = 20.0
"""Mean grey level below which an exposure of the white sphere had no light."""


def check_cameras(rig: AravisRigSettings, host: Host) -> Iterator[Finding]:
    """Yield how many cameras answer, and each that does not, or is another one, or behind another port."""
    sought = rig.sought_cameras()
    with ThreadPoolExecutor(len(sought)) as threads:  # one named by its serial takes half a second to find
        answers = list(threads.map(_find, sought))
    found = {
        camera.id: answer
        for camera, answer in zip(sought, answers, strict=True)
        if not isinstance(answer, DeviceError)
    }
    yield judged(
        "cameras",
        is_good=len(found) == len(sought),
        found=f"{len(found)} of {len(sought)} answer",
        wanted="all that [[rig.cameras]] names",
        remedy="see below; stonefall cameras lists those that answer",
    )
    elsewhere = _everywhere() if len(found) < len(sought) else []
    for camera, answer in zip(sought, answers, strict=True):
        if isinstance(answer, DeviceError):
            yield fault(
                f"camera {camera.id}",
                found=str(answer).removeprefix(f"{camera.id}: ") + _elsewhere(camera, elsewhere, host),
                wanted="answers, with what [[rig.cameras]] says of it",
                remedy="check power and cable; which camera is where: /setup#places, or stonefall init",
            )
    yield from _wrong_ports(rig, found, host)
    yield from _uncalibrated(rig, found)


def _find(camera: GigeCameraSettings) -> DiscoveredCamera | DeviceError:
    try:
        return find_camera(camera)
    except DeviceError as err:
        return err


def _everywhere() -> list[DiscoveredCamera]:
    with suppress(OSError):
        return discover()
    return []


def _elsewhere(camera: GigeCameraSettings, answering: Sequence[DiscoveredCamera], host: Host) -> str:
    """Return where the camera of this serial number or name is instead, in words; empty if it is nowhere."""
    for device in answering:
        if (camera.serial or camera.user_name) in (device.serial, device.user_name):
            ports = ", ".join(host.interfaces_to(device.address)) or "no port of this machine's"
            return f"; it answers at {device.address}, behind {ports}"
    return ""


def _wrong_ports(
    rig: AravisRigSettings, found: Mapping[CameraId, DiscoveredCamera], host: Host
) -> Iterator[Finding]:
    ours = {port for address in rig.interfaces for port in host.interfaces_to(address)}
    for name, device in found.items():
        ports = set(host.interfaces_to(device.address))
        if ours and ports and not ours & ports:
            yield fault(
                f"camera {name}",
                found=f"{device.address} is behind {', '.join(sorted(ports))}",
                wanted=f"behind {', '.join(sorted(ours))}, as rig.interfaces says",
                remedy="plug it into the cameras' switch, or add this machine's address there to rig.interfaces",
            )


def _uncalibrated(rig: AravisRigSettings, found: Mapping[CameraId, DiscoveredCamera]) -> Iterator[Finding]:
    """Yield which cameras are not those of the calibration, which `check-config` sees for given serials only."""
    try:
        calibrated = {camera.id: camera.serial for camera in read_rig(rig.calibration).cameras}
    except RecordingError:  # is named among the problems of the configuration
        return
    for name, device in found.items():
        if (serial := calibrated.get(name)) and serial != device.serial:
            yield fault(
                f"camera {name}",
                found=f"serial number {device.serial}",
                wanted=f"{serial}, with which {rig.calibration} was made",
                remedy="put the cameras back in their places, or calibrate anew: stonefall calibration start",
            )


def check_gate(rig: AravisRigSettings) -> Finding:
    """Open the port of the light gate, wait for its answer, and close it again."""
    gate = build_gate(rig.gate.device)
    wanted = "its port opens, it answers, its beam is open"
    try:
        gate.open()
        warnings = gate.warnings
    except DeviceError as err:
        return fault(
            "gate",
            found=str(err),
            wanted=wanted,
            remedy="check plug, cable, power and [rig.gate]; end other programs that use the port",
        )
    finally:
        gate.close()
    return judged(
        "gate",
        is_good=not warnings,
        found="; ".join(warnings) or f"{type(gate).__name__} answers",
        wanted=wanted,
        remedy="clear the beam, clean and align sensor and light",
    )


async def check_pulse(settings: Settings) -> list[Finding]:
    """Arm the rig, fire the gate's test pulse once, and return which cameras exposed, and whether there was light."""
    wanted = "an image of every camera, with light"
    try:
        calibration = read_rig(settings.rig.calibration_path)
        devices = build_devices(settings.rig.backend_for(calibration))
    except (DriverError, KeyError) as err:
        return [unknown("test pulse", f"not fired: {err}", wanted)]
    bundles: asyncio.Queue[FrameBundle] = asyncio.Queue()
    acquisition = Acquisition(
        devices,
        session=0,
        triggers=NoAccounting(),
        bundling=settings.rig.bundling_for(settings.bundling),
        min_cameras=1,
        empty_rig=EmptyRigParameters(at_start=1, every_s=0),
        on_bundle=bundles.put_nowait,
        on_progress=lambda: None,
    )
    acquiring = asyncio.create_task(acquisition.run())
    acquisition.request(AcquisitionTarget.ARMED)
    try:
        async with asyncio.timeout(PULSE_S):
            while (bundle := await bundles.get()).kind is not BundleKind.BACKGROUND:
                pass  # a stone, which fell meanwhile
        return list(_judged_pulse(bundle))
    except TimeoutError:
        return [
            fault(
                "test pulse",
                found=f"no image of it within {PULSE_S:g} s{f': {acquisition.trouble}' if acquisition.trouble else ''}",
                wanted=wanted,
                remedy="check the gate's test output and the trigger line; some gates have none (drivers/README.md)",
            )
        ]
    finally:
        acquisition.stop()
        if not (await asyncio.wait([acquiring], timeout=PULSE_S))[0]:  # a device hangs
            acquisition.abandon()
        await acquiring
        await asyncio.to_thread(devices.close)


def _judged_pulse(bundle: FrameBundle) -> Iterator[Finding]:
    n_cameras = len(bundle.frames) + len(bundle.missing)
    yield judged(
        "test pulse",
        is_good=not bundle.missing,
        found=f"{len(bundle.frames)} of {n_cameras} cameras exposed"
        + "".join(f"; {name}: {reason}" for name, reason in bundle.missing.items()),
        wanted="all of them",
        remedy="check the trigger line of those cameras, and rig.trigger",
    )
    dark = {
        name: grey for name, frame in bundle.frames.items() if (grey := float(frame.image.mean())) < DARK_GREY
    }
    yield judged(
        "light",
        is_good=not dark,
        found=", ".join(f"{name} {grey:.0f}" for name, grey in dark.items()) + " grey levels"
        if dark
        else "all views are lit",
        wanted=f"mean grey of at least {DARK_GREY:g} in every view of the empty rig",
        remedy="check strobe, its supply and rig.strobe_line; take caps off the lenses",
    )
