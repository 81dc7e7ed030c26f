"""The share of each pixel that a body covers through a lens of finite aperture.

Each point of the aperture sees an outline of its own, whose coverage is exact as in `pixel_coverage`; their mean
follows the depth along the outline and what the edge of the lens sees around it. The scan lines of the points
lie between each other, so that few of them are needed.
"""

import numpy as np

from pipeline.arrays import Faces, FloatImage, Floats, Indices, PointsMM, Values
from pipeline.compiled import compiled
from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.lens import RegionLens, region_lenses, region_pixel
from pipeline.synthesis.pixel_coverage import Edges, Window
from pipeline.synthesis.thin_lens import ThinLens

LINES_PER_PIXEL = 4
"""Scan lines of each point of the aperture in a row of pixels."""
GOLDEN_SECTION = (np.sqrt(5) - 1) / 2


def defocused_coverage(
    points_camera_mm: PointsMM,
    faces: Faces,
    edges: Edges,
    camera: CameraCalibration,
    lens: ThinLens,
    window: Window,
) -> FloatImage:
    """Return the covered share 0..1 (height, width) of the window's pixels by a closed mesh in the camera frame.

    Raises
    ------
    ValueError
        The mesh has holes.
    """
    corners = points_camera_mm[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = -np.einsum("ij,ij->i", normals, corners[:, 0])  # of the lens's centre
    region_lens = region_lenses(camera.K[None], camera.distortion[None], [(window.left, window.top)])[0]
    region_lens[[2, 4]] += 0.5  # from the window's border
    area = np.zeros((window.height, window.width + 2))  # room for what lies beyond the right border
    is_closed = _add_apertures(
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
    if not is_closed:
        raise ValueError("the silhouette edges form no closed loops: the mesh has holes")
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
) -> bool:
    """Add to each pixel's `area` by how much more of it is covered than of its left neighbour; whether loops close."""
    height, width = area.shape[0], area.shape[1] - 2
    n_lines = height * LINES_PER_PIXEL
    share = 1.0 / (LINES_PER_PIXEL * len(apertures_mm))
    turns = np.zeros(len(edge_vertices), np.int64)
    border = np.empty(len(edge_vertices), np.int64)
    ends = np.empty((len(edge_vertices), 4))
    stops = np.empty(n_lines + 1, np.int64)
    for at in range(len(apertures_mm)):
        ax, ay = apertures_mm[at]
        turns[:] = 0
        for face in range(len(facing)):
            if facing[face] + normals_xy[face, 0] * ax + normals_xy[face, 1] * ay > 0:
                for k in range(3):
                    turns[face_edges[face, k]] += signs[face, k]
        offset = (at * GOLDEN_SECTION) % 1.0  # line k of this point lies at y = k + offset
        n_border = 0
        stops[:] = 0
        for edge in range(len(turns)):
            if turns[edge] != 0:
                for end in range(2):
                    x, y, z = points_mm[edge_vertices[edge, end]]
                    shift = 1.0 / focus_mm - 1.0 / z
                    u, v = region_pixel(lens, x / z + ax * shift, y / z + ay * shift)
                    ends[n_border, 2 * end], ends[n_border, 2 * end + 1] = u, v * LINES_PER_PIXEL
                border[n_border] = edge
                first, stop = _lines_between(ends[n_border, 1], ends[n_border, 3], offset, n_lines)
                for line in range(first, stop):
                    stops[line + 1] += 1
                n_border += 1
        stops[:] = np.cumsum(stops)
        crossings = np.empty(stops[-1])
        directions = np.empty(stops[-1], np.int64)
        filled = stops[:-1].copy()
        for i in range(n_border):
            u0, y0, u1, y1 = ends[i]
            first, stop = _lines_between(y0, y1, offset, n_lines)
            for line in range(first, stop):
                # sorted in as they come: few cross a line
                u = u0 + (line + offset - y0) * (u1 - u0) / (y1 - y0)
                j = filled[line]
                while j > stops[line] and crossings[j - 1] > u:
                    crossings[j], directions[j] = crossings[j - 1], directions[j - 1]
                    j -= 1
                crossings[j] = u
                directions[j] = turns[border[i]] if y1 > y0 else -turns[border[i]]
                filled[line] += 1
        for line in range(n_lines):
            winding = 0
            for j in range(stops[line], stops[line + 1]):
                before, winding = winding, winding + directions[j]
                if (before == 0) == (winding == 0):
                    continue
                step = share if before == 0 else -share
                u = min(max(crossings[j], 0.0), float(width))
                column = int(u)
                row = line // LINES_PER_PIXEL
                area[row, column] += step * (1 - (u - column))
                area[row, column + 1] += step * (u - column)
            if winding != 0:
                return False
    return True


@compiled
def _lines_between(a: float, b: float, offset: float, n_lines: int) -> tuple[int, int]:
    """Return the range (first, stop) of the scan lines between two heights."""
    first = max(int(np.ceil(min(a, b) - offset)), 0)
    stop = min(int(np.ceil(max(a, b) - offset)), n_lines)
    return first, stop
