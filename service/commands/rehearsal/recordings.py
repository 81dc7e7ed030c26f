"""The recordings that are rehearsed with: rendered once, with a sixteenth of the pixels, so that they take seconds."""

from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path

import numpy as np

from drivers.files.recording import RecordingSource, RecordingWriter
from pipeline.frames import CameraId, FrameBundle
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.bodies import Body, ball
from pipeline.synthesis.bundles import render_bundle, render_empty, stream
from pipeline.synthesis.placement import drop_across, tumble
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, simulate_rig
from pipeline.synthesis.stones import STONE_FORMS, stone
from service.commands.simulate import kept_recording

VERSION = 2
"""To be raised when what is rendered changes."""
SEED = 22
SHRINK = 4
N_EMPTY = 3
N_STONES, N_BALLS, N_BUMPED = 10, 4, 16
SIZES_MM = (9.0, 17.0)
APART_MM = 12.0
BUMPED, TURN_RAD = CameraId("c05"), 0.009
"""The camera that is bumped, and by how much: half a degree."""


class RehearsedRecording(StrEnum):
    """What falls: stones, with two at once and nothing among them; with balls; before and after a bump."""

    STONES = "stones"
    BALLS = "balls"
    BUMPED = "bumped"


def rehearsed_recording(kind: RehearsedRecording) -> Path:
    """Return a recording, rendered the first time and kept in the folder for temporary files."""
    return kept_recording(f"rehearsal-{kind}", [VERSION, SEED, kind], partial(_write, kind))


def _write(kind: RehearsedRecording, path: Path) -> None:
    rig = small_rig()
    simulated = simulate_rig(rig, stream(SEED, 0))
    writer = RecordingWriter(
        path,
        RecordingSource(camera_ids=rig.camera_ids, rig=rig, is_simulated=True),
        made_by={"command": "rehearse", "recording": kind.value},
        compression="zstd",
    )
    with writer:
        for number in range(1, N_EMPTY + 1):
            writer.add(render_empty(simulated, stream(SEED, 1, number), sequence=number))
        for bundle in _falling(kind, rig, simulated):
            writer.add(bundle)


def _falling(kind: RehearsedRecording, rig: RigCalibration, simulated: RenderedRig) -> Iterator[FrameBundle]:
    def stones(numbers: range, seen_by: RenderedRig) -> Iterator[FrameBundle]:
        for number in numbers:
            body = _stone(number)
            yield _bundle([tumble(body, rig, stream(SEED, 4, number))], seen_by, number, body.name)

    yield from stones(range(N_STONES), simulated)
    if kind is RehearsedRecording.BALLS:
        for number in range(N_STONES, N_STONES + N_BALLS):
            placed = drop_across(ball(), rig, stream(SEED, 3, number))
            yield _bundle([placed], simulated, number, "ball")
    elif kind is RehearsedRecording.BUMPED:
        shaken = simulate_rig(_bumped(rig), stream(SEED, 0))
        yield from stones(range(N_STONES, N_STONES + N_BUMPED), shaken)
    else:
        sides = [
            PlacedBody(body=_stone(3), R=np.eye(3), offset_mm=np.array([x, 0.0, 0.0]))
            for x in (-APART_MM, APART_MM)
        ]
        yield _bundle(sides, simulated, N_STONES, "two")
        yield _bundle([], simulated, N_STONES + 1, "nothing")


def _bundle(bodies: list[PlacedBody], simulated: RenderedRig, number: int, label: str) -> FrameBundle:
    rng = stream(SEED, 5, number)
    return render_bundle(bodies, simulated, rng, sequence=N_EMPTY + 1 + number, label=label)


def _stone(number: int) -> Body:
    rng = stream(SEED, 6, number)
    return stone(list(STONE_FORMS)[number % len(STONE_FORMS)], float(rng.uniform(*SIZES_MM)), rng)


def small_rig() -> RigCalibration:
    """Return the rig as built, with a quarter of the pixels in each direction."""
    rig = as_built(nominal_rig(), SEED)
    return replace(rig, cameras=tuple(_shrunk(camera) for camera in rig.cameras))


def _shrunk(camera: CameraCalibration) -> CameraCalibration:
    # centres of pixels are on integers, so the image begins at -0.5
    scale = np.array([[1 / SHRINK, 0, 0.5 / SHRINK - 0.5], [0, 1 / SHRINK, 0.5 / SHRINK - 0.5], [0, 0, 1]])
    width_px, height_px = camera.image_size_px
    size_px = (width_px // SHRINK, height_px // SHRINK)
    return replace(camera, serial=f"REHEARSED-{camera.id}", image_size_px=size_px, K=scale @ camera.K)


def _bumped(rig: RigCalibration) -> RigCalibration:
    """Return the rig with one camera turned about its own vertical axis."""
    cos, sin = np.cos(TURN_RAD), np.sin(TURN_RAD)
    turn = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    (camera,) = rig.subset([BUMPED]).cameras
    turned = turn @ camera.R
    bumped = replace(camera, R=turned, t_mm=-turned @ camera.center_mm)
    return replace(rig, cameras=tuple(bumped if each.id == BUMPED else each for each in rig.cameras))
