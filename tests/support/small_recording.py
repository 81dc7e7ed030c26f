"""A small synthetic recording with stones, for tests that need real images."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from support.render_cache import kept_rendered
from support.rendered import recording_of

from pipeline.fall import Fall, pulse_width_ns
from pipeline.frames import CameraId, FrameBundle, NearStone, Trigger
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.bodies import Body, ball, cube, sphere
from pipeline.synthesis.bundles import render_bundle, render_empty, stream
from pipeline.synthesis.placement import drop_across, tumble
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, simulate_rig

SHRINK = 4
MADE_BY = {"test": "small_recording"}


def thumbnail_rig() -> RigCalibration:
    """The rig as built, with a quarter of the pixels in each direction: everything is ten times as fast."""
    return _thumbnail(as_built(nominal_rig(), 1))


def _thumbnail(rig: RigCalibration) -> RigCalibration:
    """Serial numbers are this process': another one may simulate cameras at the same time."""
    cameras = (replace(_shrunk(camera), serial=f"T{os.getpid()}-{camera.id}") for camera in rig.cameras)
    return replace(rig, cameras=tuple(cameras))


def _shrunk(camera: CameraCalibration) -> CameraCalibration:
    # centres of pixels are on integers, so the image begins at -0.5
    scale = np.array([[1 / SHRINK, 0, 0.5 / SHRINK - 0.5], [0, 1 / SHRINK, 0.5 / SHRINK - 0.5], [0, 0, 1]])
    width_px, height_px = camera.image_size_px
    return replace(camera, image_size_px=(width_px // SHRINK, height_px // SHRINK), K=scale @ camera.K)


@cache
def _simulated() -> RenderedRig:
    return simulate_rig(thumbnail_rig(), stream(1, 0))


@kept_rendered
def _empty(number: int) -> FrameBundle:
    return render_empty(_simulated(), stream(1, 1, number), sequence=number)


@kept_rendered
def _sphere(number: int) -> FrameBundle:
    """One exposure of a falling sphere, which takes a third of a second."""
    rng = stream(1, 2, number)
    placed = tumble(sphere(), _simulated().rig, rng)
    return render_bundle([placed], _simulated(), rng, sequence=number, label="sphere")


def write_small_recording(
    path: Path,
    *,
    n_stones: int,
    n_backgrounds: int = 2,
    dimmed: Mapping[CameraId, float] = MappingProxyType({}),
    pulse_ms: float | None = None,
) -> None:
    """Spheres falling through the rig as built, after some exposures of the empty rig; then the `dimmed` go dark.

    `pulse_ms`: how long each closes the beam, if not for as long as one that falls from rest.
    """
    with recording_of(path, thumbnail_rig(), MADE_BY) as writer:
        for number in range(1, n_backgrounds + 1):
            writer.add(_empty(number))
        for number in range(n_backgrounds + 1, n_backgrounds + n_stones + 1):
            bundle = _sphere(number)
            if pulse_ms is not None:
                short = replace(bundle.trigger, pulse_width_ns=round(pulse_ms * 1e6))
                bundle = replace(bundle, trigger=short)
            frames = {
                camera: replace(frame, image=np.rint(frame.image * dimmed.get(camera, 1)).astype(np.uint8))
                for camera, frame in bundle.frames.items()
            }
            writer.add(replace(bundle, frames=frames) if dimmed else bundle)


@cache
def _simulated_for_balls() -> RenderedRig:
    return simulate_rig(thumbnail_rig(), stream(3, 0))


@kept_rendered
def _empty_before_balls(number: int) -> FrameBundle:
    return render_empty(_simulated_for_balls(), stream(3, 1, number), sequence=number)


@kept_rendered
def _ball(number: int, diameter_mm: float) -> FrameBundle:
    rng = stream(3, 2, number)
    placed = drop_across(ball(diameter_mm), _simulated_for_balls().rig, rng)
    return render_bundle([placed], _simulated_for_balls(), rng, sequence=number, label="ball")


def write_ball_recording(path: Path, *, n_balls: int, diameter_mm: float = 10.0) -> None:
    """Balls falling through the rig as built, after two exposures of it empty; rig.json is only its design."""
    with recording_of(path, _thumbnail(nominal_rig()), MADE_BY) as writer:
        for number in (1, 2):
            writer.add(_empty_before_balls(number))
        for number in range(3, n_balls + 3):
            writer.add(_ball(number, diameter_mm))


@kept_rendered
def _odd_bundles() -> list[FrameBundle]:
    simulated = simulate_rig(thumbnail_rig(), stream(2, 0))
    falls = {
        "whole": [_placed(sphere(), 0, 0, 0)],
        "empty": [],
        "small": [_placed(sphere(8.0), 2, -1, 1)],
        "two": [_placed(sphere(8.0), -12, 0, -3), _placed(sphere(8.0), 12, 3, 4)],
        "cube": [_placed(cube(12.0), -1, 2, 0)],
        "cut": [_placed(sphere(), 0, 0, 24)],
        "last": [_placed(sphere(12.0), 1, 1, -2)],
    }
    return [
        *(render_empty(simulated, stream(2, 1, number), sequence=number) for number in (1, 2)),
        *(
            render_bundle(bodies, simulated, stream(2, 2, number), sequence=number, label=label)
            for number, (label, bodies) in enumerate(falls.items(), start=3)
        ),
    ]


def write_odd_recording(path: Path) -> None:
    """After two exposures of the empty rig: nothing, two stones at once, one cut off, each between whole ones."""
    with recording_of(path, thumbnail_rig(), MADE_BY) as writer:
        for bundle in _odd_bundles():
            writer.add(bundle)


CROWDED_FALL = Fall(speed_at_gate_mm_s=1400.0)
"""A fall in which stones that are in one picture have pulses of their own at the gate."""


@kept_rendered
def _crowded_bundles() -> list[FrameBundle]:
    simulated = simulate_rig(thumbnail_rig(), stream(4, 0))
    due = _placed(sphere(10.0), 0, 0, 0)
    others = {
        "alone": [],
        "above": [_placed(sphere(8.0), 1, 0, 26)],
        "unannounced": [_placed(sphere(8.0), 1, 0, 26)],
        "touching": [_placed(sphere(8.0), 0, 0, 10)],
        "between": [_placed(sphere(8.0), 1, 0, 28), _placed(sphere(8.0), 0, 1, -28)],
    }
    bundles = [render_empty(simulated, stream(4, 1, number), sequence=number) for number in (1, 2)]
    for number, (label, near) in enumerate(others.items(), start=3):
        bundle = render_bundle([due, *near], simulated, stream(4, 2), sequence=number, label=label)
        bundles.append(
            replace(bundle, trigger=_announced(bundle.trigger, [] if label == "unannounced" else near))
        )
    return bundles


def _announced(trigger: Trigger, near: Sequence[PlacedBody]) -> Trigger:
    """The trigger of a sphere of 10 mm at the centre, with the pulses of others of 8 mm."""
    fall, times_ns = CROWDED_FALL, range(-40_000_000, 40_000_000, 10_000)
    heights_mm = np.array([fall.height_above_mm(later_ns) for later_ns in times_ns])
    stones = [
        NearStone(
            times_ns[int(np.searchsorted(heights_mm, placed.offset_mm[2] + 1))], pulse_width_ns(8, 1400)
        )
        for placed in near
    ]
    return replace(trigger, pulse_width_ns=pulse_width_ns(10, 1400), near_stones=tuple(sorted(stones)))


def write_crowded_recording(path: Path) -> None:
    """The same sphere after two exposures of the empty rig: alone, and with others in the picture."""
    with recording_of(path, thumbnail_rig(), MADE_BY, fall=CROWDED_FALL) as writer:
        for bundle in _crowded_bundles():
            writer.add(bundle)


def _placed(body: Body, *offset_mm: float) -> PlacedBody:
    return PlacedBody(body=body, R=np.eye(3), offset_mm=np.array(offset_mm))
