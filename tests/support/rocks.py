"""Rock before a spotted wall, photographed once and kept: the objects of `tests/accuracy/rock.py`, and its rigs."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from support.render_cache import kept_rendered

from pipeline.calibration import calibrate
from pipeline.evaluation.scene import EvaluationScene, build_scene, drop_ball
from pipeline.frames import FrameBundle
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig
from pipeline.synthesis.background import WallKind
from pipeline.synthesis.bodies import Body, SurfaceKind, cube, cylinder, sphere
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.exposure import QUIET_F2
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.renderer import PlacedBody
from pipeline.synthesis.rock_textures import rock_look
from pipeline.synthesis.scanned_stones import SIZES_MM, scanned_stone

N_DROPS = 20
BALL_DIAMETER_MM = 10.0
ROCK = 40
"""Key of the random streams of these objects, beside those of a scene."""
WET_GLOSS = 0.8
STANDARD_CONTRAST = 0.25

Random = np.random.Generator


@dataclass(frozen=True, slots=True)
class RockCase:
    """An object and the wall behind it."""

    body: Callable[[Random], Body]
    wall: WallKind = WallKind.SPOTTED


def _standard(form: Callable[[], Body]) -> Callable[[Random], Body]:
    """A standard as dark as it always is, of rock."""
    return lambda rng: replace(form(), surface=SurfaceKind.GRAINED, contrast=STANDARD_CONTRAST)


def _rock_cube(surface: SurfaceKind) -> Callable[[Random], Body]:
    return lambda rng: rock_look(cube(), surface, rng)


def _stone(
    surface: SurfaceKind, size_mm: float | None = None, gloss: float = 0.0
) -> Callable[[Random], Body]:
    def body(rng: Random) -> Body:
        size = float(rng.uniform(*SIZES_MM)) if size_mm is None else size_mm
        return rock_look(scanned_stone(size, rng), surface, rng, gloss)

    return body


CASES: dict[str, RockCase] = {
    "sphere": RockCase(_standard(sphere)),
    "cylinder": RockCase(_standard(cylinder)),
    "cube": RockCase(_standard(cube)),
    "granite dry": RockCase(_stone(SurfaceKind.GRAINED)),
    "granite wet": RockCase(_stone(SurfaceKind.GRAINED, gloss=WET_GLOSS)),
    "granite dusty": RockCase(_stone(SurfaceKind.DUSTY)),
    "gneiss": RockCase(_stone(SurfaceKind.GNEISS)),
    "veined": RockCase(_stone(SurfaceKind.VEINED)),
    "conglomerate": RockCase(_stone(SurfaceKind.CONGLOMERATE)),
    "limestone": RockCase(_stone(SurfaceKind.LIMESTONE)),
    "halves": RockCase(_stone(SurfaceKind.HALVES)),
    "basalt 9": RockCase(_stone(SurfaceKind.BASALT, 9.0)),
    "basalt 18": RockCase(_stone(SurfaceKind.BASALT, 18.0)),
    "basalt 18, bare wall": RockCase(_stone(SurfaceKind.BASALT, 18.0), WallKind.BARE),
    "granite, bare wall": RockCase(_stone(SurfaceKind.GRAINED), WallKind.BARE),
    "cube, bright": RockCase(_rock_cube(SurfaceKind.GRAINED)),
    "cube, one spot": RockCase(_rock_cube(SurfaceKind.BRECCIA), WallKind.ONE_SPOT),
}
SAME_STONE = {
    "granite wet": "granite dry",
    "granite dusty": "granite dry",
    "granite, bare wall": "granite dry",
    "basalt 18, bare wall": "basalt 18",
}
"""Objects of the form and in the pose of another one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Photographed:
    """An object in its pose, and its exposure."""

    placed: PlacedBody
    bundle: FrameBundle


@lru_cache(2)  # quicker built again than read: it has 170 MB
def scene_before(wall: WallKind, seed: int) -> EvaluationScene:
    """A rig in a housing with such a wall; equal seeds give equal rigs."""
    return build_scene(seed, exposure=QUIET_F2, wall_kind=wall)


@kept_rendered
def calibrated_rig(seed: int) -> RigCalibration:
    """The rig as calibrated from drops of a ball before the spotted wall."""
    scene = scene_before(WallKind.SPOTTED, seed)
    drops = [drop_ball(scene, number, BALL_DIAMETER_MM) for number in range(N_DROPS)]
    design = nominal_rig()
    return calibrate(drops, design, method="bundle", created_at=design.created_at, name="rock").rig


@kept_rendered
def photographed(case: str, seed: int) -> Photographed:
    """One exposure of an object of `CASES`; form, size and pose follow from its name and the seed."""
    key = zlib.crc32(SAME_STONE.get(case, case).encode())
    scene = scene_before(CASES[case].wall, seed)
    body = CASES[case].body(stream(seed, ROCK, key, 0))
    placed = tumble(body, scene.true_rig, stream(seed, ROCK, key, 1))
    label = case.replace(",", "").replace(" ", "-")
    bundle = scene.photograph(placed, stream(seed, ROCK, key, 2), label)
    return Photographed(placed=placed, bundle=bundle)
