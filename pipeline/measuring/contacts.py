"""Where calipers and the sieve touch a body: the points and planes behind its sizes, for people to look at."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import Floats, PointsMM, Vector
from pipeline.measuring.boxes import smallest_square
from pipeline.measuring.calipers import farthest_vertices, min_feret, widest_across
from pipeline.measuring.convex import ConvexBody, convex_body
from pipeline.measuring.solid import solid_of

TOUCHING_MM = 1e-3
"""A vertex so near to a side of the square touches it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Caliper:
    """Two parallel tangent planes, and a vertex that touches each."""

    value_mm: float  # their distance
    a_mm: Vector
    b_mm: Vector
    direction: Vector  # unit normal of both, from `b_mm` to `a_mm`


@dataclass(frozen=True, slots=True, kw_only=True)
class SquareHole:
    """The smallest square that the body passes through by translation."""

    value_mm: float  # its edge
    direction: Vector  # unit vector along which the body passes
    corners_mm: PointsMM  # (4, 3) around, in the plane through the body's centre of mass
    touches_mm: PointsMM  # (K, 3) vertices that touch a side


@dataclass(frozen=True, slots=True, kw_only=True)
class Contacts:
    """Calipers and sieve around a mesh; `length` and `max_feret` are the same."""

    length: Caliper
    width: Caliper
    thickness: Caliper
    max_feret: Caliper
    min_feret: Caliper
    sieve: SquareHole
    volume_mm3: float
    center_mm: Vector


def contacts_of(vertices_mm: ArrayLike, faces: ArrayLike) -> Contacts:
    """Return where calipers and sieve touch a closed mesh, by the searches of `measure_shape`.

    Raises
    ------
    MeshError
        The mesh is not a closed, consistently oriented surface around a volume; names the defect.
    """
    solid = solid_of(vertices_mm, faces)
    body = convex_body(solid.vertices_mm)
    upper_mm, lower_mm = farthest_vertices(body)
    length = upper_mm - lower_mm
    length_mm = float(np.linalg.norm(length))
    _, _, across = widest_across(body, length)
    longest = Caliper(value_mm=length_mm, a_mm=upper_mm, b_mm=lower_mm, direction=length / length_mm)
    thickness = _caliper(body, np.cross(length, across))
    _, narrowest = min_feret(body)
    return Contacts(
        length=longest,
        width=_caliper(body, across),
        thickness=thickness,
        max_feret=longest,
        min_feret=_caliper(body, narrowest),
        sieve=_square(body, solid.center_mm),
        volume_mm3=solid.volume_mm3,
        center_mm=solid.center_mm,
    )


def _caliper(body: ConvexBody, direction: Vector) -> Caliper:
    unit = direction / np.linalg.norm(direction)
    heights_mm = body.vertices_mm @ unit
    return Caliper(
        value_mm=float(np.ptp(heights_mm)),
        a_mm=body.vertices_mm[heights_mm.argmax()],
        b_mm=body.vertices_mm[heights_mm.argmin()],
        direction=unit,
    )


def _square(body: ConvexBody, center_mm: Vector) -> SquareHole:
    edge_mm, axes = smallest_square(body)
    flat_mm = body.vertices_mm @ axes[:2].T
    low_mm, high_mm = flat_mm.min(axis=0), flat_mm.max(axis=0)
    middle_mm = (low_mm + high_mm) / 2  # the narrower extent has room on either side
    along_mm = center_mm @ axes[2]
    sides = edge_mm / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners: Floats = np.column_stack([middle_mm + sides, np.full(4, along_mm)]) @ axes
    gaps_mm = edge_mm / 2 - np.abs(flat_mm - middle_mm)
    return SquareHole(
        value_mm=edge_mm,
        direction=axes[2],
        corners_mm=corners,
        touches_mm=body.vertices_mm[(gaps_mm < TOUCHING_MM).any(axis=1)],
    )
