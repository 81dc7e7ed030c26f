"""Refine the estimate: shift its surface to where the views show the same grey values.

The shift is a height field over the estimate's surface, along its smoothed normals. It is found at nodes, in passes
from coarse to fine: where the patch around a node looks most alike in the views that see it, as far as its neighbours
agree (belief propagation), and only where the neighbourhood has evidence. Elsewhere, and where a tangent ray touches,
the estimate stays: there the silhouettes say more. Sharp convex edges, which mislead flat patches, follow what lies
beside them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats, PointsMM, Values
from pipeline.estimate import BodyEstimate, estimate_body
from pipeline.frames import CameraId, Frame
from pipeline.geometry.icosphere import icosphere
from pipeline.meshing import ParticleMesh
from pipeline.refinement.crossings import without_crossings
from pipeline.refinement.membrane import stretched
from pipeline.refinement.node_field import (
    beyond_chance,
    depths_of,
    facing,
    flat_gate,
    patch_sagittas,
    tangent_axes,
    touch_weights,
    without_spikes,
)
from pipeline.refinement.nodes import Nodes, smoothed, spread_nodes, vertex_normals
from pipeline.refinement.passes import (
    FULL_SIZE_MM,
    LEAST_SCALE,
    NORMAL_ROUNDS,
    OLDER,
    PASSES,
    PIN,
    SURE,
    TRUNCATED_MM,
    Pass,
)
from pipeline.refinement.patch_scores import Patches, patch_samples, patch_scores
from pipeline.refinement.propagation import propagate
from pipeline.refinement.shift_field import Field, carried_over, vertex_shifts
from pipeline.refinement.sightings import PhotoViews, depth_maps, photo_views, sightings
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import RADIUS_MM, ball_silhouettes
from pipeline.views.prepared import PreparedViews, prepare_views

BETWEEN = 0.02
"""Weight of a node that only its neighbours say something of."""
MIN_SUPPORTED = 0.1
"""Share of the surface below which the estimate stays as it is: so few patches are alike by chance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refinement:
    """The refined body, and how much of its surface the pixels say something about."""

    mesh: ParticleMesh  # the estimate's own where nothing was refined
    views: PhotoViews  # as they were read
    supported_share: float  # of the surface, 0 to 1
    relief_mm: float = (
        0.0  # rms by which the last pass still shifted what is supported: finer relief is as deep
    )
    fallback: str | None = None  # why the estimate stays as it is


def warm_up() -> Refinement:
    """Refine a made-up ball, which compiles all that the first stone would wait for."""
    ball, frames, views = made_up_ball()
    without_crossings(ball.vertices_mm, ball.faces)
    return refine_body(estimate_body(ball, views), ball, frames, views)


def made_up_ball() -> tuple[ParticleMesh, Mapping[CameraId, Frame], PreparedViews]:
    """Return a ball with frames of noise."""
    rig = nominal_rig()
    directions, faces = icosphere(subdivisions=5)
    ball = ParticleMesh(RADIUS_MM * directions, faces)
    noise = np.random.default_rng(0).integers(40, 80, rig.cameras[0].image_size_px[::-1], dtype=np.uint8)
    frames = {
        camera.id: Frame(camera=camera.id, image=noise, frame_id=0, device_ns=0, received_ns=0)
        for camera in rig.cameras
    }
    return ball, frames, prepare_views(ball_silhouettes(rig), rig)


def refine_body(
    estimate: BodyEstimate,
    hull: ParticleMesh,
    frames: Mapping[CameraId, Frame],
    prepared: PreparedViews,
) -> Refinement:
    """Shift the estimate's surface, within the hull, to where the pixels inside the outlines say that it lies.

    `hull` is the mesh that the estimate was made from, by the views `prepared` of these frames.
    """
    vertices_mm, faces = estimate.mesh.vertices_mm, estimate.mesh.faces
    normals = vertex_normals(vertices_mm, faces)
    size_mm = float(np.cbrt(estimate.volume_mm3))
    scale = float(np.clip(size_mm / FULL_SIZE_MM, LEAST_SCALE, 1.0))
    views = photo_views(frames, prepared, vertices_mm)
    field = None
    for level in _levels(vertices_mm, normals, estimate.corners_mm, scale):
        field = _passed(level, field, views, scale, size_mm)
    supported_share = 0.0 if field is None else field.supported_share
    if field is None or supported_share < MIN_SUPPORTED:
        return Refinement(
            mesh=estimate.mesh, views=views, supported_share=0.0, fallback="no texture that the views share"
        )
    shifts_mm = vertex_shifts(field, vertices_mm, normals, hull.vertices_mm - vertices_mm)
    moved_mm = without_crossings(vertices_mm + shifts_mm, faces)
    if moved_mm is None:
        return Refinement(
            mesh=estimate.mesh, views=views, supported_share=0.0, fallback="the surface would cross itself"
        )
    mesh = ParticleMesh(moved_mm, faces)
    return Refinement(mesh=mesh, views=views, supported_share=supported_share, relief_mm=field.found_mm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Level:
    """A pass, the nodes it shifts, and what holds these to the estimate."""

    each: Pass
    nodes: Nodes
    gate: Values  # (K,) 1 where the estimate is smooth, 0 at its sharp convex edges
    touches: Values  # (K,) 1 where a tangent ray touches, 0 far from it


def _levels(vertices_mm: PointsMM, normals: Floats, touches_mm: PointsMM, scale: float) -> list[_Level]:
    """Return nodes for each pass: those of a coarse one are some of the next finer one's."""
    order = np.random.default_rng(0).permutation(len(vertices_mm))  # always the same: no pattern, no chance
    nodes = spread_nodes(vertices_mm, normals, scale * PASSES[-1].spacing_mm, order)
    gate, touches = flat_gate(nodes), touch_weights(nodes.points_mm, touches_mm)
    smooth = smoothed(nodes, nodes.normals, NORMAL_ROUNDS)
    nodes = nodes._replace(normals=smooth / np.linalg.norm(smooth, axis=1)[:, None])
    levels = [_Level(each=PASSES[-1], nodes=nodes, gate=gate, touches=touches)]
    for each in reversed(PASSES[:-1]):
        nodes = spread_nodes(nodes.points_mm, nodes.normals, scale * each.spacing_mm)
        gate, touches = gate[nodes.chosen], touches[nodes.chosen]
        levels.append(_Level(each=each, nodes=nodes, gate=gate, touches=touches))
    return levels[::-1]


def _passed(level: _Level, before: Field | None, views: PhotoViews, scale: float, size_mm: float) -> Field:
    """Return the shifts after one pass."""
    each, nodes, gate, touches = level.each, level.nodes, level.gate, level.touches
    half_mm = scale * each.half_mm
    is_last = each is PASSES[-1]
    base_mm, base_peaked = np.zeros((2, len(nodes.points_mm)))
    if before is not None:
        base_mm, base_peaked = carried_over(before, nodes)
    points_mm = nodes.points_mm - base_mm[:, None] * nodes.normals
    normals = nodes.normals if before is None else facing(points_mm, nodes)
    maps = depth_maps(views, points_mm)
    seen_by = sightings(views, maps, points_mm, normals, half_mm, each.max_views)
    depths_mm = each.depths_mm(size_mm)
    patches = Patches(points_mm, -nodes.normals, tangent_axes(normals), half_mm, *seen_by)
    scores = patch_scores(views, patches, depths_mm, each)
    costs = gate[:, None] * (1 - scores) + each.staying * np.abs(depths_mm)
    costs += PIN * touches[:, None] * np.abs(base_mm[:, None] + depths_mm)
    stiffness = each.stiffness / nodes.spacing_mm
    beliefs = propagate(
        costs.astype(np.float32),
        nodes.neighbours,
        stiffness * float(depths_mm[1] - depths_mm[0]),
        stiffness * TRUNCATED_MM,
    )
    found_mm, sure, is_peak = depths_of(beliefs, scores, depths_mm, nodes, gate)
    is_supported = sure > 0
    rms_mm = float(np.sqrt(np.mean(found_mm[is_supported] ** 2))) if is_supported.any() else 0.0
    if is_last:
        found_mm = found_mm + patch_sagittas(
            points_mm, normals, nodes, half_mm, *patch_samples(each.n_samples)
        )
        # what only larger patches show, as the bottom of a dent, stays as they found it
        sure = np.maximum(sure, OLDER * gate * np.clip(base_peaked / SURE - 1, 0, 1))
    shifts_mm, weights = base_mm + np.where(is_supported, found_mm, 0.0), sure
    shifts_mm = without_spikes(shifts_mm, nodes, each.spike_slope * nodes.spacing_mm)
    if is_last:
        anchors = touches**4  # at the very points
        shifts_mm = stretched(beyond_chance(shifts_mm, sure, nodes), sure, anchors, nodes)
        weights = sure + anchors + BETWEEN
    return Field(
        nodes=nodes,
        shifts_mm=shifts_mm,
        weights=weights,
        sure=sure,
        peaked=np.where(is_peak, sure, 0.0),
        supported_share=float((is_supported & ~nodes.at_edge).sum() / max((~nodes.at_edge).sum(), 1)),
        found_mm=rms_mm,
    )
