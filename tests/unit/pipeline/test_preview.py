import cv2
import numpy as np
import pytest
import trimesh

from pipeline.preview import (
    BODY_SHARE,
    INK_RGB,
    PICTURE_PX,
    THUMBNAIL_PX,
    THUMBNAIL_VERTICES,
    VIEW_DIRECTION,
    colors_of,
    preview_png,
    render_preview,
)
from pipeline.synthesis.bodies import cube, sphere


def test_a_body_stands_lit_on_a_pale_ground() -> None:
    mesh = sphere().mesh
    image = render_preview(mesh.vertices + 100, mesh.faces, size_px=240)
    assert image.shape == (240, 240, 3)
    assert image.dtype == np.uint8
    corners = image[[0, 0, -1], [0, -1, -1]]
    assert corners.min() > 210
    # a disc of the promised size in the middle: stone is warm, the ground is not
    is_body = image[..., 0].astype(int) - image[..., 2] > 8
    assert is_body.sum() == pytest.approx(np.pi / 4 * (BODY_SHARE * 240) ** 2, rel=0.02)
    brightness = image.mean(axis=2)
    assert brightness[120 - 60, 120 - 40] > brightness[120 + 60, 120 + 40] + 20, "lit from above and the left"


def test_edges_are_smooth() -> None:
    mesh = sphere().mesh
    image = render_preview(mesh.vertices, mesh.faces, size_px=101).astype(int)
    warmth = image[..., 0] - image[..., 2]
    assert ((warmth > 3) & (warmth < 12)).sum() > 40, "samples of edge pixels are averaged"


def test_the_bar_is_10_mm_long() -> None:
    mesh = sphere(15.0).mesh
    image = render_preview(mesh.vertices, mesh.faces, size_px=480)
    ink = (image == INK_RGB).all(axis=2)
    row = ink.sum(axis=1).argmax()
    assert ink[row].sum() == pytest.approx(10 * BODY_SHARE * 480 / 15, abs=1.5)
    tiny = render_preview(mesh.vertices / 20, mesh.faces, size_px=480)
    ink = (tiny == INK_RGB).all(axis=2)
    assert ink.sum(axis=1).max() == pytest.approx(BODY_SHARE * 480 / 0.75 * 0.1, abs=1.5)


def test_the_faces_of_a_cube_differ() -> None:
    mesh = cube().mesh
    image = render_preview(mesh.vertices, mesh.faces, size_px=120).mean(axis=2)
    top, left, right = image[35, 60], image[75, 40], image[75, 80]
    assert top > left > right


def test_unused_vertices_and_no_faces() -> None:
    mesh = trimesh.creation.box()
    lonely = np.vstack([mesh.vertices, [[1000.0, 0, 0]]])
    assert np.array_equal(
        render_preview(lonely, mesh.faces, 64), render_preview(mesh.vertices, mesh.faces, 64)
    )
    with pytest.raises(ValueError, match="without faces"):
        render_preview(mesh.vertices, np.empty((0, 3)))


def test_colors_of_vertices_survive_the_shade() -> None:
    mesh = sphere().mesh
    colors_rgb = np.where(mesh.vertices[:, 2:] > 0, (0.8, 0.1, 0.1), (0.1, 0.1, 0.8))
    image = render_preview(mesh.vertices, mesh.faces, 120, colors_rgb=colors_rgb).astype(int)
    assert image[30, 60, 0] > 2 * image[30, 60, 2]
    assert image[92, 60, 2] > 2 * image[92, 60, 0]
    behind = render_preview(
        mesh.vertices, mesh.faces, 120, colors_rgb=colors_rgb, view_direction=(0.5, -0.7, 0.45)
    )
    assert behind[88, 60, 2] > behind[88, 60, 0], "seen from below"


def test_greys_of_cameras_are_shown_as_bright_as_they_were_and_shaded() -> None:
    mesh = sphere().mesh
    colors_rgb = colors_of(np.where(mesh.vertices[:, 2] > 0, 200, 50).astype(np.uint8))
    assert np.unique(colors_rgb) == pytest.approx([(50 / 255) ** (1 / 2.2), (200 / 255) ** (1 / 2.2)])
    flat, shaded = (
        render_preview(mesh.vertices, mesh.faces, 120, colors_rgb=colors_rgb, unshaded_share=share).astype(
            int
        )
        for share in (1.0, 0.0)
    )
    assert flat[30, 60] == pytest.approx(255 * (200 / 255) ** (1 / 2.2), abs=1)
    assert flat[92, 60] == pytest.approx(255 * (50 / 255) ** (1 / 2.2), abs=1)
    assert (np.ptp(shaded[30:92, 60], axis=1) == 0).all()
    assert shaded[92, 60, 0] < 0.9 * flat[92, 60, 0], "its underside is in the shade"


def test_what_is_nearer_hides_what_is_behind_in_whatever_order_they_come() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=5.0)
    behind_mm = 20 * np.array(VIEW_DIRECTION)
    vertices_mm = np.vstack([ball.vertices, ball.vertices + behind_mm])
    faces = np.vstack([ball.faces, ball.faces + len(ball.vertices)])
    colors_rgb = np.repeat([(0.8, 0.1, 0.1), (0.1, 0.1, 0.8)], len(ball.vertices), axis=0)
    image = render_preview(vertices_mm, faces, 120, colors_rgb=colors_rgb)
    assert np.array_equal(image, render_preview(vertices_mm, faces[::-1], 120, colors_rgb=colors_rgb))
    assert image[60, 60, 0] > 2 * image[60, 60, 2]
    is_blue = image[..., 2].astype(int) - image[..., 0] > 40
    assert not is_blue.any(), "all of the ball behind is hidden"


def test_a_thumbnail_looks_like_the_picture_at_half_its_size() -> None:
    body = sphere().mesh.subdivide()  # more vertices than a thumbnail has
    assert len(body.vertices) > THUMBNAIL_VERTICES
    greys = np.where(body.vertices[:, 2] > 0, 200, 50).astype(np.uint8)
    thumbnail, picture = (
        cv2.imdecode(np.frombuffer(preview_png(body.vertices, body.faces, greys, size), np.uint8), 1)
        for size in (THUMBNAIL_PX, PICTURE_PX)
    )
    assert thumbnail is not None
    assert picture is not None
    assert thumbnail.shape == (THUMBNAIL_PX, THUMBNAIL_PX, 3)
    difference = np.abs(cv2.pyrDown(picture).astype(int) - thumbnail)[:200]  # above the scale bar's text
    assert np.mean(difference) < 2
    assert len(preview_png(body.vertices, body.faces, greys, THUMBNAIL_PX)) < 40_000
