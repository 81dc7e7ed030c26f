"""Draw the three pictures of the README from one synthetic stone: a view, its silhouette and the mesh.

Run: .venv/bin/python tests/benchmarks/pictures.py [--form angular] [--size-mm 24] [--seed 3] [--camera c05]
     [--out FOLDER]

The stone is rendered and measured as everywhere else, so the pictures follow from the arguments
alone. The mesh is seen from the direction of the camera whose view is shown.
"""

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.evaluation.scene import BODY, build_scene
from pipeline.frames import CameraId
from pipeline.particle import PipelineParameters, measure_bundle
from pipeline.preview import STONE_RGB, colors_of, render_preview
from pipeline.segmentation.silhouette import Silhouette, is_beside_gap
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import STONE_FORMS, stone

Picture = NDArray[np.uint8]

FOLDER = Path(__file__).parents[2] / "deploy" / "pictures"
EDGE_PX = 400
MARGIN_SHARE = 0.15
"""Margin around the stone, as a share of its larger side."""
OUTLINE_BGR = (40, 40, 230)
INSET_PX = 130
"""Edge of the inset that shows a piece of the outline over the view, its frame included."""
INSET_SCALE = 8
"""Pixels of the inset for one pixel of the camera."""
FRAME_PX = 2
SUBPIXEL_BITS = 4


def main() -> int:
    """Write view.png, silhouette.png and mesh.png; return 1 if the stone was not measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--form", choices=STONE_FORMS, default="angular")
    parser.add_argument("--size-mm", type=float, default=24)
    parser.add_argument("--seed", type=int, default=3, help="of rig, stone, pose and noise")
    parser.add_argument("--camera", default="c05", help="whose view is shown")
    parser.add_argument("--out", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    scene = build_scene(arguments.seed)
    rng = stream(arguments.seed, BODY)
    placed = tumble(stone(arguments.form, arguments.size_mm, rng), scene.true_rig, rng)
    bundle = scene.photograph(placed, rng, arguments.form)
    result = measure_bundle(
        bundle, scene.true_rig, scene.background, BackgroundSegmenter(), PipelineParameters()
    )
    if result.mesh is None:
        sys.stderr.write(f"the stone was not measured: {result.rejection}\n")
        return 1
    camera = next(each for each in scene.true_rig.cameras if each.id == arguments.camera)
    image, silhouette = bundle.frames[camera.id].image, result.silhouettes[CameraId(camera.id)]
    corner_uv, side_px = crop_around(silhouette)
    x, y, z = -camera.center_mm
    mesh_rgb = render_preview(
        result.mesh.vertices_mm,
        result.mesh.faces,
        EDGE_PX,
        colors_rgb=STONE_RGB if result.greys is None else colors_of(result.greys),
        unshaded_share=0.0,
        view_direction=(float(x), float(y), float(z)),
    )
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, picture in {
        "view": enlarged(image, corner_uv, EDGE_PX / side_px, EDGE_PX),
        "silhouette": silhouette_picture(image, silhouette, corner_uv, EDGE_PX / side_px),
        "mesh": mesh_rgb[..., ::-1],
    }.items():
        cv2.imwrite(str(arguments.out / f"{name}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return 0


def crop_around(silhouette: Silhouette) -> tuple[NDArray[np.float64], float]:
    """Return the upper left corner (u, v) and the side of a square around the stone, in px of the image."""
    left, top, width, height = cv2.boundingRect((silhouette.label_image() > 0).astype(np.uint8))
    side_px = max(width, height) * (1 + 2 * MARGIN_SHARE)
    return np.array([left, top]) + (np.array([width, height]) - side_px) / 2, side_px


def enlarged(
    image: Picture, corner_uv: NDArray[np.float64], scale: float, edge_px: int, *, keep_pixels: bool = False
) -> Picture:
    """Return the square of an image that begins at `corner_uv`, scaled to (edge_px, edge_px)."""
    shift_uv = _shift_uv(corner_uv, scale)
    to_square = np.array([[scale, 0, shift_uv[0]], [0, scale, shift_uv[1]]])
    interpolation = cv2.INTER_NEAREST if keep_pixels else cv2.INTER_LINEAR
    square = cv2.warpAffine(
        image, to_square, (edge_px, edge_px), flags=interpolation, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(square, np.uint8)


def silhouette_picture(
    image: Picture, silhouette: Silhouette, corner_uv: NDArray[np.float64], scale: float
) -> Picture:
    """Return the labels (0 outside, 128 unknown, 255 inside) with the outline; an inset shows it over the view."""
    labels = enlarged(silhouette.label_image(), corner_uv, scale, EDGE_PX, keep_pixels=True)
    picture = cv2.cvtColor(labels, cv2.COLOR_GRAY2BGR)
    draw_outline(picture, silhouette.outline_uv, corner_uv, scale)
    rows, columns = emptiest_corner(labels)
    points = silhouette.outline_uv * scale + _shift_uv(corner_uv, scale)
    center_uv = silhouette.outline_uv[np.argmin(np.linalg.norm(points - [columns.start, rows.start], axis=1))]
    half_px = (INSET_PX - 2 * FRAME_PX) / INSET_SCALE / 2
    inset_px = INSET_PX - 2 * FRAME_PX
    inset = cv2.cvtColor(
        enlarged(image, center_uv - half_px, INSET_SCALE, inset_px, keep_pixels=True), cv2.COLOR_GRAY2BGR
    )
    draw_outline(inset, silhouette.outline_uv, center_uv - half_px, INSET_SCALE)
    low, high = (_place(center_uv + offset, corner_uv, scale) for offset in (-half_px, half_px))
    cv2.rectangle(picture, low, high, OUTLINE_BGR, 1, cv2.LINE_AA)
    # from the marker to the edge of the inset that faces it
    ends_v = (high[1], rows.start) if rows.start > 0 else (low[1], rows.stop - 1)
    for ends_u in ((low[0], columns.start), (high[0], columns.stop - 1)):
        cv2.line(picture, *zip(ends_u, ends_v, strict=True), OUTLINE_BGR, 1, cv2.LINE_AA)
    picture[rows, columns] = cv2.copyMakeBorder(
        inset, *4 * [FRAME_PX], cv2.BORDER_CONSTANT, value=OUTLINE_BGR
    )
    return np.asarray(picture, np.uint8)


def emptiest_corner(labels: Picture) -> tuple[slice, slice]:
    """Return the rows and columns of the corner, as large as the inset, that shows least of the stone."""
    ends = (slice(0, INSET_PX), slice(EDGE_PX - INSET_PX, EDGE_PX))
    return min(
        ((rows, columns) for rows in ends for columns in ends), key=lambda corner: labels[corner].sum()
    )


def draw_outline(
    picture: Picture, outline_uv: NDArray[np.float64], corner_uv: NDArray[np.float64], scale: float
) -> None:
    """Draw a closed outline (N, 2) of image coordinates, where it was seen, into a square made by `enlarged`."""
    points = np.rint((outline_uv * scale + _shift_uv(corner_uv, scale)) * 2**SUBPIXEL_BITS).astype(np.int32)
    is_gap = is_beside_gap(outline_uv)
    pieces = np.stack([points, np.roll(points, -1, axis=0)], axis=1)[~(is_gap & np.roll(is_gap, -1))]
    cv2.polylines(picture, list(pieces), False, OUTLINE_BGR, 2, cv2.LINE_AA, SUBPIXEL_BITS)


def _shift_uv(corner_uv: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """Return the translation that goes with `scale`: a pixel's centre is its coordinate, here as there."""
    return (0.5 - corner_uv) * scale - 0.5


def _place(point_uv: NDArray[np.float64], corner_uv: NDArray[np.float64], scale: float) -> tuple[int, int]:
    u, v = np.rint(point_uv * scale + _shift_uv(corner_uv, scale)).astype(int)
    return int(u), int(v)


if __name__ == "__main__":
    sys.exit(main())
