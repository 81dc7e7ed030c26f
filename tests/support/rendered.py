"""Rendered bundles shared by the tests: one synthetic rig, its background learnt once."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from support.render_cache import kept_rendered

from drivers.files.bundle_file import Compression
from drivers.files.recording import RecordingSource, RecordingWriter
from pipeline.evaluation.scene import EvaluationScene, build_scene
from pipeline.evaluation.trials import STANDARDS
from pipeline.fall import Fall
from pipeline.frames import FrameBundle
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation import BackgroundModel
from pipeline.synthesis.bodies import Body, ball, cube, sphere
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.renderer import PlacedBody, RenderedRig

SEED = 20
FROM_REST = Fall()


@cache
def rig() -> RigCalibration:
    return as_built(nominal_rig(), SEED)


@kept_rendered
def scene() -> EvaluationScene:
    return build_scene(SEED)


def simulated() -> RenderedRig:
    return scene().simulated


def background() -> BackgroundModel:
    return scene().background


def placed(body: Body, offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> PlacedBody:
    return PlacedBody(body=body, R=np.eye(3), offset_mm=np.array(offset_mm))


def bundle_of(*bodies: PlacedBody, number: int = 0) -> FrameBundle:
    """An exposure of these bodies; the same number gives the same noise."""
    return render_bundle(list(bodies), simulated(), stream(SEED, 2, number), sequence=10 + number)


@kept_rendered
def sphere_bundle() -> FrameBundle:
    """A 15 mm sphere half a millimetre off the centre."""
    return bundle_of(placed(sphere(), (0.5, -0.3, 0.2)))


@kept_rendered
def sphere_exposed_as(exposure: ExposureParameters) -> FrameBundle:
    """The sphere in the middle of the rig, exposed in another way than the background was."""
    other = replace(simulated(), parameters=exposure)
    return render_bundle([placed(sphere())], other, stream(SEED, 3), sequence=1)


@kept_rendered
def bright_cube_bundle() -> FrameBundle:
    """A cube that looks like the wall in places, in the middle of the rig."""
    return bundle_of(placed(replace(cube(), grey=130.0, contrast=0.35)), number=4)


@kept_rendered
def tumbled_bundle(name: str, number: int) -> FrameBundle:
    """A body of `trials.STANDARDS`, or the calibration ball, in a random pose."""
    rng = stream(SEED, 4, number)
    body = ball() if name == "ball" else STANDARDS[name]()
    return render_bundle([tumble(body, rig(), rng)], simulated(), rng, sequence=10 + number)


def recording_of(
    path: Path,
    rig: RigCalibration,
    made_by: dict[str, Any],
    compression: Compression = "zstd",
    fall: Fall = FROM_REST,
) -> RecordingWriter:
    """A new recording of what this rig was rendered with."""
    return RecordingWriter(
        path,
        RecordingSource(
            camera_ids=rig.camera_ids,
            rig=rig,
            is_simulated=True,
            gate_settings={
                "fall_height_mm": fall.height_mm,
                "speed_at_gate_mm_s": fall.speed_at_gate_mm_s,
            },
        ),
        made_by=made_by,
        compression=compression,
    )
