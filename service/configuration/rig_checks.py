"""Checks of the rig's settings against its files, against physics and against the network."""

import re
from collections.abc import Iterator

import numpy as np

from drivers.errors import RecordingError
from drivers.files.recording import open_recording, require_rig_of
from drivers.files.rig_file import read_rig
from pipeline.fall import blur_px, longest_exposure_us
from pipeline.rig.cameras import RigCalibration
from service.bundling.window import TRANSFER_MS, BundlingParameters, BundlingSettings
from service.configuration.camera_wire import LARGEST_PACKET_BYTES, MOST_LOAD, RATES_HZ, Carried, carried
from service.configuration.live_rig import LiveRigSettings
from service.configuration.rig_settings import AravisRigSettings, ReplayRigSettings, RigSettings

PLACEHOLDER = re.compile(r"SERIAL-\d*")
PLACEHOLDER_PORT = "/dev/serial/by-id/usb-gate"
"""What deploy/stonefall.toml has in the place of a site's own."""
BUSY_SLACK_MS = 30.0
"""Slack of the dead time, for a gate without a clock; a stone within it is lost for lack of frames."""


def rig_problems(settings: RigSettings, bundling: BundlingSettings) -> Iterator[str]:
    """Yield the faults of the rig's settings, each with its field and the reason."""
    match settings:
        case ReplayRigSettings():
            yield from _replay_problems(settings)
        case LiveRigSettings():
            yield from _live_problems(settings, settings.bundling_for(bundling))


def _replay_problems(settings: ReplayRigSettings) -> Iterator[str]:
    """Yield the reasons why the recording cannot be replayed."""
    try:
        recording = open_recording(settings.recording)
    except RecordingError as err:
        yield f"rig.recording: {err}"
        return
    try:
        require_rig_of(recording, read_rig(settings.calibration_path), settings.calibration_path)
    except RecordingError as err:
        yield f"rig.calibration: {err}"


def _live_problems(settings: LiveRigSettings, bundling: BundlingParameters) -> Iterator[str]:
    """Yield the faults in the settings of cameras and gate."""
    yield from _placeholders(settings)
    yield from timing_problems(settings, bundling)
    try:
        calibration = read_rig(settings.calibration)
    except RecordingError as err:
        yield f"rig.calibration: {err}"
        return
    calibrated = {camera.id: camera for camera in calibration.cameras}
    if calibrated.keys() != {camera.id for camera in settings.cameras}:
        yield (
            f"rig.cameras: {', '.join(sorted(camera.id for camera in settings.cameras))} are not the cameras of"
            f" {settings.calibration}: {', '.join(sorted(calibrated))}"
        )
        return
    for place in settings.cameras:
        serial = calibrated[place.id].serial
        if place.serial and serial and place.serial != serial:
            yield (
                f"rig.cameras: {place.id} has serial number {place.serial},"
                f" but {settings.calibration} was made with {serial} in its place"
            )
    yield from blur_problems(settings, calibration)
    if isinstance(settings, AravisRigSettings):
        yield from transfer_problems(settings, calibration, bundling)


def rig_warnings(settings: RigSettings, bundling: BundlingSettings) -> Iterator[str]:
    """Yield the settings of the rig that are allowed but rarely meant, each with its field."""
    if isinstance(settings, LiveRigSettings) and not (settings.has_flash or settings.is_simulated):
        yield (
            "rig.strobe_line: no output of the cameras fires the light panels, so they must be on all the time: that is"
            " allowed, but they get hot, and shine less bright than in a flash; if they do flash, say which output"
            ' fires them (strobe_line) and how long they shine (flash_us): see "Light" in deploy/README.md'
        )
    for most in [each for each in carried_by(settings, bundling)[:1] if each.load > 1]:
        yield (
            f"rig.uplink_bytes_s: a bundle takes {most.bundle_ms:.0f} ms on the wire, but stones may come every"
            f" {1e3 / most.rate_hz:.0f} ms: at more than {MOST_LOAD * 1e3 / most.bundle_ms:.1f} a second frames"
            ' pile up in the cameras and are lost: see "The network of the cameras" in deploy/README.md'
        )


def _placeholders(settings: LiveRigSettings) -> Iterator[str]:
    """Yield the placeholders that are left of a copy of deploy/stonefall.toml."""
    copied = [camera.id for camera in settings.cameras if PLACEHOLDER.fullmatch(camera.serial or "")]
    if copied:
        yield (
            f"rig.cameras: {', '.join(copied)}: the serial numbers SERIAL-... are placeholders: `stonefall"
            " cameras` lists the cameras that answer, `stonefall init` enters them"
        )
    if settings.gate.serial is not None and settings.gate.serial.port == PLACEHOLDER_PORT:
        yield f"rig.gate.serial.port: {PLACEHOLDER_PORT} is a placeholder: ls /dev/serial/by-id shows the gate's name"


def timing_problems(settings: LiveRigSettings, bundling: BundlingParameters) -> Iterator[str]:
    """Yield the times of the bundling that do not fit the fall."""
    if bundling.dead_time_ms + BUSY_SLACK_MS < settings.busy_ms:
        yield (
            f"bundling.dead_time_ms: cameras ignore an edge for {settings.busy_ms:.1f} ms after another; a gate"
            f" without a clock has {BUSY_SLACK_MS:g} ms of slack: must be at least"
            f" {settings.busy_ms - BUSY_SLACK_MS:.0f}, not {bundling.dead_time_ms:g}"
        )
    if abs(bundling.expected_delay_ms - settings.exposed_ms) > max(bundling.window_ms / 2, TRANSFER_MS):
        yield (
            f"bundling.expected_delay_ms: frames come {settings.exposed_ms:.1f} ms after their trigger"
            f" (fall of {settings.fall_height_mm:g} mm), not {bundling.expected_delay_ms:g}"
        )


def blur_problems(settings: LiveRigSettings, calibration: RigCalibration) -> Iterator[str]:
    """Yield a problem when a stone moves too far during the exposure."""
    lit_us = (settings.flash_us or settings.exposure_us) + settings.trigger_skew_us
    speed = settings.fall.speed_at_center_mm_s
    pixel_mm = min(
        float(np.linalg.norm(camera.center_mm)) / float(camera.K[1, 1]) for camera in calibration.cameras
    )
    blur = blur_px(lit_us, speed_mm_s=speed, pixel_mm=pixel_mm)
    if blur > settings.max_blur_px:
        longest_us = longest_exposure_us(settings.max_blur_px, speed_mm_s=speed, pixel_mm=pixel_mm)
        yield (
            f"rig.exposure_us: {lit_us:g} us of light and skew blur a stone of {speed / 1e3:.2f} m/s by"
            f" {blur:.1f} px; rig.max_blur_px = {settings.max_blur_px:g} allows {longest_us:.0f} us:"
            " shorten the exposure, or set rig.flash_us for a short strobe"
        )


def transfer_problems(
    settings: AravisRigSettings, calibration: RigCalibration, bundling: BundlingParameters
) -> Iterator[str]:
    """Yield a problem when the frames of a trigger overrun the switch before the uplink, or arrive too late."""
    wire = settings.wire_for(calibration, negotiated_bytes=LARGEST_PACKET_BYTES)
    waiting_bytes = wire.queued_bytes(bundling.dead_time_ms)
    if waiting_bytes > wire.buffer_bytes:
        uplink_mb_s = wire.uplink_bytes_s / 1e6
        yield (
            f"rig.packet_delay_ns: {wire.n_cameras} cameras send {wire.sent_bytes_s / 1e6:.0f} MB/s at once, the uplink"
            f" takes {uplink_mb_s:.0f}, and {waiting_bytes / 1e6:.1f} MB wait in the switch, which holds"
            f" {wire.buffer_bytes / 1e6:.1f} (rig.switch_buffer_bytes): set it to {wire.paced().packet_delay_ns} or"
            f" more, or rig.throughput_limit_bytes_s to {uplink_mb_s / wire.n_cameras:.1f} MB/s or less"
        )
    frame_ms = settings.wire_for(calibration).frame_ms
    if frame_ms > bundling.window_ms + max(0.0, bundling.expected_delay_ms - settings.exposed_ms):
        yield (
            f"rig.packet_delay_ns: a frame takes {frame_ms:.0f} ms to arrive,"
            f" more than bundling.window_ms = {bundling.window_ms:g}"
        )


def carried_by(settings: RigSettings, bundling: BundlingSettings) -> list[Carried]:
    """Return the load of the network at the most stones a second that the rig takes, and at common rates.

    Empty for a recording, and without a rig file, which has the image sizes.
    """
    if not isinstance(settings, AravisRigSettings):
        return []
    try:
        wire = settings.wire_for(read_rig(settings.calibration))
    except RecordingError:
        return []
    dead_ms = settings.bundling_for(bundling).dead_time_ms
    return [carried(wire, rate_hz, dead_ms) for rate_hz in (1e3 / dead_ms, *RATES_HZ)]
