"""Rendered exposures as bundles, with counters and clocks as the devices of a rig stamp them.

The gate fires, the cameras wait for the stone to fall to the centre, expose together and transfer.
Each camera's counter starts somewhere in its 16 bits and goes on after 65535 with 1; each device's
clock has its own zero.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from types import MappingProxyType

import numpy as np

from pipeline.fall import pulse_width_ns
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Image, Trigger, rfc3339
from pipeline.synthesis.disturbance import Disturbance
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, photograph

TRIGGER_DELAY_NS = 247_400_000
"""From the light gate to the exposure: 0.3 m of free fall."""
TRANSFER_NS = 12_000_000
"""From the end of the exposure to the last packet of a 1.3 MB frame on GigE."""
TRANSFER_JITTER_NS = 1_000_000
PULSE_WIDTH_JITTER = 0.003
"""Greatest deviation of the gate's pulse from the width that follows from the stone."""
PERIOD_NS = 250_000_000
FIRST_UTC = datetime(2026, 1, 1, tzinfo=UTC)
FIRST_NS = 1_000_000_000_000
LAST_FRAME_ID = 65535


def stream(seed: int, *key: int) -> np.random.Generator:
    """Return the random stream of one item of a recording, independent of what else is in it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@dataclass(frozen=True, slots=True)
class Timing:
    """Times between the triggers of a recording, and from each to its exposure."""

    period_ns: int = PERIOD_NS
    delay_ns: int = TRIGGER_DELAY_NS


def render_bundle(
    bodies: Sequence[PlacedBody],
    simulated: RenderedRig,
    rng: np.random.Generator,
    *,
    sequence: int,
    label: str | None = None,
    timing: Timing = Timing(),
    disturbances: Mapping[CameraId, Disturbance] = MappingProxyType({}),
) -> FrameBundle:
    """Return bundle number `sequence` (from 1) of a recording, named such as `000007-flaky`.

    It is of the kind of its first body.
    """
    images = photograph(bodies, simulated, rng, disturbances)
    kind = bodies[0].body.kind if bodies else BundleKind.PARTICLE
    trigger = replace(
        _trigger(sequence, kind, label or kind.value, timing), pulse_width_ns=_pulse_width_ns(bodies, rng)
    )
    return _exposed(images, trigger, simulated, timing, rng)


def render_empty(
    simulated: RenderedRig,
    rng: np.random.Generator,
    *,
    sequence: int,
    timing: Timing = Timing(),
    disturbances: Mapping[CameraId, Disturbance] = MappingProxyType({}),
) -> FrameBundle:
    """Return a bundle of kind `background`: the empty rig, exposed on purpose."""
    images = photograph([], simulated, rng, disturbances)
    kind = BundleKind.BACKGROUND
    return _exposed(images, _trigger(sequence, kind, kind.value, timing), simulated, timing, rng)


def _trigger(sequence: int, kind: BundleKind, label: str, timing: Timing) -> Trigger:
    elapsed_ns = (sequence - 1) * timing.period_ns
    return Trigger(
        sequence=sequence,
        received_ns=FIRST_NS + elapsed_ns,
        device_ns=elapsed_ns + 40_000_000,
        utc=rfc3339(FIRST_UTC + timedelta(microseconds=elapsed_ns / 1000)),
        kind=kind,
        name=f"{sequence:06d}-{label}",
    )


def _exposed(
    images: Mapping[CameraId, Image],
    trigger: Trigger,
    simulated: RenderedRig,
    timing: Timing,
    rng: np.random.Generator,
) -> FrameBundle:
    """Return the bundle of images exposed `timing.delay_ns` after a trigger, stamped as the cameras do."""
    elapsed_ns = trigger.received_ns - FIRST_NS
    exposure_ns = round(simulated.parameters.exposure_us * 1000)
    frames = {}
    for position, (camera, image) in enumerate(images.items()):
        clock_ns, first_frame_id = _clock_zero_and_first_id(position)
        jitter_ns = int(rng.uniform(-TRANSFER_JITTER_NS, TRANSFER_JITTER_NS))
        frames[camera] = Frame(
            camera=camera,
            image=image,
            frame_id=(first_frame_id + trigger.sequence - 2) % LAST_FRAME_ID + 1,
            device_ns=clock_ns + elapsed_ns + timing.delay_ns + int(rng.integers(-500, 500)),
            received_ns=trigger.received_ns + timing.delay_ns + exposure_ns + TRANSFER_NS + jitter_ns,
        )
    return FrameBundle(trigger=trigger, frames=frames)


def without_views(bundle: FrameBundle, cameras: Sequence[CameraId], reason: str) -> FrameBundle:
    """Return the bundle as it is when these cameras delivered nothing."""
    lost = set(cameras)
    return FrameBundle(
        trigger=bundle.trigger,
        frames={camera: frame for camera, frame in bundle.frames.items() if camera not in lost},
        missing={**bundle.missing, **dict.fromkeys(cameras, reason)},
    )


def _pulse_width_ns(bodies: Sequence[PlacedBody], rng: np.random.Generator) -> int | None:
    """Return for how long bodies dropped together through the beam, oriented as photographed, close it."""
    # drawn from this range and without bodies too: the images of known seeds depend on all that is drawn
    jitter = PULSE_WIDTH_JITTER * (int(rng.integers(5_000_000)) / 2_500_000 - 1)
    if not bodies:
        return None
    heights_mm = np.concatenate([placed.world_mesh.vertices[:, 2] for placed in bodies])
    return round(pulse_width_ns(float(np.ptp(heights_mm))) * (1 + jitter))


def _clock_zero_and_first_id(position: int) -> tuple[int, int]:
    """Return the clock's zero and the first frame id of the camera at a position in the rig; some ids wrap early."""
    return 7_000_000_000 * (position + 1), 1 + (65_401 + 4_099 * position) % LAST_FRAME_ID
