"""Size and form of one stone, measured on its closed mesh.

Two triples, because the standards disagree on what "length" is:

- `length_mm, width_mm, thickness_mm` are ASTM D4791's: the greatest dimension, the greatest one
  perpendicular to it, and the one perpendicular to both. The length of a cuboid is its diagonal.
- `min_box_mm` are the edges a >= b >= c of the box of least volume, which for cuboids, ellipsoids and
  cylinders are edges, axes, diameter and height. All form factors (elongation, flatness, Zingg, Krumbein,
  Corey) are ratios of these.

EN 933-3, EN 933-4 and JTG 3432 go by `max_feret_mm` and `min_feret_mm`.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import PointsMM
from pipeline.geometry.icosphere import icosphere
from pipeline.measuring.angularity import gradient_angularity
from pipeline.measuring.boxes import smallest_around_mm
from pipeline.measuring.calipers import extents_across, least_width_within_mm, max_feret, min_feret_mm
from pipeline.measuring.convex import convex_body
from pipeline.measuring.solid import solid_of
from pipeline.schema import SCHEMA

ZINGG_LIMIT = 2 / 3
"""Limit of both ratios in Zingg's diagram; a ratio equal to it counts as below."""
WARM_UP_RADIUS_MM = 5.0
NO_POINTS = np.empty((0, 3))


class ZinggClass(StrEnum):
    """Class of form in Zingg's diagram (1935) of b/a and c/b; the words are those of the result record."""

    EQUANT = "equant"
    """b/a > 2/3 and c/b > 2/3."""
    DISC = "disc"
    """b/a > 2/3 and c/b <= 2/3."""
    ROD = "rod"
    """b/a <= 2/3 and c/b > 2/3."""
    BLADE = "blade"
    """b/a <= 2/3 and c/b <= 2/3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeMeasurement:
    """Sizes and form factors of one closed mesh; each is a field of the result, by this name and description."""

    __pydantic_config__ = SCHEMA

    volume_mm3: float
    """Volume inside the mesh, mm³; exact for the polyhedron"""
    surface_area_mm2: float
    """Surface area of the mesh, mm²; exact for the polyhedron"""
    center_mm: tuple[float, float, float]
    """Centre of mass at uniform density, mm, in the frame of the mesh"""
    length_mm: float
    """Greatest dimension (ASTM D4791 length), mm; equal to `max_feret_mm`"""
    width_mm: float
    """Greatest dimension at right angles to the length (ASTM D4791 width), mm"""
    thickness_mm: float
    """Dimension at right angles to both (ASTM D4791 thickness), mm"""
    max_feret_mm: float
    """Greatest distance of two parallel tangent planes (length L of EN 933-4 and JTG 3432), mm"""
    min_feret_mm: float
    """Least distance of two parallel tangent planes (EN 933-4 thickness E), mm; of a bar sieve, the narrowest slot that
    the stone passes (EN 933-3)"""
    min_box_mm: tuple[float, float, float]
    """Edges a >= b >= c of the box of least volume, mm"""
    sieve_size_mm: float
    """Smallest square aperture that the body passes by translation, in its best orientation (square holes of EN 933-2,
    ISO 3310-2), mm"""
    equivalent_diameter_mm: float
    """Diameter of the sphere of equal volume V: (6 V / pi)^(1/3), mm; in a result of the corrected volume"""
    sphericity: float
    """Wadell's sphericity: area of the sphere of equal volume by surface area A of the mesh, pi^(1/3) (6 V)^(2/3) / A,
    0..1; 1: a sphere"""
    convexity: float
    """Volume of the mesh by volume of its convex hull, 0..1; an upper bound where silhouettes alone made the mesh, as
    they show no dents"""
    elongation_ratio: float
    """Zingg's elongation ratio b / a, of the edges a >= b >= c in `min_box_mm`, 0..1; 1: as wide as long"""
    flatness_ratio: float
    """Zingg's flatness ratio c / b, of the edges in `min_box_mm`, 0..1; 1: as thick as wide"""
    zingg_class: ZinggClass
    """Zingg's form: `equant` with b / a and c / b above 2/3, `disc` with b / a alone, `rod` with c / b alone, `blade`
    with neither"""
    krumbein: float
    """Krumbein's intercept sphericity (b c / a²)^(1/3), of the edges in `min_box_mm`, 0..1"""
    corey: float
    """Corey's shape factor c / sqrt(a b), of the edges in `min_box_mm`, 0..1"""


def measure_shape(
    vertices_mm: ArrayLike, faces: ArrayLike, corners_mm: PointsMM = NO_POINTS, hull_mm: PointsMM = NO_POINTS
) -> ShapeMeasurement:
    """Measure a closed mesh with vertices (N, 3) in mm and faces (M, 3); deterministic.

    Sizes are those of the mesh with points (C, 3) that the body is known to have beyond it: a mesh of marching cubes
    cuts corners. Of an estimate, points (H, 3) of the visual hull that it lies in say more about its least width.

    Volume and area are exactly those of the polyhedron. All else is taken from its convex hull, without points
    that stand out by less than 3e-5 of the extent (`quickhull.TOLERANCE`): of that hull the D4791 triple is exact,
    the minimum Feret diameter within 1e-4. Sieve size and box come from searches that on 186 hulls in three poses
    each missed the best value known by 1e-3 at most, by 7e-6 in the mean. The mesh may be inside out as a whole.

    Raises
    ------
    MeshError
        The mesh is not a closed, consistently oriented surface around a volume; names the defect.
    """
    solid = solid_of(vertices_mm, faces)
    body = convex_body(np.concatenate([solid.vertices_mm, corners_mm]), solid.center_mm)
    longest = max_feret(body)
    length_mm = float(np.linalg.norm(longest))
    across_mm, thickness_mm = extents_across(body, longest)
    box_mm, sieve_mm = smallest_around_mm(body)
    # each of these is a width, so the least width cannot exceed it
    least_mm = min(min_feret_mm(body), float(box_mm[2]), thickness_mm)
    if len(hull_mm):
        least_mm = least_width_within_mm(least_mm, min_feret_mm(convex_body(hull_mm)))
        across_mm, thickness_mm, sieve_mm = (
            max(size, least_mm) for size in (across_mm, thickness_mm, sieve_mm)
        )
    a, b, c = (max(float(edge), least_mm) for edge in box_mm)
    x, y, z = (float(coordinate) for coordinate in solid.center_mm)
    return ShapeMeasurement(
        volume_mm3=solid.volume_mm3,
        surface_area_mm2=solid.surface_area_mm2,
        center_mm=(x, y, z),
        length_mm=length_mm,
        width_mm=across_mm,
        thickness_mm=thickness_mm,
        max_feret_mm=length_mm,
        min_feret_mm=least_mm,
        min_box_mm=(a, b, c),
        sieve_size_mm=sieve_mm,
        equivalent_diameter_mm=float(np.cbrt(6 * solid.volume_mm3 / np.pi)),
        sphericity=float(np.cbrt(np.pi * (6 * solid.volume_mm3) ** 2) / solid.surface_area_mm2),
        convexity=min(solid.volume_mm3 / body.volume_mm3, 1.0),
        elongation_ratio=b / a,
        flatness_ratio=c / b,
        zingg_class=zingg_class(b / a, c / b),
        krumbein=float(np.cbrt(b * c / a**2)),
        corey=c / float(np.sqrt(a * b)),
    )


def zingg_class(elongation_ratio: float, flatness_ratio: float) -> ZinggClass:
    """Return Zingg's class of a body with b/a = `elongation_ratio` and c/b = `flatness_ratio`."""
    if elongation_ratio > ZINGG_LIMIT:
        return ZinggClass.EQUANT if flatness_ratio > ZINGG_LIMIT else ZinggClass.DISC
    return ZinggClass.ROD if flatness_ratio > ZINGG_LIMIT else ZinggClass.BLADE


def warm_up() -> ShapeMeasurement:
    """Measure a coarse ball and a circle, which compiles the loops of this package before the first stone."""
    directions, faces = icosphere(subdivisions=2)
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    gradient_angularity(np.column_stack([np.cos(angle), np.sin(angle)]))
    return measure_shape(WARM_UP_RADIUS_MM * directions, faces)
