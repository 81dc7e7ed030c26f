"""Rendered picture of a mesh: smoothly shaded, softly lit, with a scale bar."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.arrays import Faces, Floats, Greys, Indices32, Matrix33, PointsMM, Singles
from pipeline.compiled import compiled
from pipeline.geometry.bounds import bounds
from pipeline.geometry.decimation import decimated
from pipeline.geometry.icosphere import icosphere

ColorImage = NDArray[np.uint8]
"""(H, W, 3) RGB."""
THUMBNAIL_PX, PICTURE_PX = 240, 480
"""Edges of the pictures of stones: the one that a worker draws with each stone, and the larger one."""
PREVIEW_NAME = "preview-{}.png"
"""Name of the file of a picture, by its edge in pixels."""
THUMBNAIL_VERTICES = 12_000
"""Vertices of a thumbnail's mesh: those in front are two pixels apart."""
VIEW_DIRECTION = (-0.55, 0.70, -0.45)
"""Viewing direction in the world frame: the body is seen from the front, the right and above."""
BODY_SHARE = 0.80
"""Extent of the body over the edge of the picture."""
SAMPLES_PER_PIXEL = 2  # along each axis
LIGHTS = (
    # direction towards the light, in the frame of the picture (right, down, away); brightness
    ((-0.55, -0.65, -0.52), 0.62),
    ((0.80, -0.10, -0.59), 0.22),
)
AMBIENT = 0.16
UNSHADED_SHARE = 0.6
"""Share of unshaded light on vertices of individual colours, which shading must not change much."""
SCREEN_GAMMA = 2.2
"""Exponent by which screens darken grey levels; cameras have none, so their greys are brightened for a picture."""
STONE_RGB = (0.80, 0.75, 0.68)
TOP_RGB, BOTTOM_RGB = (0.965, 0.97, 0.975), (0.87, 0.88, 0.895)
INK_RGB = (70, 74, 80)
BAR_LENGTHS_MM = (10.0, 1.0, 0.1)
"""Lengths of the scale bar; the first that fits is drawn."""


def render_preview(
    vertices_mm: ArrayLike,
    faces: ArrayLike,
    size_px: int = 480,
    *,
    colors_rgb: ArrayLike = STONE_RGB,
    unshaded_share: float = UNSHADED_SHARE,
    view_direction: tuple[float, float, float] = VIEW_DIRECTION,
) -> ColorImage:
    """Return an RGB image (size, size, 3) of a closed mesh with vertices (N, 3) in mm and faces (M, 3).

    Parallel projection along `view_direction`, z up, scaled to fill the picture, with a scale bar of 10 mm (1 mm
    for a tiny body). `colors_rgb`, 0..1, is one colour (3,) or one for each vertex (N, 3), which are shaded but for
    `unshaded_share`.

    Raises
    ------
    ValueError
        The mesh has no faces.
    """
    triangles = np.asarray(faces, dtype=np.int32)
    if len(triangles) == 0:
        raise ValueError("a mesh without faces has no picture")
    points_mm = np.asarray(vertices_mm, dtype=np.float64) @ _picture_frame(view_direction).T
    used_mm = points_mm[triangles.ravel()]
    low, high = bounds(used_mm)
    points_mm -= (low + high) / 2
    px_per_mm = BODY_SHARE * size_px / float((high - low)[:2].max())

    n_samples = size_px * SAMPLES_PER_PIXEL
    center = (n_samples - 1) / 2
    points = points_mm * (px_per_mm * SAMPLES_PER_PIXEL) + [center, center, 0]
    canvas = np.linspace(TOP_RGB, BOTTOM_RGB, n_samples, dtype=np.float32)[:, None].repeat(n_samples, axis=1)
    colors = np.asarray(colors_rgb, dtype=np.float32)
    brightness = _vertex_brightness(points_mm, triangles)[:, None]
    if colors.ndim == 2:
        brightness = unshaded_share + (1 - unshaded_share) * brightness
    _draw(canvas, np.full(canvas.shape[:2], np.inf), points, triangles, brightness * colors)
    picture = cv2.resize(canvas, (size_px, size_px), interpolation=cv2.INTER_AREA)
    image = np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8)
    _draw_scale_bar(image, px_per_mm)
    return image


def preview_png(vertices_mm: PointsMM, faces: Faces, greys: Greys | None, size_px: int) -> bytes:
    """Return a picture of a stone as PNG, in the greys (N,) of its vertices if they have any.

    The thumbnail is drawn from a mesh of about `THUMBNAIL_VERTICES`, so that its time does not depend on the stone's.
    """
    if size_px <= THUMBNAIL_PX:
        vertices_mm, faces, greys = decimated(vertices_mm, faces, greys, THUMBNAIL_VERTICES)
    colors_rgb = STONE_RGB if greys is None else colors_of(greys)
    return encode_png(
        render_preview(vertices_mm, faces, size_px, colors_rgb=colors_rgb, unshaded_share=0.0)[..., ::-1]
    )


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """Return a grey (H, W) or BGR (H, W, 3) image as PNG; fast rather than small."""
    _, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return encoded.tobytes()


def warm_up() -> bytes:
    """Draw a coarse ball, which compiles the loop of this module before the first stone."""
    directions, faces = icosphere(subdivisions=1)
    return preview_png(directions, faces, None, THUMBNAIL_PX)


def colors_of(greys: Greys) -> Singles:
    """Return the colours (N, 3), 0..1, that show grey levels of cameras (N,) on a screen."""
    shown = (greys.astype(np.float32) / 255) ** (1 / SCREEN_GAMMA)
    return np.asarray(np.repeat(shown[:, None], 3, axis=1))


def _picture_frame(view_direction: tuple[float, float, float]) -> Matrix33:
    """Return the rotation from the world to the picture; rows are right, down, away from the viewer."""
    away = np.array(view_direction) / np.linalg.norm(view_direction)
    right = np.cross(away, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(away, right), away])


@compiled
def _draw(
    canvas_rgb: Singles, depths: Floats, points: Floats, triangles: Indices32, lit_rgb: Singles
) -> None:
    """Draw triangles, with vertices (N, 3) in columns, rows and depth and their colours (N, 3), nearest in front.

    `canvas_rgb` (H, W, 3) and `depths` (H, W), at first infinite, are written (z-buffer).
    """
    height, width = depths.shape
    for triangle in range(len(triangles)):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        ax, ay, bx, by, cx, cy = (
            points[a, 0],
            points[a, 1],
            points[b, 0],
            points[b, 1],
            points[c, 0],
            points[c, 1],
        )
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0:  # seen from the edge
            continue
        for row in range(max(0, int(np.ceil(min(ay, by, cy)))), min(height, int(max(ay, by, cy)) + 1)):
            for column in range(max(0, int(np.ceil(min(ax, bx, cx)))), min(width, int(max(ax, bx, cx)) + 1)):
                u = ((column - ax) * (cy - ay) - (cx - ax) * (row - ay)) / area
                v = ((bx - ax) * (row - ay) - (column - ax) * (by - ay)) / area
                if u < 0 or v < 0 or u + v > 1:
                    continue
                depth = (1 - u - v) * points[a, 2] + u * points[b, 2] + v * points[c, 2]
                if depth < depths[row, column]:
                    depths[row, column] = depth
                    for k in range(3):
                        canvas_rgb[row, column, k] = (
                            (1 - u - v) * lit_rgb[a, k] + u * lit_rgb[b, k] + v * lit_rgb[c, k]
                        )


def _vertex_brightness(points_mm: PointsMM, triangles: Indices32) -> Singles:
    """Return the brightness (N,), 0..1, of each vertex, from the mean normal of its faces weighted by area."""
    a, b, c = (points_mm[triangles[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    corners = triangles.ravel()
    sums = [np.bincount(corners, np.repeat(face_normals[:, k], 3), len(points_mm)) for k in range(3)]
    normals: Floats = np.column_stack(sums)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    # half Lambert: soft light from a wide source, no hard terminator
    light = AMBIENT + sum(strength * (0.5 + 0.5 * normals @ toward) ** 2 for toward, strength in LIGHTS)
    return np.asarray(light ** (1 / SCREEN_GAMMA), dtype=np.float32)


def _draw_scale_bar(image: ColorImage, px_per_mm: float) -> None:
    size_px = len(image)
    length_mm = next((mm for mm in BAR_LENGTHS_MM if mm * px_per_mm < 0.6 * size_px), BAR_LENGTHS_MM[-1])
    margin, thickness = round(0.04 * size_px), max(1, size_px // 160)
    left, bottom = margin, size_px - margin
    right = left + round(length_mm * px_per_mm)
    cv2.rectangle(image, (left, bottom - thickness), (right, bottom), INK_RGB, cv2.FILLED)
    cv2.putText(
        image,
        f"{length_mm:g} mm",
        (left, bottom - 2 * thickness - 3),
        cv2.FONT_HERSHEY_SIMPLEX,
        size_px / 960,
        INK_RGB,
        1,
        cv2.LINE_AA,
    )
