"""Accuracy trials: a known body in a random pose, rendered once and measured by every method that is compared."""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
import trimesh

from pipeline.carving import CarvingParameters, carve
from pipeline.errors import MeshError
from pipeline.evaluation.exact_hull import exact_hull_mesh, star_center_mm
from pipeline.evaluation.scene import BODY, EvaluationScene, rig_error
from pipeline.evaluation.surface_distances import Surface, SurfaceDistances, surface_distances
from pipeline.frames import FrameBundle
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.meshing import ParticleMesh, mesh_hull
from pipeline.paper import PAPER, paper_at
from pipeline.particle import BodyParameters, PipelineParameters, measure_bundle
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import Segmenter, SilhouetteSet, segment_all
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import Body, cube, cylinder, sphere
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.irregular_bodies import irregular_body
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import STONE_FORMS, stone
from pipeline.views.prepared import prepare_views

Method = Literal[
    "paper's method",
    "paper's method, 15.1",
    "paper's method, 15.9",
    "paper's field",
    "hull",
    "estimate",
    "photo",
    "exact hull",
]
METHODS: tuple[Method, ...] = ("paper's field", "hull", "estimate", "photo")
"""What is measured of our silhouettes: the paper's carving, ours, and the body that the chain returns by default.

The exact hull is not measured but computed from the body: the lower bound of the other hulls' errors.
"""
ISOLEVELS: Mapping[Method, float] = {
    "paper's method": PAPER.carving.isolevel,
    "paper's method, 15.1": 15.1,
    "paper's method, 15.9": 15.9,
}
"""The paper's whole method, of a network's masks, and where in its field the surface lies."""
STANDARDS: Mapping[str, Callable[[], Body]] = {"sphere": sphere, "cylinder": cylinder, "cube": cube}
SIZES_MM = (10.0, 36.0)
"""Greatest diameters of random bodies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeErrors:
    """Errors of the shape: measured less true."""

    mesh_volume_percent: float  # of the mesh
    volume_percent: float  # of the reported volume, which is corrected where the chain corrects it
    area_percent: float
    max_feret_mm: float
    min_feret_mm: float
    thickness_mm: float
    sieve_size_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """The accuracy of one body in one pose, with one rig and one method."""

    body: str
    number: int
    rig: str
    method: Method
    failure: str | None  # why there is no body; then there is nothing below
    distances: SurfaceDistances | None = None
    errors: ShapeErrors | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """A measured surface in the true rig's frame."""

    mesh: trimesh.Trimesh
    shape: ShapeMeasurement
    volume_mm3: float  # as reported


def random_body(name: str, number: int, seed: int) -> Body:
    """Return body number `number` of a name: standards are always the same, others of random form and size."""
    rng = _stream(seed, name, number, 0)
    if name in STANDARDS:
        return STANDARDS[name]()
    size_mm = float(rng.uniform(*SIZES_MM))
    return stone(name, size_mm, rng) if name in STONE_FORMS else irregular_body(name, size_mm, rng)


def try_body(
    body: Body,
    number: int,
    scene: EvaluationScene,
    rigs: Mapping[str, tuple[RigCalibration, Sequence[Method]]],
    on_measured: Callable[[Trial, Measured, trimesh.Trimesh], None] = lambda trial, measured, truth: None,
    masks: Segmenter | None = None,
    on_stage: Callable[[str, str], None] = lambda method, stage: None,
) -> list[Trial]:
    """Render a body in its random pose `number`, and measure it with every rig by each of its methods.

    Measurements are brought to the true rig's frame by the one rigid motion between the two rigs, not body by body.
    If the body is star-shaped, the exact hull in the same pose, seen by the true rig, comes first.
    `on_measured` is called for each trial that gave a body, with the measured and the true surface. `masks` are the
    silhouettes of the paper's whole method, which needs them. `on_stage` is told method and name of each stage as it
    ends, and ("", "") where what came before belongs to none.
    """
    rng = _stream(scene.seed, body.name, number, 1)
    placed = tumble(body, scene.true_rig, rng)
    bundle = scene.photograph(placed, rng, body.name)
    on_stage("", "")
    compared = segment_all(bundle.frames, scene.background, BackgroundSegmenter())
    on_stage("photo", "segment")
    masked: SilhouetteSet = {}
    if masks is not None:
        masked = segment_all(bundle.frames, scene.background, masks)
        on_stage("paper's method", "segment")
    truth = Surface(placed.world_mesh)
    shape = measure_shape(truth.mesh.vertices, truth.mesh.faces)

    def judged(rig: str, method: Method, measured: Measured | str) -> Trial:
        trial = Trial(body=body.name, number=number, rig=rig, method=method, failure=None)
        if isinstance(measured, str):
            return replace(trial, failure=measured)
        distances = surface_distances(measured.mesh, truth, _stream(scene.seed, body.name, number, 2))
        trial = replace(trial, distances=distances, errors=_errors(measured, shape))
        on_measured(trial, measured, truth.mesh)
        return trial

    trials = []
    if (center_mm := star_center_mm(truth.mesh)) is not None:
        floor = exact_hull_mesh(truth.mesh, center_mm, scene.true_rig)
        trials.append(judged("true", "exact hull", _uncorrected(floor)))
    for name, (rig, methods) in rigs.items():
        motion = rig_error(rig, scene.true_rig)
        for method in methods:
            on_stage("", "")
            silhouettes = masked if method in ISOLEVELS else compared
            measured = _measure(bundle, silhouettes, rig, method, partial(on_stage, method))
            if isinstance(measured, Measured):
                vertices_mm = measured.mesh.vertices @ motion.R.T + motion.t_mm
                mesh = trimesh.Trimesh(vertices_mm, measured.mesh.faces, process=False)
                measured = replace(measured, mesh=mesh)
            trials.append(judged(name, method, measured))
    return trials


def _measure(
    bundle: FrameBundle,
    silhouettes: SilhouetteSet,
    rig: RigCalibration,
    method: Method,
    on_stage: Callable[[str], None],
) -> Measured | str:
    """Measure the body with one method; return why there is none if that fails."""
    chains = {name: paper_at(isolevel) for name, isolevel in ISOLEVELS.items()}
    for kind in ("estimate", "photo"):
        chains[kind] = PipelineParameters(body=BodyParameters(kind, texture=False))
    if method in chains:
        # the whole chain but for the segmentation, which is done
        result = measure_bundle(
            bundle, rig, {}, lambda frame, _: silhouettes[frame.camera], chains[method], on_stage
        )
        if result.mesh is None or result.measurement is None:
            return str(result.rejection)
        return Measured(
            mesh=_trimesh(result.mesh),
            shape=result.measurement.shape,
            volume_mm3=result.measurement.volume_mm3,
        )
    parameters = CarvingParameters(field="view_count" if method == "paper's field" else "sub_voxel")
    hull = mesh_hull(carve(prepare_views(silhouettes, rig), parameters))
    if hull is None:
        return "the silhouettes have no common body"
    try:
        return _uncorrected(_trimesh(hull))
    except MeshError as err:
        return str(err)


def _uncorrected(mesh: trimesh.Trimesh) -> Measured:
    shape = measure_shape(mesh.vertices, mesh.faces)
    return Measured(mesh=mesh, shape=shape, volume_mm3=shape.volume_mm3)


def _errors(measured: Measured, true: ShapeMeasurement) -> ShapeErrors:
    shape = measured.shape
    return ShapeErrors(
        mesh_volume_percent=100 * (shape.volume_mm3 / true.volume_mm3 - 1),
        volume_percent=100 * (measured.volume_mm3 / true.volume_mm3 - 1),
        area_percent=100 * (shape.surface_area_mm2 / true.surface_area_mm2 - 1),
        max_feret_mm=shape.max_feret_mm - true.max_feret_mm,
        min_feret_mm=shape.min_feret_mm - true.min_feret_mm,
        thickness_mm=shape.thickness_mm - true.thickness_mm,
        sieve_size_mm=shape.sieve_size_mm - true.sieve_size_mm,
    )


def _trimesh(mesh: ParticleMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def _stream(seed: int, name: str, number: int, purpose: int) -> np.random.Generator:
    """Return the random stream of one purpose, independent of the other bodies that are tried."""
    return stream(seed, BODY, zlib.crc32(name.encode()), number, purpose)
