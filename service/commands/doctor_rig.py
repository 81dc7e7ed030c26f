"""Findings of the rig itself while no daemon has it: cameras on the network, the gate's port, a test pulse."""

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from statistics import median

from drivers.cameras.finding import find_camera
from drivers.cameras.genicam import GigeCameraSettings, strobe_line
from drivers.errors import DeviceError, DriverError, RecordingError
from drivers.factory import AravisBackend, LiveBackend, build_devices, build_gate
from drivers.files.rig_file import read_rig
from drivers.gvcp import DiscoveredCamera, discover
from drivers.interfaces import Camera, CameraVitals
from pipeline.frames import BundleKind, CameraId, FrameBundle
from service.acquisition.acquisition import Acquisition, AcquisitionParameters
from service.acquisition.empty_rig import EmptyRigParameters
from service.base.status import AcquisitionTarget
from service.configuration.live_rig import LiveRigSettings
from service.configuration.rig_settings import AravisRigSettings
from service.configuration.settings import Settings
from service.host.finding import Finding, HostVerdict, fault, judged, unknown
from service.host.host import Host

PULSE_S = 30.0
"""Longest time from arming to the bundle of the test pulse: opening sixteen cameras, trigger delay, transfer."""
DARK_GREY = 20.0
"""Mean grey level below which an exposure of the white sphere had no light."""
MAX_UNFLASHED_SHARE = 0.2
"""Share of a view's light that may be there without the flash, a camera's black level included.

What comes and goes with daylight then stays within the change of light that `[optics] light_change` allows.
"""
WANTED = "an image of every camera, with light"
WANTED_LIGHT = f"at most {MAX_UNFLASHED_SHARE:.0%} of the light of each view without the flash"
NOT_FIRED = (
    "where it is as dark with it, nothing is fired: check the wire from the cameras' output to the panels' driver,"
    " rig.strobe_line, the driver's supply; of a single camera its lens cap and window"
)
LIGHT_WITHOUT = (
    "where it is bright without it, the panels are always on, another output fires them, or daylight comes in: set"
    " their driver to flash at the cameras' output only, close the rig; if they are to be always on, remove"
    " rig.strobe_line"
)


def check_cameras(rig: AravisRigSettings, host: Host) -> Iterator[Finding]:
    """Check that each camera answers, is the one that is meant, and is reached through the right port."""
    sought = rig.sought_cameras()
    with ThreadPoolExecutor(len(sought)) as threads:  # one named by its serial takes half a second to find
        answers = list(zip(sought, threads.map(_find, sought), strict=True))
    found = {camera.id: answer for camera, answer in answers if not isinstance(answer, DeviceError)}
    yield judged(
        "cameras",
        is_good=len(found) == len(sought),
        found=f"{len(found)} of {len(sought)} answer",
        wanted="all that [[rig.cameras]] names",
        remedy="see below; stonefall cameras lists those that answer",
    )
    elsewhere: list[DiscoveredCamera] = []
    if len(found) < len(sought):
        with suppress(OSError):
            elsewhere = discover()
    for camera, answer in answers:
        if isinstance(answer, DeviceError):
            yield fault(
                f"camera {camera.id}",
                found=str(answer).removeprefix(f"{camera.id}: ") + _elsewhere(camera, elsewhere, host),
                wanted="answers, with what [[rig.cameras]] says of it",
                remedy="check power and cable; which camera is where: /setup#places, or stonefall init",
            )
    yield from _wrong_ports(rig, found, host)
    yield from _uncalibrated(rig, found)
    yield from _settings(rig, found)


def _find(camera: GigeCameraSettings) -> DiscoveredCamera | DeviceError:
    try:
        return find_camera(camera)
    except DeviceError as err:
        return err


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
    """Yield the cameras that are not those of the calibration; `check-config` sees given serials only."""
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


def _settings(rig: AravisRigSettings, found: Mapping[CameraId, DiscoveredCamera]) -> Iterator[Finding]:
    """Open each camera that answers, as the daemon does; yield what that changed, or why it cannot be set."""
    try:
        backend = rig.backend_for(read_rig(rig.calibration))
    except (DriverError, KeyError):  # is named among the problems of the configuration
        return
    if not found:
        return
    devices = build_devices(replace(backend, cameras=tuple(c for c in backend.cameras if c.id in found)))
    try:
        with ThreadPoolExecutor(len(found)) as threads:
            opened = dict(zip(devices.cameras, threads.map(_opened, devices.cameras.values()), strict=True))
    finally:
        devices.close()
    n_set = sum(isinstance(each, CameraVitals) for each in opened.values())
    yield judged(
        "settings of cameras",
        is_good=n_set == len(opened),
        found=f"{n_set} of {len(opened)} are set as configured",
        wanted="all that answer",
        remedy="see below; stonefall cameras --xml ADDRESS prints what one can be set to",
    )
    for name, each in opened.items():
        if isinstance(each, DeviceError):
            remedy = "change [rig] or its section of [[rig.cameras]]; end other programs that use it"
            yield fault(
                f"settings of {name}", found=each.problem, wanted="can be set as configured", remedy=remedy
            )
        elif each.remarks:
            yield Finding(
                subject=f"settings of {name}",
                verdict=HostVerdict.GOOD,
                found=f"{each.model}: {'; '.join(each.remarks)}",
                wanted="",
            )


def _opened(camera: Camera) -> CameraVitals | DeviceError:
    try:
        camera.open()
        return camera.examine()
    except DeviceError as err:
        return err
    finally:
        camera.close()


def check_gate(rig: LiveRigSettings) -> Finding:
    """Open the port of the light gate, wait for its answer, and close it again."""
    gate = build_gate(rig.gate.device, rig.gate_delay_us)
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
        found="; ".join(warnings) or f"{type(gate).__name__} answers{_delaying(rig)}",
        wanted=wanted,
        remedy="do what it says",
    )


def _delaying(rig: LiveRigSettings) -> str:
    return f", and triggers the cameras {rig.gate_delay_us / 1e3:.2f} ms later" if rig.gate_delay_us else ""


async def check_pulse(rig: LiveRigSettings, settings: Settings) -> list[Finding]:
    """Expose the empty rig by the gate's test pulse, and again without the flash; return what the cameras saw.

    Opening the cameras sets them as configured; those that are opened without their flash get it back when they close.
    """
    try:
        backend = rig.backend_for(read_rig(rig.calibration))
    except (DriverError, KeyError) as err:
        return [unknown("test pulse", f"not fired: {err}", WANTED)]
    parameters = AcquisitionParameters(
        session=0,
        bundling=rig.bundling_for(settings.bundling),
        min_cameras=1,
        empty_rig=EmptyRigParameters(at_start=1, every_s=0),
    )
    lit = await _exposed(backend, parameters)
    if isinstance(lit, Finding):
        return [lit]
    findings = list(_judged_pulse(lit))
    cameras = backend.cameras if isinstance(backend, AravisBackend) else ()
    if not any(strobe_line(camera.features) for camera in cameras):
        if not rig.is_simulated:
            found = "not measured: no output of the cameras fires it (rig.strobe_line)"
            findings.append(unknown("flash", found, WANTED_LIGHT))
        return findings
    off = tuple(replace(camera, is_strobe_off=True) for camera in cameras)
    unlit = await _exposed(replace(backend, cameras=off), parameters)
    if isinstance(unlit, Finding):
        return [*findings, unknown("flash", f"not measured: without it, {unlit.found}", WANTED_LIGHT)]
    return [*findings, judge_flash(_greys(lit), _greys(unlit))]


async def _exposed(backend: LiveBackend, parameters: AcquisitionParameters) -> FrameBundle | Finding:
    """Arm the rig, fire one test pulse, and disarm; return its bundle, or the fault that there is none."""
    devices = build_devices(backend)
    bundles: asyncio.Queue[FrameBundle] = asyncio.Queue()
    acquisition = Acquisition(devices, parameters, on_bundle=bundles.put_nowait)
    acquiring = asyncio.create_task(acquisition.run())
    acquisition.request(AcquisitionTarget.ARMED)
    try:
        async with asyncio.timeout(PULSE_S):
            while (bundle := await bundles.get()).kind is not BundleKind.BACKGROUND:
                pass  # a stone, which fell meanwhile
        return bundle
    except TimeoutError:
        return fault(
            "test pulse",
            found=f"no image of it within {PULSE_S:g} s{f': {acquisition.trouble}' if acquisition.trouble else ''}",
            wanted=WANTED,
            remedy="check the gate's test output and the trigger line; some gates have none (drivers/README.md)",
        )
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
    dark = {name: grey for name, grey in _greys(bundle).items() if grey < DARK_GREY}
    yield judged(
        "light",
        is_good=not dark,
        found=", ".join(f"{name} {grey:.0f}" for name, grey in dark.items()) + " grey levels"
        if dark
        else "all views are lit",
        wanted=f"mean grey of at least {DARK_GREY:g} in every view of the empty rig",
        remedy="check strobe, its supply and rig.strobe_line; take caps off the lenses",
    )


def _greys(bundle: FrameBundle) -> dict[CameraId, float]:
    return {name: float(frame.image.mean()) for name, frame in bundle.frames.items()}


def judge_flash(lit: Mapping[CameraId, float], unlit: Mapping[CameraId, float]) -> Finding:
    """Judge the flash by the mean grey levels of the views with it and without it."""
    both = [name for name in lit if name in unlit]
    if not both:
        return unknown("flash", "not measured: no camera exposed with it and without it", WANTED_LIGHT)

    def compared(names: Sequence[CameraId]) -> str:
        which = f"all {len(both)} views" if len(names) == len(both) else ", ".join(names)
        with_it, without = (median(greys[name] for name in names) for greys in (lit, unlit))
        return f"{which}: {with_it:.0f} grey levels with it, {without:.0f} without"

    dark = [name for name in both if max(lit[name], unlit[name]) < DARK_GREY]
    bright = [name for name in both if name not in dark and unlit[name] > MAX_UNFLASHED_SHARE * lit[name]]
    faults = {NOT_FIRED: dark, LIGHT_WITHOUT: bright}
    return judged(
        "flash",
        is_good=not (dark or bright),
        found="; ".join(compared(names) for names in faults.values() if names) or compared(both),
        wanted=WANTED_LIGHT,
        remedy="; ".join(remedy for remedy, names in faults.items() if names),
    )
