"""Triggers and frames made up for the assembler of bundles: three cameras, one pixel each."""

from collections.abc import Iterable

import numpy as np

from drivers.interfaces import DeviceEvent
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Trigger
from service.bundling.assembler import BundleAssembler
from service.bundling.frame_account import CameraCounters
from service.bundling.window import BundlingParameters

CAMERAS = tuple(CameraId(f"c{i:02d}") for i in range(1, 4))
A, B, C = CAMERAS
MS = 1_000_000
DELAY_NS = round(259.4 * MS)
WINDOW_NS = 100 * MS
PARAMETERS = BundlingParameters()
QUICK = BundlingParameters(expected_delay_ms=257.4, window_ms=10, dead_time_ms=25)
"""Bundling of a rig whose gate makes the delay."""
QUICK_DELAY_NS = round(QUICK.expected_delay_ms * MS)


def trigger(sequence: int, at_ns: int, kind: BundleKind = BundleKind.PARTICLE) -> Trigger:
    return Trigger(
        sequence=sequence, received_ns=at_ns, device_ns=at_ns, utc="2026-01-01T00:00:00Z", kind=kind
    )


def frame(camera: CameraId, tag: int, at_ns: int, frame_id: int | None = None, device_ns: int = 0) -> Frame:
    """A frame whose only pixel says for which trigger it was exposed."""
    return Frame(
        camera=camera,
        image=np.full((1, 1), tag, np.uint8),
        frame_id=tag + 1 if frame_id is None else frame_id,
        device_ns=device_ns,
        received_ns=at_ns,
    )


def tags(bundle: FrameBundle) -> set[int]:
    return {int(shown.image[0, 0]) for shown in bundle.frames.values()}


def feed_all(assembler: BundleAssembler, events: Iterable[DeviceEvent]) -> list[FrameBundle]:
    return [bundle for event in events for bundle in assembler.feed(event)]


def accounted(counters: CameraCounters) -> int:
    """Frames of which the counters say what became of them."""
    c = counters
    return c.used + c.late + c.duplicates + c.extra + c.other_exposure + c.strays
