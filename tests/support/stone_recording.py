"""Recordings of full size for benchmarks: stones rendered once, and again and again at an even pace."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from support import rendered
from support.small_recording import thumbnail_rig

from drivers.files.recording import Recording, read_bundle
from pipeline.fall import pulse_width_ns
from pipeline.frames import FrameBundle
from pipeline.synthesis.bundles import FIRST_NS, LAST_FRAME_ID, render_bundle, render_empty, stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.renderer import simulate_rig
from pipeline.synthesis.stones import stone

ROUND_STONES = 60
"""Between two exposures of the empty rig, which every round begins with."""
ROUND_GAP_S = 0.25
"""From the last trigger of a recording to the first when it is played again."""


def write_stones(
    path: Path,
    form: str,
    *,
    size_mm: float,
    n_stones: int,
    n_empty: int,
    seed: int,
    speed_mm_s: float | None = None,
) -> None:
    """Exposures of the empty rig, then stones; about a second each.

    With a speed at the gate pulses are as short as that makes them, and images have a quarter of the pixels each way.
    """
    rig, simulated = rendered.rig(), rendered.simulated()
    if speed_mm_s is not None:
        rig = thumbnail_rig()
        simulated = simulate_rig(rig, stream(seed, 2))
    made_by = {"benchmark": {"form": form, "size_mm": size_mm}}
    with rendered.recording_of(path, rig, made_by, compression="none") as writer:
        for number in range(1, n_empty + 1):
            writer.add(render_empty(simulated, stream(seed, 0, number), sequence=number))
        numbers = range(n_empty + 1, n_empty + n_stones + 1)
        for number in track(numbers, "rendering", console=Console(stderr=True), transient=True):
            rng = stream(seed, 1, number)
            placed = tumble(stone(form, size_mm, rng), rig, rng)
            bundle = render_bundle([placed], simulated, rng, sequence=number, label=form)
            if speed_mm_s is not None:
                short = replace(bundle.trigger, pulse_width_ns=pulse_width_ns(size_mm, speed_mm_s))
                bundle = replace(bundle, trigger=short)
            writer.add(bundle)


def write_paced(path: Path, recording: Recording, rate_hz: float) -> NDArray[np.float64]:
    """The recording so that, played again and again, it has so many stones a second.

    Returns when each trigger of a round is due, in s, and at its end when the next round begins.
    """
    period_s = (ROUND_STONES / rate_hz - ROUND_GAP_S) / ROUND_STONES
    empty, *stones = recording.headers
    assert recording.rig is not None
    made_by = {"benchmark": {"rate_hz": rate_hz}}
    with rendered.recording_of(path, recording.rig, made_by, compression="none") as writer:
        for position in range(ROUND_STONES + 1):
            header = stones[(position - 1) % len(stones)] if position else empty
            bundle = read_bundle(header.path, recording.camera_ids)
            writer.add(moved(bundle, position + 1, FIRST_NS + round(position * period_s * 1e9)))
    return np.append(np.arange(ROUND_STONES + 1) * period_s, ROUND_STONES * period_s + ROUND_GAP_S)


def moved(bundle: FrameBundle, sequence: int, received_ns: int) -> FrameBundle:
    """The same exposure at another place of a recording, as all counters and clocks would have told it."""
    by = sequence - bundle.trigger.sequence
    by_ns = received_ns - bundle.trigger.received_ns
    trigger = replace(
        bundle.trigger,
        sequence=sequence,
        received_ns=received_ns,
        device_ns=bundle.trigger.device_ns + by_ns,
        name=f"{sequence:06d}",
    )
    frames = {
        camera: replace(
            frame,
            frame_id=(frame.frame_id - 1 + by) % LAST_FRAME_ID + 1,
            received_ns=frame.received_ns + by_ns,
            device_ns=frame.device_ns + by_ns,
        )
        for camera, frame in bundle.frames.items()
    }
    return FrameBundle(trigger=trigger, frames=frames)
