"""State of the cameras as the REST interface returns it: what each one says, what was counted, how well it sees."""

from pipeline.frames import CameraId
from service.base.messages import Said
from service.base.status import DeviceState, Ne107, Report


class CameraOptics(Report):
    """How well a camera sees: medians of the latest 20 exposures, null before the fifth.

    They are compared with the clean rig: the first exposures with these optical settings, as long as the
    background is kept.
    """

    brightness: float | None = None
    """Light on the wall beside the stone, 1: as in the clean rig"""
    gradient_u: float | None = None
    """Change of the brightness from the left border to the right one"""
    gradient_v: float | None = None
    """Change of the brightness from the upper border to the lower one"""
    flicker: float | None = None
    """Standard deviation of the brightness from exposure to exposure"""
    dust: float | None = None
    """Share of the light lost in patches, 0..1"""
    spots_share: float | None = None
    """Share of the view darker than its surroundings, 0..1"""
    saturated_share: float | None = None
    """Share of all pixels that are saturated, 0..1"""
    noise_grey: float | None = None
    """Noise of a pixel, grey levels"""
    edge_width_px: float | None = None
    """Width of outlines from 10 to 90 %, px"""
    edge_width_u_px: float | None = None
    """The same across u: greater than across v where stones or camera move along u"""
    edge_width_v_px: float | None = None
    """The same across v"""
    contrast: float | None = None
    """Contrast of stone and wall at the outline, share of the wall's level"""


class CameraStatus(Report):
    """State of one camera; counters begin when the daemon starts, unless a field says otherwise."""

    id: CameraId
    """Place of the camera in the rig, such as `c01`"""
    state: DeviceState
    """Whether it exposes, is closed, or does not answer"""
    ne107: Ne107 = Ne107.GOOD
    """Its state in the terms of NAMUR NE 107"""
    last_error: Said | None = None
    """Why it was last lost; null when it never was"""
    recoveries: int = 0
    """How often it came back from a loss"""
    serial: str | None = None
    """Serial number; null while unknown"""
    model: str | None = None
    """Vendor's name of the model; null while unknown"""
    address: str | None = None
    """Its network address; null while unknown"""
    frames: int = 0
    """Frames that arrived complete"""
    fps: float = 0.0
    """Frames per second over the last ten seconds"""
    lost: int = 0
    """Frames reported lost"""
    late: int = 0
    """Frames that came after their bundle was closed"""
    duplicates: int = 0
    """Frames that came twice"""
    missing: int = 0
    """Bundles without a frame of this camera"""
    strays: int = 0
    """Frames without a trigger"""
    not_exposed: int = 0
    """Triggers that it did not expose for, by its frame ids"""
    unannounced: int = 0
    """Exposures without a trigger, by its frame ids"""
    failed_frames: int = 0
    """Frames received in part, since it was opened"""
    missing_packets: int = 0
    """Packets that never came, since it was opened"""
    resent_packets: int = 0
    """Packets that came when requested again, since it was opened"""
    receive_buffer_bytes: int | None = None
    """Size of its socket's buffer, as the kernel granted it"""
    temperature_c: float | None = None
    """Temperature of the camera, °C; null when it reports none"""
    ptp_status: str | None = None
    """State of its PTP clock as the camera names it, such as `Slave`; null without PTP"""
    ptp_offset_ns: int | None = None
    """Offset from the PTP master's clock; null without PTP"""
    latency_ms: float | None = None
    """From trigger to arrival, mean of the latest 64 bundles"""
    latency_min_ms: float | None = None
    """The least of these, ms"""
    latency_max_ms: float | None = None
    """The greatest of these, ms"""
    last_frame_age_s: float | None = None
    """Seconds since the last frame; null before it"""
    skew_us: float | None = None
    """Time of its exposures from those of the others; 20 us are a pixel of fall"""
    tangency_px: float | None = None
    """Epipolar residual of its outlines, median of the latest 20 stones; from 0.3 it has moved"""
    tangency_drift_px: float | None = None
    """Its rise since the first 20 stones after the start or the activation of this calibration"""
    residual_px: float | None = None
    """Distance by which its outlines leave the hull of the other views, median of the latest 20 stones"""
    residual_drift_px: float | None = None
    """Its rise since the first 20 stones after the start or the activation of this calibration"""
    optics: CameraOptics | None = None
    """How well it sees"""
    warnings: tuple[Said, ...] = ()
    """What works but needs attention, with the remedy"""
    remarks: tuple[Said, ...] = ()
    """What opening it changed, such as a mirrored image that another program had left on, or did in another way"""
