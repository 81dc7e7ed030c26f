"""The share of each pixel that a body covers through a lens of finite aperture.

Each point of the aperture sees an outline of its own, whose coverage is exact as in `pixel_coverage`; their mean
follows the depth along the outline and what the edge of the lens sees around it. The scan lines of the points
lie between each other, so that few of them are needed.
"""

import numpy as np

from pipeline.arrays import Faces, FloatImage, Floats, Indices, PointsMM, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.lens import RegionLens, region_lenses, region_pixel
from pipeline.synthesis.pixel_coverage import MeshEdges, Window
from pipeline.synthesis.thin_lens import ThinLens

LINES_PER_PIXEL = 4
"""Scan lines of each point of the aperture in a row of pixels."""
OFFSET_STEP = np.sqrt(2)
"""Shift of the scan lines, in lines, from point to point; not the golden section, which the points' angles follow."""


def defocused_coverage(
    points_camera_mm: PointsMM,
    faces: Faces,
    edges: MeshEdges,
    camera: CameraCalibration,
    lens: ThinLens,
    window: Window,
) -> FloatImage:
    """Return the covered share 0..1 (height, width) of the window's pixels by a closed mesh in the camera frame."""
    corners = points_camera_mm[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = -np.einsum("ij,ij->i", normals, corners[:, 0])  # of the lens's centre
    region_lens = region_lenses(camera.K[None], camera.distortion[None], [(window.left, window.top)])[0]
    region_lens[[2, 4]] += 0.5  # from the window's border
    area = np.zeros((window.height, window.width + 2))  # room for what lies beyond the right border
    _add_apertures(
        np.ascontiguousarray(points_camera_mm),
        facing,
        np.ascontiguousarray(normals[:, :2]),
        edges.vertices,
        edges.face_edges,
        edges.signs,
        lens.aperture_points_mm(),
        lens.focus_mm,
        tuple(region_lens.tolist()),
        area,
    )
    return np.asarray(np.cumsum(area, axis=1)[:, : window.width], dtype=np.float32)


@compiled
def _add_apertures(
    points_mm: PointsMM,
    facing: Values,
    normals_xy: Floats,
    edge_vertices: Indices,
    face_edges: Indices,
    signs: Indices,
    apertures_mm: Floats,
    focus_mm: float,
    lens: RegionLens,
    area: Floats,
) -> None:
    """Add to each pixel of `area` by how much more of it is covered than of its left neighbour."""
    turns = np.empty(len(edge_vertices), np.int64)  # of each edge around the faces that look to the point
    border_uv = np.empty((len(edge_vertices), 4))  # start and end of those edges; v in lines
    border_turns = np.empty(len(edge_vertices), np.int64)
    for at in range(len(apertures_mm)):
        x_mm, y_mm = apertures_mm[at]
        turns[:] = 0
        for face in range(len(facing)):
            if facing[face] + normals_xy[face, 0] * x_mm + normals_xy[face, 1] * y_mm > 0:
                for k in range(3):
                    turns[face_edges[face, k]] += signs[face, k]
        offset = (at * OFFSET_STEP) % 1.0  # of this point's lines: the k-th lies at k + offset
        n_border = 0
        for edge in range(len(turns)):
            if turns[edge] != 0:
                for end in range(2):
                    x, y, z = points_mm[edge_vertices[edge, end]]
                    shift = 1 / focus_mm - 1 / z
                    u, v = region_pixel(lens, x / z + x_mm * shift, y / z + y_mm * shift)
                    border_uv[n_border, 2 * end] = u
                    border_uv[n_border, 2 * end + 1] = LINES_PER_PIXEL * v - offset
                border_turns[n_border] = turns[edge]
                n_border += 1
        _add_covered(border_uv[:n_border], border_turns, 1 / len(apertures_mm), area)


@compiled_within
def _add_covered(border_uv: Floats, turns: Indices, share: float, area: Floats) -> None:
    """Add a share of what directed edges (N, 4), closed loops, enclose, line by line."""
    width = area.shape[1] - 2
    n_lines = area.shape[0] * LINES_PER_PIXEL
    stops = np.zeros(n_lines + 1, np.int64)  # of the crossings of each line
    for i in range(len(border_uv)):
        first, stop = _lines_between(border_uv[i, 1], border_uv[i, 3], n_lines)
        stops[first + 1 : stop + 1] += 1
    stops = np.cumsum(stops)
    filled = stops[:-1].copy()
    crossings = np.empty(stops[-1])
    directions = np.empty(stops[-1], np.int64)
    for i in range(len(border_uv)):
        u0, v0, u1, v1 = border_uv[i]
        direction = turns[i] if v1 > v0 else -turns[i]
        first, stop = _lines_between(v0, v1, n_lines)
        for line in range(first, stop):
            u = u0 + (line - v0) * (u1 - u0) / (v1 - v0)
            at = filled[line]  # sorted in as they come: few cross a line
            while at > stops[line] and crossings[at - 1] > u:
                crossings[at], directions[at] = crossings[at - 1], directions[at - 1]
                at -= 1
            crossings[at], directions[at] = u, direction
            filled[line] += 1
    for line in range(n_lines):
        row, winding = line // LINES_PER_PIXEL, 0
        for i in range(stops[line], stops[line + 1]):
            before, winding = winding, winding + directions[i]
            if (before == 0) != (winding == 0):
                step = (share if before == 0 else -share) / LINES_PER_PIXEL
                u = min(max(crossings[i], 0.0), float(width))
                column = int(u)
                area[row, column] += step * (1 - (u - column))
                area[row, column + 1] += step * (u - column)


@compiled_within
def _lines_between(a: float, b: float, n_lines: int) -> tuple[int, int]:
    """Return the range (first, stop) of the lines at whole numbers between two heights."""
    first = min(max(int(np.ceil(min(a, b))), 0), n_lines)
    return first, max(min(int(np.ceil(max(a, b))), n_lines), first)
