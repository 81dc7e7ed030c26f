"""The measures of a body and their uncertainty, from its mesh and what the views showed of it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.carving import CarvingParameters
from pipeline.estimate import BodyEstimate
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.measuring.angularity import gradient_angularity
from pipeline.measuring.hull_bias import sphere_hull_excess
from pipeline.measuring.shape import NO_POINTS
from pipeline.measuring.volume_correction import SYNTHETIC, VolumeModel
from pipeline.meshing import ParticleMesh
from pipeline.refinement import Refinement
from pipeline.refinement.cells import nearest_within
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import Silhouette
from pipeline.uncertainty import Uncertainty, uncertainty
from pipeline.uncertainty.evidence import LENGTH_SD_PERCENT, UNSUPPORTED, Evidence, ViewEvidence, open_share
from pipeline.views.prepared import PreparedViews

CUT_MM = 0.25
"""Distance from its mesh up to which a corner is the body's: marching cubes cuts most of a voxel's edge off, 0.15 mm,
and refinement some of a tip. At 0.4 mm false contacts before spots count (sieve sizes of cubes 1.7, not 1.4 % rms), at
0.15 tips of stones are lost (0.7, not 0.6 %)."""
MIN_ANGULARITY_POINTS = 64
"""Fewest points of an outline whose angularity counts."""

BodyKind = Literal["photo", "estimate", "hull"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuringParameters:
    """Density and volume correction, which turn a shape into volume and mass."""

    density_kg_m3: float | None = None  # of the particles (EN 1097-6); without it no mass is reported
    volume_model: VolumeModel = SYNTHETIC

    def __post_init__(self) -> None:
        if self.density_kg_m3 is not None and not 100 < self.density_kg_m3 < 25_000:
            raise ValueError("density_kg_m3 must be between 100 and 25000")


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
    density_kg_m3: float | None
    """Density of the particles (EN 1097-6), None if it is not known."""
    uncertainty: Uncertainty

    @property
    def mass_g(self) -> float | None:
        """Mass by the corrected volume, g; None without a density."""
        return None if self.density_kg_m3 is None else mass_g(self.density_kg_m3, self.volume_mm3)

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
class FoundBody:
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


def measure_body(
    body: FoundBody,
    views: PreparedViews,
    seen: tuple[ViewEvidence, ...],
    angularity: float | None,
    rig: RigCalibration,
    carving: CarvingParameters,
    measuring: MeasuringParameters,
) -> ParticleMeasurement:
    """Measure the body and its uncertainty.

    Raises
    ------
    MeshError, ValueError
        The mesh bounds no volume; or there are so few views that even a sphere's hull is open.
    """
    mesh, estimate, refinement = body.mesh, body.estimate, body.refinement
    pixels = UNSUPPORTED if refinement is None else refinement.support
    corners_mm = NO_POINTS if estimate is None else estimate.corners_mm
    if estimate is not None and refinement is not None and refinement.fallback is None:
        near_mm = nearest_within(corners_mm, mesh.vertices_mm, CUT_MM)
        corners_mm = corners_mm[estimate.is_seen & np.isfinite(near_mm)]
    around_mm = NO_POINTS if mesh is body.hull else body.hull.vertices_mm
    shape = measure_shape(mesh.vertices_mm, mesh.faces, corners_mm, around_mm)
    if estimate is None or estimate.fallback is not None:
        kind: BodyKind = "hull"
        hull = HullMeasurement(volume_mm3=shape.volume_mm3, surface_area_mm2=shape.surface_area_mm2)
        volume_mm3, volume_model = hull.volume_mm3, "none"
        if carving.bounds_by_edges:  # corrected by the least excess that any hull has
            volume_mm3, volume_model = volume_mm3 / _sphere_excess(shape, views), "sphere"
    else:
        model = measuring.volume_model
        kind, volume_model = "estimate", model.id
        hull = HullMeasurement(volume_mm3=estimate.hull_volume_mm3, surface_area_mm2=estimate.hull_area_mm2)
        volume_mm3 = model.volume_mm3(hull.volume_mm3, estimate.volume_mm3)
        if refinement is not None and refinement.fallback is None:
            kind = "photo"  # what pixels show is corrected by nothing that other bodies have on average
            hidden = volume_mm3 / estimate.volume_mm3
            volume_mm3 = shape.volume_mm3 * (pixels.share + (1 - pixels.share) * hidden)
    evidence = Evidence(
        views=seen,
        volume_mm3=volume_mm3,
        area_mm2=shape.surface_area_mm2,
        hull_mm3=hull.volume_mm3,
        is_estimated=kind != "hull",
        open_share=open_share(views, body.hull.vertices_mm),
        pixels=pixels,
        length_sd_percent=LENGTH_SD_PERCENT if rig.length_sd_percent is None else rig.length_sd_percent,
    )
    return ParticleMeasurement(
        body=kind,
        supported_share=None if refinement is None else pixels.share,
        refinement_fallback=None if refinement is None else refinement.fallback,
        shape=shape,
        hull=hull,
        volume_mm3=volume_mm3,
        volume_model=volume_model,
        volume_estimate_mm3=None if estimate is None else estimate.volume_mm3,
        angularity=angularity,
        density_kg_m3=measuring.density_kg_m3,
        uncertainty=uncertainty(evidence),
    )


def mass_g(density_kg_m3: float, volume_mm3: float) -> float:
    """Return the mass of a body, g."""
    return density_kg_m3 * volume_mm3 * 1e-6


def mean_angularity(silhouettes: Iterable[Silhouette]) -> float | None:
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
