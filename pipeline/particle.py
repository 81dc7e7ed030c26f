"""The chain from a bundle to a measurement: segment, check the views, carve, mesh, estimate the body, measure."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pipeline.arrays import Greys
from pipeline.body_measurement import (
    BodyKind,
    FoundBody,
    MeasuringParameters,
    ParticleMeasurement,
    mean_angularity,
    measure_body,
)
from pipeline.carving import CarvingParameters, carve
from pipeline.errors import MeshError, RejectedError, RejectReason
from pipeline.estimate import estimate_body
from pipeline.fall import Fall
from pipeline.frames import CameraId, Frame, FrameBundle
from pipeline.meshing import MeshingParameters, ParticleMesh, mesh_hull
from pipeline.refinement import photo_views, refine_body, vertex_greys
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import BackgroundModel, Segmenter, SilhouetteSet, segment_all
from pipeline.segmentation.optics import observe_all
from pipeline.segmentation.subtraction import SegmentationParameters
from pipeline.uncertainty import Cause, QualityParameters, verdict
from pipeline.uncertainty.evidence import view_evidence
from pipeline.view_mapper import ViewMapper
from pipeline.view_optics import ViewOptics
from pipeline.views.consistency import Consistency, ConsistencyParameters, check_consistency
from pipeline.views.dropped import DropCause, DroppedView
from pipeline.views.near_stones import single_out
from pipeline.views.necks import shows_neck
from pipeline.views.prepared import PreparedViews, prepare_views
from pipeline.views.quality import (
    Quality,
    ViewsParameters,
    quality_of,
    require_enough_views,
    shows_several,
    unusable_views,
)


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
    fall: Fall = field(default_factory=Fall)
    is_rushed: bool = False  # no time for the pixels: a body of the kind "photo" stays as estimated


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
    singled = single_out(bundle, rig, background, parameters.segmentation, parameters.fall, view_mapper)
    frames = singled.frames
    silhouettes = segment_all(frames, background, singled.segmenter(segmenter), view_mapper)
    on_stage("segment")
    optics = observe_all(frames, background, silhouettes, view_mapper)
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
            raise RejectedError(RejectReason.INCONSISTENT, "too many views contradict each other")
        views = views.without(consistency.suspects)
        outlined = views.with_outline()  # a view of which only unknown is left tells nothing
        by_number = quality_of(rig.subset(outlined.camera_ids), rig, parameters.views)
        if by_number is Quality.GOOD and (
            bool(singled.painted and consistency.suspects)
            or shows_several(silhouettes)
            or shows_neck(views.silhouettes)
        ):
            by_number = Quality.REDUCED
        try:
            body = _body(frames, views, background, parameters, on_stage)
            angularity = mean_angularity(
                [silhouettes[camera] for camera in silhouettes if camera not in dropped]
            )
            measurement = measure_body(
                body,
                views,
                view_evidence(outlined, optics, consistency),
                angularity,
                rig,
                parameters.carving,
                parameters.measuring,
            )
        except (MeshError, ValueError, ArithmeticError) as err:
            raise RejectedError(RejectReason.IMPLAUSIBLE, f"the silhouettes bound no body: {err}") from err
        hidden_as = Cause.RUSH if parameters.is_rushed else Cause.HIDDEN
        quality = verdict(
            measurement.uncertainty,
            by_number,
            parameters.quality,
            hidden_as if parameters.body.kind == "photo" else None,
        )
        on_stage("measure")
        greys = None
        if parameters.body.is_textured:
            seen = None if body.refinement is None else body.refinement.views
            greys = vertex_greys(body.mesh, seen or photo_views(frames, views, body.mesh.vertices_mm))
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


def _body(
    frames: Mapping[CameraId, Frame],
    views: PreparedViews,
    background: BackgroundModel,
    parameters: PipelineParameters,
    on_stage: Callable[[str], None],
) -> FoundBody:
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
    is_refined = parameters.body.kind == "photo" and not parameters.is_rushed
    if not is_refined or estimate is None or estimate.fallback is not None:
        return FoundBody(hull=mesh, estimate=estimate)
    refinement = refine_body(estimate, mesh, frames, views, background)
    on_stage("refine")
    return FoundBody(hull=mesh, estimate=estimate, refinement=refinement)
