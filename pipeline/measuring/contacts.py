"""Where calipers and the sieve touch a body: the points and planes behind its sizes, for people to look at."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import Floats, Vector
from pipeline.measuring.boxes import smallest_square
from pipeline.measuring.calipers import farthest_vertices, min_feret, widest_across
from pipeline.measuring.convex import ConvexBody, convex_body
from pipeline.measuring.solid import solid_of
from pipeline.schema import SCHEMA

Place = tuple[float, float, float]
TOUCHING_MM = 1e-3
"""A vertex so near to a side of the square touches it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Caliper:
    """Two parallel planes that touch the stone from both sides."""

    __pydantic_config__ = SCHEMA

    value_mm: float
    """Distance of the planes, mm."""
    a_mm: Place
    """Where one plane touches (x, y, z), mm; a vertex of the mesh."""
    b_mm: Place
    """Where the other one does."""
    direction: Place
    """Unit normal of both planes, towards `a_mm`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SquareHole:
    """The smallest square that the stone passes by translation."""

    __pydantic_config__ = SCHEMA

    value_mm: float
    """Edge of the square, mm."""
    direction: Place
    """Unit vector along which the stone passes."""
    corners_mm: tuple[Place, ...]
    """The four corners around, in the plane of the centre, mm."""
    touches_mm: tuple[Place, ...]
    """Vertices of the mesh that touch a side as it passes, mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contacts:
    """Where calipers and sieve touch a mesh, in the frame of the rig (z up)."""

    __pydantic_config__ = SCHEMA

    length: Caliper
    """Greatest dimension (ASTM D4791 length)."""
    width: Caliper
    """Greatest dimension at right angles to the length (ASTM D4791 width)."""
    thickness: Caliper
    """At right angles to both (ASTM D4791 thickness)."""
    max_feret: Caliper
    """Greatest distance of tangent planes (EN 933-4 length L)."""
    min_feret: Caliper
    """Least distance of tangent planes (EN 933-4 thickness E)."""
    sieve: SquareHole
    """Square hole of the sieve size (EN 933-2)."""
    volume_mm3: float
    """Volume of the mesh, mm³."""
    center_mm: Place
    """Centre of mass of the mesh, mm."""


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
    longest = Caliper(
        value_mm=length_mm, a_mm=_place(upper_mm), b_mm=_place(lower_mm), direction=_place(length / length_mm)
    )
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
        center_mm=_place(solid.center_mm),
    )


def _place(vector: Vector) -> Place:
    x, y, z = vector.tolist()
    return x, y, z


def _caliper(body: ConvexBody, direction: Vector) -> Caliper:
    unit = direction / np.linalg.norm(direction)
    heights_mm = body.vertices_mm @ unit
    return Caliper(
        value_mm=float(np.ptp(heights_mm)),
        a_mm=_place(body.vertices_mm[heights_mm.argmax()]),
        b_mm=_place(body.vertices_mm[heights_mm.argmin()]),
        direction=_place(unit),
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
        direction=_place(axes[2]),
        corners_mm=tuple(map(_place, corners)),
        touches_mm=tuple(map(_place, body.vertices_mm[(gaps_mm < TOUCHING_MM).any(axis=1)])),
    )
