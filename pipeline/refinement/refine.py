"""Refine the estimate: shift its surface to where the views show the same grey values.

The shift is a height field over the estimate's surface, along its smoothed normals. It is found at nodes, in passes
from coarse to fine: where the patch around a node looks most alike in the views that see it, as far as its neighbours
agree (belief propagation), and only where the neighbourhood has evidence. Elsewhere, and where a tangent ray touches,
the estimate stays: there the silhouettes say more. Sharp convex edges, which mislead flat patches, follow what lies
beside them. In the end each point of the surface found so is aligned to its grey levels by itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from pipeline.arrays import Flags, Floats, PointsMM, Values
from pipeline.estimate import BodyEstimate, estimate_body
from pipeline.frames import CameraId, Frame
from pipeline.geometry.icosphere import icosphere
from pipeline.meshing import ParticleMesh
from pipeline.refinement.crossings import without_crossings
from pipeline.refinement.grey_alignment import aligned
from pipeline.refinement.membrane import stretched
from pipeline.refinement.node_field import (
    beyond_chance,
    flat_gate,
    touch_weights,
    without_spikes,
)
from pipeline.refinement.nodes import Nodes, smoothed, spread_nodes, vertex_normals, widened
from pipeline.refinement.passes import NORMAL_ROUNDS, OLDER, PASSES, SURE
from pipeline.refinement.search import Found, Level, Photographed, search, search_again
from pipeline.refinement.shift_field import Field, carried_over, vertex_shifts
from pipeline.refinement.sightings import PhotoViews, photo_views
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.background import BackgroundModel
from pipeline.segmentation.ball_silhouettes import RADIUS_MM, ball_silhouettes
from pipeline.uncertainty.evidence import UNSUPPORTED, PixelSupport
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
    support: PixelSupport = UNSUPPORTED
    fallback: str | None = None  # why the estimate stays as it is


def warm_up() -> Refinement:
    """Refine a made-up ball, which compiles all that the first stone would wait for."""
    ball, frames, views = made_up_ball()
    without_crossings(ball.vertices_mm, ball.faces)
    refined = refine_body(estimate_body(ball, views), ball, frames, views)
    aligned(ball.vertices_mm, ball.faces, ball.vertices_mm, np.zeros((0, 3)), refined.views, 1.0)
    return refined


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
    background: BackgroundModel = MappingProxyType({}),
) -> Refinement:
    """Shift the estimate's surface, within the hull, to where the pixels inside the outlines say that it lies.

    `hull` is the mesh that the estimate was made from, by the views `prepared` of these frames.
    """
    vertices_mm, faces = estimate.mesh.vertices_mm, estimate.mesh.faces
    normals = vertex_normals(vertices_mm, faces)
    views = photo_views(frames, prepared, vertices_mm, background)
    stone = Photographed(views=views, size_mm=float(np.cbrt(estimate.volume_mm3)))
    field = None
    touches_mm = estimate.corners_mm[estimate.is_seen]
    for level in _levels(vertices_mm, normals, touches_mm, stone.scale):
        field = _passed(level, field, stone)
    if field is None or field.support.share < MIN_SUPPORTED:
        return Refinement(mesh=estimate.mesh, views=views, fallback="no texture that the views share")
    shifts_mm = vertex_shifts(field, vertices_mm, normals, hull.vertices_mm - vertices_mm)
    moved_mm = aligned(vertices_mm + shifts_mm, faces, hull.vertices_mm, touches_mm, views, stone.scale)
    clean_mm = without_crossings(moved_mm, faces, (vertices_mm, hull.vertices_mm))
    if clean_mm is None:
        return Refinement(mesh=estimate.mesh, views=views, fallback="the surface would cross itself")
    return Refinement(mesh=ParticleMesh(clean_mm, faces), views=views, support=field.support)


def _levels(vertices_mm: PointsMM, normals: Floats, touches_mm: PointsMM, scale: float) -> list[Level]:
    """Return nodes for each pass: those of a coarse one are some of the next finer one's."""
    order = np.random.default_rng(0).permutation(len(vertices_mm))  # always the same: no pattern, no chance
    nodes = spread_nodes(vertices_mm, normals, scale * PASSES[-1].spacing_mm, order)
    touches = touch_weights(nodes.points_mm, touches_mm)
    gate = flat_gate(nodes, touches)
    smooth = smoothed(nodes, nodes.normals, NORMAL_ROUNDS)
    nodes = nodes._replace(normals=smooth / np.linalg.norm(smooth, axis=1)[:, None])
    levels = [Level(each=PASSES[-1], nodes=nodes, gate=gate, touches=touches)]
    for each in reversed(PASSES[:-1]):
        nodes = spread_nodes(nodes.points_mm, nodes.normals, scale * each.spacing_mm)
        gate, touches = gate[nodes.chosen], touches[nodes.chosen]
        levels.append(Level(each=each, nodes=nodes, gate=gate, touches=touches))
    return levels[::-1]


def _passed(level: Level, before: Field | None, stone: Photographed) -> Field:
    """Return the shifts after one pass."""
    nodes = level.nodes
    before_mm, peaked_before = np.zeros((2, len(nodes.points_mm)))
    if before is not None:
        before_mm, peaked_before = carried_over(before, nodes)
    found = search(level, before_mm, stone, nodes.normals if before is None else None)
    if level.each is PASSES[-1]:
        return _finished(level, found, peaked_before, stone)
    shifts_mm = without_spikes(found.shifts_mm, nodes, level.most_mm)
    return _field(nodes, found, shifts_mm, found.sure, found.sure > 0)


def _finished(level: Level, found: Found, peaked_before: Values, stone: Photographed) -> Field:
    """Return the shifts after the last pass, which found all this, and what was searched again."""
    nodes = level.nodes
    found, is_alike, is_new = search_again(level, found, stone)
    # what only larger patches show, as the bottom of a dent, stays as they found it
    older = OLDER * level.gate * np.clip(peaked_before / SURE - 1, 0, 1)
    sure, anchors = np.maximum(found.sure, older), level.touches**4  # anchored at the very points
    smooth_mm = without_spikes(found.shifts_mm, nodes, level.most_mm)
    shifts_mm = beyond_chance(np.where(is_new, found.shifts_mm, smooth_mm), sure, nodes)
    field = _field(
        nodes, found, stretched(shifts_mm, sure, anchors, nodes), sure, is_alike & (found.sure > 0)
    )
    return replace(field, weights=sure + anchors + BETWEEN)


def _field(nodes: Nodes, found: Found, shifts_mm: Values, sure: Values, is_supported: Flags) -> Field:
    return Field(
        nodes=nodes,
        shifts_mm=shifts_mm,
        weights=sure,
        sure=sure,
        peaked=np.where(found.is_peak, sure, 0.0),
        support=PixelSupport(
            share=_share(is_supported, nodes),
            blank_share=_share(~widened(is_supported, nodes), nodes),
            depth_mm=_rms_mm(shifts_mm[is_supported]),
            relief_mm=_rms_mm(found.steps_mm[is_supported]),  # of the last pass: finer relief is as deep
        ),
    )


def _share(flags: Flags, nodes: Nodes) -> float:
    """Return the share of flagged nodes (K,) among those that are at no sharp edge, which silhouettes see."""
    return float((flags & ~nodes.at_edge).sum() / max((~nodes.at_edge).sum(), 1))


def _rms_mm(lengths_mm: Values) -> float:
    return float(np.sqrt(np.mean(lengths_mm**2))) if len(lengths_mm) else 0.0
