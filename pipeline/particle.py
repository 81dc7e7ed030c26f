"""The chain from a bundle to a measurement: segment, check the views, carve, mesh, estimate the body, measure."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from pipeline.arrays import Greys
from pipeline.carving import CarvingParameters, carve
from pipeline.errors import MeshError, RejectedError, RejectReason
from pipeline.estimate import BodyEstimate, estimate_body
from pipeline.frames import CameraId, Frame, FrameBundle
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.measuring.angularity import gradient_angularity
from pipeline.measuring.hull_bias import sphere_hull_excess
from pipeline.measuring.shape import NO_POINTS
from pipeline.measuring.volume_correction import SYNTHETIC, VolumeModel
from pipeline.meshing import MeshingParameters, ParticleMesh, mesh_hull
from pipeline.refinement import Refinement, photo_views, refine_body, vertex_greys
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import BackgroundModel, Segmenter, Silhouette, SilhouetteSet, segment_all
from pipeline.segmentation.optics import observe_all
from pipeline.segmentation.subtraction import SegmentationParameters
from pipeline.uncertainty import Cause, QualityParameters, Uncertainty, uncertainty, verdict
from pipeline.uncertainty.evidence import LENGTH_SD_PERCENT, Evidence, ViewEvidence, open_share, view_evidence
from pipeline.view_mapper import ViewMapper
from pipeline.view_optics import ViewOptics
from pipeline.views.consistency import Consistency, ConsistencyParameters, check_consistency
from pipeline.views.dropped import DropCause, DroppedView
from pipeline.views.prepared import PreparedViews, prepare_views
from pipeline.views.quality import (
    Quality,
    ViewsParameters,
    quality_of,
    require_enough_views,
    shows_several,
    unusable_views,
)

CUT_MM = 0.15
"""Distance of a body's corner from that of its mesh, which marching cubes cuts off: most of a voxel's edge."""
MIN_ANGULARITY_POINTS = 64
"""Fewest points of an outline whose angularity counts."""

BodyKind = Literal["photo", "estimate", "hull"]


@dataclass(frozen=True, slots=True)
class BodyParameters:
    """Body that mesh and shape describe; each kind but the hull is made from the next one."""

    kind: BodyKind = "photo"
    texture: bool | None = None  # whether each vertex of the mesh has a grey value; None: with "photo"

    @property
    def is_textured(self) -> bool:
        """Whether each vertex of the mesh has a grey value."""
        return self.kind == "photo" if self.texture is None else self.texture


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringParameters:
    """Density and volume correction, which turn a shape into volume and mass."""

    density_g_cm3: float | None = None  # of the product (EN 1097-6); without it no mass is reported
    volume_model: VolumeModel = SYNTHETIC

    def __post_init__(self) -> None:
        if self.density_g_cm3 is not None and not 0.1 < self.density_g_cm3 < 25:
            raise ValueError("density_g_cm3 must be between 0.1 and 25")


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineParameters:
    """Everything that decides a result, apart from images, background and rig."""

    segmentation: SegmentationParameters = field(default_factory=SegmentationParameters)
    views: ViewsParameters = field(default_factory=ViewsParameters)
    quality: QualityParameters = field(default_factory=QualityParameters)
    consistency: ConsistencyParameters = field(default_factory=ConsistencyParameters)
    carving: CarvingParameters = field(default_factory=CarvingParameters)
    meshing: MeshingParameters = field(default_factory=MeshingParameters)
    body: BodyParameters = field(default_factory=BodyParameters)
    measuring: MeasuringParameters = field(default_factory=MeasuringParameters)


@dataclass(frozen=True, slots=True, kw_only=True)
class HullMeasurement:
    """The visual hull itself, uncorrected, beside the body that was measured."""

    volume_mm3: float
    surface_area_mm2: float

    @property
    def equivalent_diameter_mm(self) -> float:
        """Diameter of the sphere of the hull's volume."""
        return _sphere_diameter_mm(self.volume_mm3)


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticleMeasurement:
    """One measured particle."""

    body: BodyKind
    """The body that `shape` describes: the one asked for, or the next one where it could not be made."""
    supported_share: float | None
    """Share of the surface that pixels inside the outlines say something about; None unless that was looked at."""
    refinement_fallback: str | None
    """Why the estimate was not refined although that was asked for."""
    shape: ShapeMeasurement
    hull: HullMeasurement
    volume_mm3: float
    """The corrected volume; mass and equivalent diameter follow from it."""
    volume_model: str
    """Id of the correction: that of the model; `sphere`, by which a hull is larger than a sphere; or `none`."""
    volume_estimate_mm3: float | None
    """Volume of the estimated body's mesh, if it was estimated; the correction depends on its ratio to the hull's."""
    angularity: float | None
    """AIMS-type gradient angularity, mean over the views."""
    mass_g: float | None
    uncertainty: Uncertainty

    @property
    def surface_sd_mm(self) -> float:
        """Standard deviation of the surface's distance to the body's."""
        return self.uncertainty.surface_sd_mm

    @property
    def volume_sd_percent(self) -> float:
        """Standard deviation of the corrected volume."""
        return self.uncertainty.volume_sd_percent

    @property
    def equivalent_diameter_mm(self) -> float:
        """Diameter of the sphere of the corrected volume."""
        return _sphere_diameter_mm(self.volume_mm3)

    @property
    def volume_raw_mm3(self) -> float:
        """Volume of the visual hull, uncorrected."""
        return self.hull.volume_mm3

    @property
    def equivalent_diameter_raw_mm(self) -> float:
        """Diameter of the sphere of the hull's volume."""
        return self.hull.equivalent_diameter_mm


def _sphere_diameter_mm(volume_mm3: float) -> float:
    return float(np.cbrt(6 * volume_mm3 / np.pi))


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticleResult:
    """The outcome of one bundle: a measurement, or the reason why there is none."""

    silhouettes: SilhouetteSet
    optics: Mapping[CameraId, ViewOptics] = field(default_factory=dict)
    views: tuple[CameraId, ...] = ()  # cameras whose silhouettes carved
    dropped: Mapping[CameraId, DroppedView] = field(default_factory=dict)
    residuals_px: Mapping[CameraId, float] = field(default_factory=dict)
    consistency: Consistency | None = None  # `None` when it was rejected before the views were compared
    quality: Quality | None = None
    quality_causes: tuple[Cause, ...] = ()  # that keep the quality from being good, the greatest first
    mesh: ParticleMesh | None = None  # of the body that was measured
    greys: Greys | None = None  # of the mesh's vertices, if that was asked for and a view shows any
    hull: ParticleMesh | None = None
    measurement: ParticleMeasurement | None = None
    rejection: RejectedError | None = None


def measure_bundle(
    bundle: FrameBundle,
    rig: RigCalibration,
    background: BackgroundModel,
    segmenter: Segmenter,
    parameters: PipelineParameters,
    on_stage: Callable[[str], None] = lambda stage: None,
    view_mapper: ViewMapper = map,
) -> ParticleResult:
    """Measure the particle of one bundle; a bundle that shows none gives a result with a `rejection`.

    `on_stage` is told the name of each stage as it ends, so that the caller's clock can time it. `view_mapper` works
    on the views one by one or several at a time; the result does not depend on it.

    Raises
    ------
    RigError
        The rig has no calibration for a camera of the bundle.
    """
    silhouettes = segment_all(bundle.frames, background, segmenter, view_mapper)
    on_stage("segment")
    optics = observe_all(bundle.frames, background, silhouettes, view_mapper)
    on_stage("optics")
    dropped = {camera: DroppedView(DropCause.NO_FRAME, why) for camera, why in bundle.missing.items()}
    consistency = None
    try:
        dropped |= unusable_views(silhouettes)
        require_enough_views(silhouettes, dropped, rig, parameters.views)
        views = prepare_views(silhouettes, rig, dropped)
        consistency = check_consistency(views, parameters.consistency)
        on_stage("check")
        dropped.update(consistency.suspects)
        if not consistency.is_consistent:
            raise RejectedError(
                RejectReason.INCONSISTENT,
                f"more than {parameters.consistency.max_suspect_views} views contradict each other",
            )
        views = views.without(consistency.suspects)
        outlined = views.with_outline()  # a view of which only unknown is left tells nothing
        by_number = quality_of(rig.subset(outlined.camera_ids), rig, parameters.views)
        if by_number is Quality.GOOD and shows_several(silhouettes):
            by_number = Quality.REDUCED
        try:
            body = _body(bundle.frames, views, background, parameters, on_stage)
            angularity = _angularity([silhouettes[camera] for camera in silhouettes if camera not in dropped])
            measurement = _measure(
                body, views, view_evidence(outlined, optics, consistency), angularity, rig, parameters
            )
        except (MeshError, ValueError, ArithmeticError) as err:
            raise RejectedError(RejectReason.IMPLAUSIBLE, f"the silhouettes bound no body: {err}") from err
        quality = verdict(
            measurement.uncertainty, by_number, parameters.quality, parameters.body.kind == "photo"
        )
        on_stage("measure")
        greys = None
        if parameters.body.is_textured:
            seen = None if body.refinement is None else body.refinement.views
            greys = vertex_greys(body.mesh, seen or photo_views(bundle.frames, views, body.mesh.vertices_mm))
            on_stage("texture")
    except RejectedError as rejection:
        return ParticleResult(
            silhouettes=silhouettes,
            optics=optics,
            dropped=dropped,
            consistency=consistency,
            rejection=rejection,
        )
    return ParticleResult(
        silhouettes=silhouettes,
        optics=optics,
        views=views.camera_ids,
        dropped=dropped,
        residuals_px=consistency.residuals_px,
        consistency=consistency,
        quality=quality.quality,
        quality_causes=quality.causes,
        mesh=body.mesh,
        greys=greys,
        hull=body.hull,
        measurement=measurement,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Body:
    """The visual hull of a stone, the body estimated within it and that refined, as far as they are asked for."""

    hull: ParticleMesh
    estimate: BodyEstimate | None = None
    refinement: Refinement | None = None

    @property
    def mesh(self) -> ParticleMesh:
        """The body that is measured."""
        if self.refinement is not None:
            return self.refinement.mesh
        return self.hull if self.estimate is None else self.estimate.mesh


def _body(
    frames: Mapping[CameraId, Frame],
    views: PreparedViews,
    background: BackgroundModel,
    parameters: PipelineParameters,
    on_stage: Callable[[str], None],
) -> _Body:
    """Carve the visual hull of the views, and find the body within it as far as that is asked for.

    Raises
    ------
    RejectedError
        The silhouettes have no common body, or one that leaves the carved volume.
    ValueError
        The silhouettes contradict themselves.
    """
    hull = carve(views, parameters.carving)
    on_stage("carve")
    if hull.touches_border:
        raise RejectedError(RejectReason.CLIPPED, "the body leaves the carved volume")
    mesh = mesh_hull(hull, parameters.meshing.mesher)
    on_stage("mesh")
    if mesh is None:
        raise RejectedError(RejectReason.IMPLAUSIBLE, "the silhouettes have no common body")
    estimate = None if parameters.body.kind == "hull" else estimate_body(mesh, views)
    on_stage("estimate")
    if parameters.body.kind != "photo" or estimate is None or estimate.fallback is not None:
        return _Body(hull=mesh, estimate=estimate)
    refinement = refine_body(estimate, mesh, frames, views, background)
    on_stage("refine")
    return _Body(hull=mesh, estimate=estimate, refinement=refinement)


def _measure(
    body: _Body,
    views: PreparedViews,
    seen: tuple[ViewEvidence, ...],
    angularity: float | None,
    rig: RigCalibration,
    parameters: PipelineParameters,
) -> ParticleMeasurement:
    """Measure the body and its uncertainty.

    Raises
    ------
    MeshError, ValueError
        The mesh bounds no volume; or there are so few views that even a sphere's hull is open.
    """
    mesh, estimate, refinement = body.mesh, body.estimate, body.refinement
    supported_share = 0.0 if refinement is None else refinement.supported_share
    corners_mm = NO_POINTS if estimate is None else estimate.corners_mm
    if estimate is not None and refinement is not None and refinement.fallback is None:
        near_mm, _ = cKDTree(mesh.vertices_mm).query(corners_mm, distance_upper_bound=CUT_MM)
        corners_mm = corners_mm[estimate.is_seen | np.isfinite(near_mm)]
    around_mm = NO_POINTS if mesh is body.hull else body.hull.vertices_mm
    shape = measure_shape(mesh.vertices_mm, mesh.faces, corners_mm, around_mm)
    if estimate is None or estimate.fallback is not None:
        kind: BodyKind = "hull"
        hull = HullMeasurement(volume_mm3=shape.volume_mm3, surface_area_mm2=shape.surface_area_mm2)
        volume_mm3, volume_model = hull.volume_mm3, "none"
        if parameters.carving.bounds_by_edges:  # corrected by the least excess that any hull has
            volume_mm3, volume_model = volume_mm3 / _sphere_excess(shape, views), "sphere"
    else:
        model = parameters.measuring.volume_model
        kind, volume_model = "estimate", model.id
        hull = HullMeasurement(volume_mm3=estimate.hull_volume_mm3, surface_area_mm2=estimate.hull_area_mm2)
        volume_mm3 = model.volume_mm3(hull.volume_mm3, estimate.volume_mm3)
        if refinement is not None and refinement.fallback is None:
            kind = "photo"  # what pixels show is corrected by nothing that other bodies have on average
            hidden = volume_mm3 / estimate.volume_mm3
            volume_mm3 = shape.volume_mm3 * (supported_share + (1 - supported_share) * hidden)
    evidence = Evidence(
        views=seen,
        volume_mm3=volume_mm3,
        area_mm2=shape.surface_area_mm2,
        hull_mm3=hull.volume_mm3,
        is_estimated=kind != "hull",
        open_share=open_share(views, body.hull.vertices_mm),
        supported_share=supported_share,
        gap_share=1.0 if refinement is None else refinement.gap_share,
        depth_mm=0.0 if refinement is None else refinement.depth_mm,
        relief_mm=0.0 if refinement is None else refinement.relief_mm,
        length_sd_percent=LENGTH_SD_PERCENT if rig.length_sd_percent is None else rig.length_sd_percent,
    )
    density = parameters.measuring.density_g_cm3
    return ParticleMeasurement(
        body=kind,
        supported_share=None if refinement is None else supported_share,
        refinement_fallback=None if refinement is None else refinement.fallback,
        shape=shape,
        hull=hull,
        volume_mm3=volume_mm3,
        volume_model=volume_model,
        volume_estimate_mm3=None if estimate is None else estimate.volume_mm3,
        angularity=angularity,
        mass_g=None if density is None else density * volume_mm3 / 1000,
        uncertainty=uncertainty(evidence),
    )


def _angularity(silhouettes: Iterable[Silhouette]) -> float | None:
    """Return the mean gradient angularity of the outlines that are long enough for it."""
    angularities = [
        gradient_angularity(silhouette.outline_uv)
        for silhouette in silhouettes
        if len(silhouette.outline_uv) >= MIN_ANGULARITY_POINTS
    ]
    return float(np.mean(angularities)) if angularities else None


def _sphere_excess(shape: ShapeMeasurement, views: PreparedViews) -> float:
    """Return the ratio of hull to body of a sphere of this size seen by these views.

    Raises
    ------
    ValueError
        There are so few views that even a sphere's hull is open.
    """
    centers_mm = np.array([camera.center_mm for camera in views.calibrations])
    return sphere_hull_excess(centers_mm, np.array(shape.center_mm), shape.equivalent_diameter_mm / 2)
