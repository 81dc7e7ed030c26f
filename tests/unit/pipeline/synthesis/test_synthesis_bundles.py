from dataclasses import replace

import numpy as np
import pytest
from support.extents import first_quick
from support.synthetic_rigs import QUIET, rig_of, upright

from pipeline.fall import vertical_extent_mm
from pipeline.frames import BundleKind, CameraId
from pipeline.measuring import measure_shape
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.bodies import Body, ball, cube, sphere
from pipeline.synthesis.bundles import render_bundle, render_empty, stream, without_views
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, simulate_rig
from pipeline.synthesis.stones import stone
from pipeline.synthesis.truth import truth_of, truth_to_document


@pytest.fixture(scope="module")
def simulated() -> RenderedRig:
    return simulate_rig(rig_of("c01", "c06", "c11", binning=8), np.random.default_rng(0), QUIET)


def test_frames_arrive_after_the_fall_the_exposure_and_the_transfer(simulated: RenderedRig) -> None:
    moving = replace(simulated, parameters=replace(QUIET, exposure_us=500))
    bundle = render_bundle([upright(sphere())], moving, stream(0, 1), sequence=9, label="sphere")
    assert bundle.name == "000009-sphere"
    assert bundle.kind is BundleKind.PARTICLE
    assert tuple(bundle.frames) == simulated.rig.camera_ids
    delays_ms = [(f.received_ns - bundle.trigger.received_ns) / 1e6 for f in bundle.frames.values()]
    assert all(abs(delay_ms - (247.4 + 0.5 + 12)) <= 1 for delay_ms in delays_ms)
    assert len(set(delays_ms)) == 3


def on_edge(body: Body) -> PlacedBody:
    turned = np.array([[1, 0, 0], [0, 1, -1], [0, 1, 1]]) / [[1], [np.sqrt(2)], [np.sqrt(2)]]
    return PlacedBody(body=body, R=turned, offset_mm=np.zeros(3))


@pytest.mark.parametrize(
    ("bodies", "extent_mm"),
    first_quick(
        [
            ([on_edge(cube(10))], 10 * np.sqrt(2)),
            ([upright(sphere(), (0, 0, 3))], 15),
            ([upright(cube(10))], 10),
            ([upright(sphere(8), (5, 0, 6)), upright(sphere(6), (-5, 0, -7))], 20),
        ]
    ),
)
def test_the_beam_is_closed_while_a_body_falls_by_its_extent(
    simulated: RenderedRig, bodies: list[PlacedBody], extent_mm: float
) -> None:
    widths_ns = [
        render_bundle(bodies, simulated, stream(seed), sequence=1).trigger.pulse_width_ns for seed in range(9)
    ]
    found_mm = [vertical_extent_mm(width_ns or 0) for width_ns in widths_ns]
    assert found_mm == pytest.approx([extent_mm] * 9, rel=0.0065)
    assert np.ptp(found_mm) > 0.002 * extent_mm
    assert render_bundle([], simulated, stream(0), sequence=1).trigger.pulse_width_ns is None


def test_counters_and_clocks_run_on_from_bundle_to_bundle(simulated: RenderedRig) -> None:
    bundles = [render_empty(simulated, stream(0, i), sequence=i) for i in range(134, 138)]
    assert [bundle.trigger.utc for bundle in bundles[:2]] == [
        "2026-01-01T00:00:33.250Z",
        "2026-01-01T00:00:33.500Z",
    ]
    assert all(bundle.kind is BundleKind.BACKGROUND for bundle in bundles)
    assert np.ptp([f.frame_id for f in bundles[0].frames.values()]) > 1000, "every camera counts for itself"
    # the first camera started at 65402 and goes from 65535 to 1
    assert [bundle.frames[CameraId("c01")].frame_id for bundle in bundles] == [65535, 1, 2, 3]
    for camera in simulated.rig.camera_ids:
        steps_ns = np.diff([bundle.frames[camera].device_ns for bundle in bundles])
        assert np.abs(steps_ns - 250_000_000).max() <= 1000


def test_lost_views_are_named(simulated: RenderedRig) -> None:
    bundle = without_views(render_empty(simulated, stream(0, 1), sequence=1), [CameraId("c06")], "no frame")
    assert set(bundle.frames) == {"c01", "c11"}
    assert bundle.missing == {"c06": "no frame"}


def test_streams_are_independent_of_one_another() -> None:
    assert stream(5, 2, 7).integers(1 << 60) == stream(5, 2, 7).integers(1 << 60)
    draws = [stream(*key).integers(1 << 60) for key in [(5, 2, 7), (5, 2, 8), (5, 1, 7), (6, 2, 7)]]
    assert len(set(draws)) == 4


@pytest.mark.parametrize("seed", first_quick(range(3)))
def test_tumbling_bodies_are_whole_in_every_view(seed: int) -> None:
    rig = as_built(nominal_rig(), seed)
    rng = np.random.default_rng(seed)
    placed = [tumble(stone("elongated", 30.0, rng), rig, rng) for _ in range(3)]
    for body in placed:
        vertices_mm = body.world_mesh.vertices
        assert np.abs(vertices_mm).max() < 25
        assert np.linalg.det(body.R) == pytest.approx(1)
        for camera in rig.cameras:
            pixels_uv, _ = camera.project(vertices_mm)
            assert pixels_uv.min() >= 8
            assert (pixels_uv.max(axis=0) <= np.array(camera.image_size_px) - 9).all()
    assert 0.1 < np.std([body.offset_mm for body in placed]) < 4
    assert not np.allclose(placed[0].R, placed[1].R, atol=0.1)


def test_a_body_larger_than_the_view_is_still_placed() -> None:
    placed = tumble(cube(40.0), nominal_rig(), np.random.default_rng(0))
    assert np.abs(placed.offset_mm).max() <= 4.5


def test_the_truth_is_that_of_the_photographed_body(simulated: RenderedRig) -> None:
    rng = stream(0, 3)
    placed = tumble(ball(), simulated.rig, rng)
    bundle = render_bundle([placed], simulated, rng, sequence=2, label="ball")
    truth = truth_of(placed, bundle, measure_shape(placed.body.mesh.vertices, placed.body.mesh.faces))
    np.testing.assert_allclose(truth.mesh.center_mass, placed.offset_mm, atol=1e-9)
    document = truth_to_document(truth)
    assert document["bundle"] == bundle.name == "000002-ball"
    assert document["kind"] == "ball"
    assert document["volume_mm3"] == pytest.approx(truth.mesh.volume)
    assert document["max_feret_mm"] == pytest.approx(10, abs=0.002)
    np.testing.assert_allclose(document["center_mm"], placed.offset_mm)
    in_body_frame_mm = (truth.mesh.vertices - document["center_mm"]) @ np.array(document["R"])
    np.testing.assert_allclose(in_body_frame_mm, placed.body.mesh.vertices, atol=1e-9)
