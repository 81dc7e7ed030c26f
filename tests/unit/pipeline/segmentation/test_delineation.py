"""Sub-pixel edges between the core and what is possible, against arrays and formulas."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.special import ndtr
from support.extents import examples
from support.flat_delineation import flat_delineation

from pipeline.arrays import Floats, GreyImage, Mask, PointsUV
from pipeline.segmentation import (
    delineation,
    edge_refinement,
    edge_width,
    local_threshold,
    outline_fill,
    subpixel_edge,
)
from pipeline.segmentation.delineation import HOLE_PX, MIN_CONTRAST, Delineation, delineate
from pipeline.segmentation.local_threshold import RegionLevels, trimap_of
from pipeline.segmentation.noise import TYPICAL_NOISE
from pipeline.segmentation.segmenter_choice import warm_up
from pipeline.segmentation.silhouette import FINE_PX, INSIDE, MARGIN_PX, OUTSIDE, UNKNOWN

SIZE_PX = 220
WALL, BODY, BRIGHT = 130.0, 30.0, 230.0


def blob_px(rng: np.random.Generator, radius_px: float) -> Floats:
    """Return approximate distances (h, w) to the edge of a disc with bumps, positive within."""
    v, u = np.mgrid[:SIZE_PX, :SIZE_PX] - SIZE_PX / 2 + rng.uniform(-3, 3, size=(2, 1, 1))
    angle, bumps = np.arctan2(v, u), np.zeros((SIZE_PX, SIZE_PX))
    for waves in (2, 3, 5):
        bumps += rng.uniform(0, 0.15 / waves) * np.cos(waves * angle + rng.uniform(0, 2 * np.pi))
    return radius_px * (1 + bumps) - np.hypot(u, v)


def photographed(true_px: Floats, rng: np.random.Generator, noise: float, grey: float = BODY) -> GreyImage:
    image = WALL + (grey - WALL) * ndtr(true_px / 0.8) + noise * rng.normal(size=true_px.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def masks_of(true_px: Floats) -> tuple[Mask, Mask, Mask]:
    """Return masks (h, w) of core, possible and unknown pixels."""
    return blocky(true_px > 4.5), blocky(true_px > -4.5), np.zeros(true_px.shape, bool)


def blocky(mask: Mask) -> Mask:
    """Return the mask (h, w) made constant over blocks of 2 x 2."""
    height, width = mask.shape
    return np.asarray(mask[::2, ::2].repeat(2, axis=0).repeat(2, axis=1)[:height, :width])


def halved(*masks: Mask) -> GreyImage:
    return trimap_of(*(mask[::2, ::2] for mask in masks))


def wall() -> GreyImage:
    return np.full((SIZE_PX, SIZE_PX), WALL, np.uint8)


def outline_of(found: Delineation) -> PointsUV:
    assert found.edge is not None
    return found.edge.outline_uv


@examples(0.25)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(25, 65),
    st.floats(0, 2),
    st.sampled_from([BODY, BRIGHT]),
    st.booleans(),
)
def test_quick_and_flat_delineation_agree(
    seed: int, radius_px: float, noise: float, grey: float, has_hole: bool
) -> None:
    rng = np.random.default_rng(seed)
    true_px = blob_px(rng, radius_px)
    core, possible, unknown = masks_of(true_px)
    image = photographed(true_px, rng, noise, grey)
    for u, v in rng.integers(20, SIZE_PX - 20, size=(3, 2)):  # dark dots of the wall, here and there
        dot = np.zeros(unknown.shape, np.uint8)
        cv2.circle(dot, (int(u), int(v)), 9, 1, -1)
        unknown |= blocky(dot.astype(bool) & ~core)
    if has_hole:  # a glint
        glint = np.hypot(*(np.mgrid[:SIZE_PX, :SIZE_PX] - SIZE_PX / 2)) < 5
        image[glint] = round(WALL)
        core = blocky(core & ~glint)
    region = RegionLevels(
        image=image, expected=wall(), gain=np.float32(1), trimap=halved(core, possible, unknown)
    )
    found = delineation._delineated(
        region, MIN_CONTRAST, HOLE_PX, TYPICAL_NOISE
    )  # a second look is by detail
    labels, points, is_tie = flat_delineation(
        image.astype(np.float32), wall().astype(np.float32), core, possible, unknown
    )
    near_tie = cv2.dilate(is_tie.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    # what may be body beside a dark dot is unknown, too
    is_bridged = (found.labels == UNKNOWN) & (labels == OUTSIDE) & unknown.any()
    assert ((found.labels == labels) | near_tie | is_bridged).all()
    assert is_bridged.sum() < 0.1 * (labels == INSIDE).sum()
    if is_bridged.any():
        return  # the contour goes another way
    assert found.edge is not None
    (outer, *_), _ = cv2.findContours(found.edge.body, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    pixels = outer[found.edge.seen[: found.edge.ends[1]], 0]
    is_clear = ~near_tie[pixels[:, 1], pixels[:, 0]]
    assert is_clear.sum() > 0.5 * len(pixels)
    off_px = np.linalg.norm(outline_of(found) - points[pixels[:, 1], pixels[:, 0]], axis=1)[is_clear]
    # the half-way level there, the steepest slope here: rounding, curvature and noise tell them apart
    assert np.quantile(off_px, 0.95) < 0.1 + 0.03 * noise
    assert off_px.max() < 0.2 + 0.1 * noise


def test_gain_is_a_factor_on_what_is_expected() -> None:
    rng = np.random.default_rng(3)
    true_px = blob_px(rng, 50)
    image = photographed(true_px, rng, 2.0)
    one = delineate(image, wall(), halved(*masks_of(true_px)))
    other = delineate(image, wall() // 2, halved(*masks_of(true_px)), gain=2.0)
    np.testing.assert_array_equal(outline_of(one), outline_of(other))
    np.testing.assert_array_equal(one.labels, other.labels)


def test_where_body_and_background_are_alike_is_unknown_unless_it_is_core() -> None:
    rng = np.random.default_rng(4)
    true_px = blob_px(rng, 50)
    core, possible, unknown = masks_of(true_px)
    expected = wall()
    expected[:, 110:] = BODY  # a dark aperture behind the right half
    image = np.where(true_px > 0, BODY, expected).astype(np.uint8)
    labels = delineate(image, expected, halved(core, possible, unknown)).labels
    assert (labels[core] == INSIDE).all()
    assert (labels[:, 111:][(possible & ~core)[:, 111:]] == UNKNOWN).all()
    assert (labels[:, :108][~possible[:, :108]] == OUTSIDE).all()
    assert (labels[~possible] != INSIDE).all()
    assert (labels[:, :109][(true_px > 1)[:, :109]] == INSIDE).all()


def test_a_rim_that_shines_towards_its_edge_does_not_move_it() -> None:
    rng = np.random.default_rng(8)
    true_px = blob_px(rng, 55)
    grey = BODY + 40 * np.exp(
        -np.maximum(true_px, 0) / 2
    )  # half-way to the level behind it is 0.38 px within
    image = blurred(np.where(true_px > 0, grey, WALL), rng)
    expected = wall()
    found = delineate(image, expected, halved(*masks_of(true_px)))
    depths_px = map_coordinates(true_px, outline_of(found).T[::-1], order=1)
    assert found.edge is not None
    assert found.edge.seen.mean() > 0.99
    assert abs(depths_px.mean()) < 0.25


def test_a_step_within_the_body_is_not_taken_for_its_edge() -> None:
    rng = np.random.default_rng(9)
    true_px = blob_px(rng, 55)
    is_right = np.mgrid[:SIZE_PX, :SIZE_PX][1] > SIZE_PX / 2
    grey = np.where((true_px < 4) & is_right, 0.8 * WALL, BODY)  # a rim nearly as bright as the wall
    image = blurred(np.where(true_px > 0, grey, WALL), rng)
    core, _, unknown = masks_of(true_px - 2.5)
    found = delineate(image, wall(), halved(core, blocky(true_px > -4.5), unknown))
    depths_px = map_coordinates(true_px, outline_of(found).T[::-1], order=1)
    assert np.quantile(depths_px, 0.98) < 0.5, "nothing of the inner step is left"
    assert found.edge is not None
    assert (found.labels[true_px > 1] != OUTSIDE).mean() > 0.998
    assert found.edge.seen.mean() > 0.35, "the other half is seen, and the way around the unknown is longer"


def blurred(image: Floats, rng: np.random.Generator) -> GreyImage:
    noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(size=image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def test_only_the_largest_body_is_left_and_large_holes_are_seen_through() -> None:
    v, u = np.mgrid[:SIZE_PX, :SIZE_PX] - SIZE_PX / 2.0
    ring_px = np.minimum(70 - np.hypot(u, v), np.hypot(u, v) - 30)
    speck_px = 8 - np.hypot(u - 95, v - 95)
    true_px = np.maximum(ring_px, speck_px)
    image = photographed(true_px, np.random.default_rng(5), 1.0)
    found = delineate(image, wall(), halved(*masks_of(true_px)))
    assert found.labels[SIZE_PX // 2, SIZE_PX // 2] == OUTSIDE
    assert found.labels[205, 205] == OUTSIDE
    assert np.linalg.norm(outline_of(found) - SIZE_PX / 2, axis=1).min() > 69, "the outer contour alone"
    assert found.edge is not None
    distance_px = found.edge.fine_px(found.edge.coarse_px())
    ring_px, speck_px = ring_px[::FINE_PX, ::FINE_PX], speck_px[::FINE_PX, ::FINE_PX]
    near = np.abs(ring_px) < 8
    assert np.abs(distance_px - ring_px)[near].max() < 0.3
    assert abs((distance_px - ring_px)[near].mean()) < 0.02
    far = speck_px < -15
    excess_px = np.abs(distance_px[far]) - np.minimum(np.abs(ring_px[far]), MARGIN_PX)
    assert -4 < excess_px.min() < excess_px.max() < 0.5
    assert ((distance_px > 0) == (ring_px > 0))[far & ~near].all()
    filled = delineate(image, wall(), halved(*masks_of(true_px)), hole_px=4000)
    assert filled.labels[SIZE_PX // 2, SIZE_PX // 2] == INSIDE


def test_nothing_inside_is_no_edge() -> None:
    nowhere = np.zeros((SIZE_PX, SIZE_PX), bool)
    unknown = nowhere.copy()
    unknown[50:60, 50:60] = True
    found = delineate(wall(), wall(), halved(nowhere, nowhere, unknown))
    assert found.edge is None
    assert (found.labels == np.where(unknown, UNKNOWN, OUTSIDE)).all()


def test_after_the_warm_up_nothing_is_left_to_compile() -> None:
    kernels = [
        local_threshold._label_cells,
        local_threshold.find_crossings,
        edge_refinement.move_to_steepest,
        edge_refinement.find_doubtful,
        edge_refinement.undo_shrinkage,
        edge_width.measure_widths,
        outline_fill.redraw,
        subpixel_edge._interpolated,
        subpixel_edge._keep_nearest,
    ]
    warm_up()
    compiled = [len(kernel.signatures) for kernel in kernels]
    rng = np.random.default_rng(6)
    true_px = blob_px(rng, 50)
    found = delineate(photographed(true_px, rng, 2.0), wall(), halved(*masks_of(true_px)))
    assert found.edge is not None
    found.edge.fine_px(found.edge.coarse_px())
    wide = photographed(true_px / 3, rng, 2.0)
    assert delineate(wide, wall(), halved(*masks_of(true_px))).edge is not None
    assert [len(kernel.signatures) for kernel in kernels] == compiled


@pytest.mark.parametrize("is_possible", [True, False])
@pytest.mark.full
def test_where_nothing_can_be_kept_each_process_compiles_for_itself(
    is_possible: bool, tmp_path: Path
) -> None:
    code = (
        "from pipeline.compiled import compiled\n"
        "def doubled(x): return 2 * x\n"
        "twice = compiled(doubled)\n"
        "print(twice(21), type(twice._cache).__name__)"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    folder = tmp_path / "cache" if is_possible else script / "no-folder"
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[4]),
        "NUMBA_CACHE_DIR": str(folder),
        "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator",
    }
    done = subprocess.run(
        [sys.executable, str(script)], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["42", "FunctionCache" if is_possible else "NullCache"]
    assert folder.exists() == is_possible


@pytest.mark.parametrize(("width_px", "is_doubted"), [(1, False), (4, True)])
def test_only_more_than_one_point_in_a_row_makes_the_edge_doubtful(width_px: int, is_doubted: bool) -> None:
    v, u = np.mgrid[:SIZE_PX, :SIZE_PX]
    true_px = 60.0 - np.hypot(u - SIZE_PX / 2, v - SIZE_PX / 2)
    image = photographed(true_px, np.random.default_rng(3), 0.0)
    beside = slice(SIZE_PX // 2, SIZE_PX // 2 + width_px)
    image[SIZE_PX // 2 - 63, beside] -= 28  # darker than the wall
    found = delineate(image, wall(), halved(*masks_of(true_px)))
    assert (UNKNOWN in found.labels) == is_doubted
