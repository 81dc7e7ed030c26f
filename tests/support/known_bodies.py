"""Bodies whose measures are known exactly: T1 to T13 of the domain notes."""

from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh


def box(*edges: float) -> trimesh.Trimesh:
    return trimesh.creation.box(edges)


def ellipsoid(*axes: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    mesh.apply_scale(axes)
    return mesh


def cylinder(diameter: float, height: float) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=diameter / 2, height=height, sections=256)


def hull(corners: Any, edge: float) -> trimesh.Trimesh:
    points = np.array(corners, dtype=float)
    points *= edge / np.linalg.norm(points - points[0], axis=1)[1:].min()
    return trimesh.convex.convex_hull(points)


def tetrahedron(edge: float) -> trimesh.Trimesh:
    return hull([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], edge)


def octahedron(edge: float) -> trimesh.Trimesh:
    return hull(np.concatenate([np.eye(3), -np.eye(3)]), edge)


BODIES: dict[str, tuple[Callable[..., trimesh.Trimesh], tuple[float, ...]]] = {
    "T1": (ellipsoid, (15, 15, 15)),
    "T2": (box, (15, 15, 15)),
    "T3": (cylinder, (15, 15)),
    "T4": (box, (10, 20, 40)),
    "T5": (box, (5, 20, 40)),
    "T6": (box, (12, 15, 20)),
    "T7": (ellipsoid, (10, 20, 40)),
    "T8": (ellipsoid, (12, 15, 20)),
    "T9": (box, (10, 14, 28)),
    "T10": (cylinder, (20, 4)),
    "T11": (cylinder, (8, 40)),
    "T12": (tetrahedron, (20,)),
    "T13": (octahedron, (20,)),
}
SIZES = {
    # V, A, equivalent diameter, sphericity, max Feret, min Feret, sieve size
    "T1": (1767.15, 706.86, 15.000, 1.0000, 15.000, 15.000, 15.000),
    "T2": (3375.00, 1350.00, 18.611, 0.8060, 25.981, 15.000, 15.000),
    "T3": (2650.72, 1060.29, 17.171, 0.8736, 21.213, 15.000, 15.000),
    "T4": (8000.00, 2800.00, 24.814, 0.6909, 45.826, 10.000, 20.000),
    "T5": (4000.00, 2200.00, 19.695, 0.5539, 45.000, 5.000, 17.678),
    "T6": (3600.00, 1440.00, 19.015, 0.7888, 27.731, 12.000, 15.000),
    "T7": (4188.79, 1586.92, 20.000, 0.7919, 40.000, 10.000, 15.811),
    "T8": (1884.96, 763.44, 15.326, 0.9666, 20.000, 12.000, 13.583),
    "T9": (3920.00, 1624.00, 19.563, 0.7403, 32.863, 10.000, 14.000),
    "T10": (1256.64, 879.65, 13.389, 0.6402, 20.396, 4.000, 16.971),
    "T11": (2010.62, 1105.84, 15.660, 0.6966, 40.792, 8.000, 8.000),
    "T12": (942.81, 692.82, 12.166, 0.6711, 20.000, 14.142, 14.142),
    "T13": (3771.24, 1385.64, 19.312, 0.8456, 28.284, 16.330, 18.856),
}
FORMS = {
    # a, b, c (edges, axes, or diameter and height), Krumbein, Corey, Zingg
    "T1": ((15, 15, 15), 1, 1, "equant"),
    "T2": ((15, 15, 15), 1, 1, "equant"),
    "T3": ((15, 15, 15), 1, 1, "equant"),
    "T4": ((40, 20, 10), 0.5000, 0.3536, "blade"),
    "T5": ((40, 20, 5), 0.3969, 0.1768, "blade"),
    "T6": ((20, 15, 12), 0.7663, 0.6928, "equant"),
    "T7": ((40, 20, 10), 0.5000, 0.3536, "blade"),
    "T8": ((20, 15, 12), 0.7663, 0.6928, "equant"),
    "T9": ((28, 14, 10), 0.5631, 0.5051, "rod"),
    "T10": ((20, 20, 4), 0.585, 0.200, "disc"),
    "T11": ((40, 8, 8), 0.342, 0.447, "rod"),
}
