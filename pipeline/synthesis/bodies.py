"""Known bodies, in mm, centred on their centre of mass.

The standards of the paper (matte ball d = 10, sphere d = 15, cylinder d = h = 15, cube 15) and any
mesh that is passed in. Curved bodies are fine enough (facets within 0.002 mm of the ideal surface at
15 mm) and scaled to the ideal volume, so that a mesh measures like its formula.
"""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import trimesh

from pipeline.frames import BundleKind
from pipeline.measuring.solid import solid_of

SPHERE_SUBDIVISIONS = 5  # 20 480 faces; sagitta 0.0015 mm at r = 7.5 mm
CYLINDER_SECTIONS = 360  # sagitta 0.0003 mm at r = 7.5 mm
PITCH_MM = 0.5
"""Longest edge of flat faces, which are subdivided to carry the texture."""


class SurfaceKind(StrEnum):
    """Texture of a body's surface."""

    MOTTLED = "mottled"  # spots on three scales, and speckles as large as the faces of the mesh
    GRANITE = "granite"  # crystals of three minerals
    BANDED = "banded"  # folded light and dark bands, as gneiss
    PLAIN = "plain"  # even, without any texture
    # as photographs of rock: finer than the faces, of a 1/f spectrum (`rock_textures.py`)
    GRAINED = "grained"  # granite: three minerals, grains of 0.1 to 1 mm
    GNEISS = "gneiss"  # light and dark bands of all widths
    VEINED = "veined"  # dark, with bright veins
    CONGLOMERATE = "conglomerate"  # pebbles of 2 to 6 mm in a fine matrix
    BRECCIA = "breccia"  # pale fragments of 2 to 6 mm, all of one grey, in a dark matrix
    LIMESTONE = "limestone"  # as bright as the wall, hardly any contrast
    BASALT = "basalt"  # nearly black
    HALVES = "halves"  # one half black, one pale
    DUSTY = "dusty"  # granite, partly under pale dust


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """A closed surface and how it looks."""

    name: str  # its form: `sphere`, `flaky`; part of the names of its bundles
    mesh: trimesh.Trimesh  # mm, origin at the centre of mass
    kind: BundleKind = BundleKind.PARTICLE
    grey: float = 60.0  # mean grey level on a background of about 205
    contrast: float = 0.22  # of its texture, relative sd
    surface: SurfaceKind = SurfaceKind.MOTTLED
    gloss: float = 0.0  # 0 matte, 1 wet
    is_interreflecting: bool = (
        False  # whether its faces light each other, and are mirrored where it is glossy
    )

    @property
    def radius_mm(self) -> float:
        """The largest distance of the surface from the centre of mass."""
        return float(np.linalg.norm(self.mesh.vertices, axis=1).max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Looks:
    """Surfaces and light of the bodies of a recording or a bench, one after another."""

    surfaces: tuple[SurfaceKind, ...] = (SurfaceKind.MOTTLED,)
    gloss: float = 0.0
    is_interreflecting: bool = False

    def of(self, body: Body, number: int) -> Body:
        """Return the body with the look of number `number`; a calibration ball stays matte."""
        if body.kind is BundleKind.BALL:
            return body
        surface = self.surfaces[number % len(self.surfaces)]
        return replace(body, surface=surface, gloss=self.gloss, is_interreflecting=self.is_interreflecting)


def ball(diameter_mm: float = 10.0) -> Body:
    """Return the matte calibration ball."""
    mesh = sphere_mesh(diameter_mm)
    return Body(name="ball", mesh=mesh, kind=BundleKind.BALL, grey=55.0, contrast=0.04)


def sphere(diameter_mm: float = 15.0) -> Body:
    return Body(name="sphere", mesh=sphere_mesh(diameter_mm), grey=60.0, contrast=0.06)


def cylinder(diameter_mm: float = 15.0, height_mm: float = 15.0) -> Body:
    """Return a cylinder, upright in the body frame."""
    # a polygon's area is below its circle's by sin(x)/x
    angle = 2 * np.pi / CYLINDER_SECTIONS
    radius_mm = diameter_mm / 2 * np.sqrt(angle / np.sin(angle))
    radii_mm = np.linspace(0, radius_mm, max(2, round(radius_mm / (2 * PITCH_MM)) + 1))
    heights_mm = np.linspace(-height_mm / 2, height_mm / 2, max(2, round(height_mm / PITCH_MM) + 1))
    profile = np.concatenate(
        [
            np.column_stack([radii_mm, np.full_like(radii_mm, -height_mm / 2)]),
            np.column_stack([np.full_like(heights_mm, radius_mm), heights_mm])[1:-1],
            np.column_stack([radii_mm[::-1], np.full_like(radii_mm, height_mm / 2)]),
        ]
    )
    mesh = trimesh.creation.revolve(profile, sections=CYLINDER_SECTIONS)
    return Body(name="cylinder", mesh=mesh, grey=60.0, contrast=0.06)


def cube(edge_mm: float = 15.0) -> Body:
    mesh = trimesh.creation.box(extents=[edge_mm] * 3)
    while mesh.edges_unique_length.min() > PITCH_MM:
        mesh = mesh.subdivide()
    return Body(name="cube", mesh=mesh, grey=60.0, contrast=0.06)


def body_from_mesh(name: str, mesh: trimesh.Trimesh) -> Body:
    """Return the body of any closed mesh in mm, moved to its centre of mass.

    Raises
    ------
    MeshError
        The mesh is not a closed surface around a volume.
    """
    solid = solid_of(mesh.vertices, mesh.faces)
    faces = mesh.faces if mesh.volume > 0 else mesh.faces[:, ::-1]
    return Body(name=name, mesh=trimesh.Trimesh(mesh.vertices - solid.center_mm, faces, process=False))


def sphere_mesh(diameter_mm: float) -> trimesh.Trimesh:
    """Return an icosphere of the ideal sphere's volume."""
    unit = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS)
    scale = np.cbrt(np.pi / 6 * diameter_mm**3 / unit.volume)
    return trimesh.Trimesh(scale * unit.vertices, unit.faces, process=False)
