"""Whether the refined body holds when images and calibration are worse: distances and volumes beside the estimate's.

Run: .venv/bin/python tests/accuracy/refinement.py [--bodies dented,irregular,angular] [--size-mm 24] [--seed 11]
     [--lens f2]

Stones are rendered once; then the calibration is put off, images are blurred, lose contrast and get dust, and cameras
are left out. Silhouettes are those of the images as they were: only the refinement is under test. Distances are means
in both directions; `ms` and `texture ms`, which the greys of vertices take, are times of this process, best of three.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import trimesh
from rich.table import Table
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.printed import show

from pipeline.carving import CarvingParameters, carve
from pipeline.estimate import estimate_body
from pipeline.evaluation.scene import EvaluationScene, build_scene
from pipeline.evaluation.surface_distances import Surface, surface_distances
from pipeline.frames import CameraId, Frame
from pipeline.measuring.solid import solid_of
from pipeline.meshing import ParticleMesh, mesh_hull
from pipeline.refinement import refine_body, vertex_greys
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import SilhouetteSet, segment_all
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset
from pipeline.synthesis.irregular_bodies import irregular_body
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import STONE_FORMS, stone
from pipeline.views.prepared import prepare_views

OFF_PX = (0.3, 1.0)
BLURS_PX = (2.0, 4.0)
CONTRASTS = (0.5, 0.25, 0.1)
MISSING: Mapping[str, tuple[str, ...]] = {
    "one camera missing": ("c05",),
    "four cameras missing": ("c02", "c05", "c08", "c15"),
}
N_SPECKS = 25
N_TIMES = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """What the refinement is given."""

    name: str
    frames: Mapping[CameraId, Frame]
    rig: RigCalibration
    missing: tuple[str, ...] = ()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bodies", default="dented,irregular,angular")
    parser.add_argument("--size-mm", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--lens", choices=[preset.value for preset in LensPreset], default="f2")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    threadpool_limits(1)  # threads that wait count, too
    scene = build_scene(arguments.seed, exposure=LENS_PRESETS[LensPreset(arguments.lens)])
    tables = (table(name, arguments.size_mm, scene) for name in arguments.bodies.split(","))
    show(*tables, as_json=arguments.json, width=120)
    return 0


def table(name: str, size_mm: float, scene: EvaluationScene) -> Table:
    """Return one line for each case of a stone."""
    rng = stream(scene.seed, 0)
    body = stone(name, size_mm, rng) if name in STONE_FORMS else irregular_body(name, size_mm, rng)
    placed = tumble(body, scene.true_rig, rng)
    bundle = scene.photograph(placed, rng, name)
    silhouettes = segment_all(bundle.frames, scene.background, BackgroundSegmenter())
    truth, volume_mm3 = Surface(placed.world_mesh), float(placed.world_mesh.volume)
    found = Table(
        *("body", "case", "estimate mm", "estimate volume %", "photo mm", "photo largest", "photo volume %"),
        *("supported", "ms", "texture ms"),
        title=f"{name} {size_mm:g} mm",
    )
    for case in cases(bundle.frames, scene.true_rig, silhouettes):
        kept = {camera: seen for camera, seen in silhouettes.items() if camera not in case.missing}
        views = prepare_views(kept, scene.true_rig).with_outline()
        hull = mesh_hull(carve(views, CarvingParameters()))
        if hull is None:
            raise SystemExit(f"{name}: no body")
        estimate = estimate_body(hull, views)
        given = (estimate, hull, case.frames, prepare_views(kept, case.rig).with_outline())
        times_ms, texture_ms = [], []
        for _ in range(N_TIMES + 1):
            began_s = time.process_time()
            refined = refine_body(*given)
            refined_s = time.process_time()
            vertex_greys(refined.mesh, refined.views)
            times_ms.append(1000 * (refined_s - began_s))
            texture_ms.append(1000 * (time.process_time() - refined_s))
        columns = []
        for mesh in (estimate.mesh, refined.mesh):
            own = surface_distances(_trimesh(mesh), truth, np.random.default_rng(0))
            percent = 100 * (solid_of(mesh.vertices_mm, mesh.faces).volume_mm3 / volume_mm3 - 1)
            columns.append(((own.mean_mm + own.back_mean_mm) / 2, max(own.max_mm, own.back_max_mm), percent))
        (before_mm, _, before), (after_mm, largest_mm, after) = columns
        found.add_row(
            name,
            case.name,
            f"{before_mm:.4f}",
            f"{before:+.2f}",
            f"{after_mm:.4f}",
            f"{largest_mm:.2f}",
            f"{after:+.2f}",
            f"{100 * refined.support.share:.0f} %" if refined.fallback is None else refined.fallback,
            f"{min(times_ms[1:]):.0f}",
            f"{min(texture_ms[1:]):.1f}",
        )
    return found


def cases(
    frames: Mapping[CameraId, Frame], rig: RigCalibration, silhouettes: SilhouetteSet
) -> Iterator[Case]:
    rng = np.random.default_rng(0)
    yield Case(name="as it is", frames=frames, rig=rig)
    for off_px in OFF_PX:
        yield Case(name=f"calibration off by {off_px:g} px", frames=frames, rig=_put_off(rig, off_px, rng))
    for sigma_px in BLURS_PX:
        blurred = {
            camera: replace(frame, image=cv2.GaussianBlur(frame.image, (0, 0), sigma_px))
            for camera, frame in frames.items()
        }
        yield Case(name=f"blur, sigma {sigma_px:g} px", frames=blurred, rig=rig)
    for gain in CONTRASTS:
        pale = {
            camera: _pale(frame, silhouettes[camera].label_image() > 0, gain)
            for camera, frame in frames.items()
        }
        yield Case(name=f"contrast x {gain:g}", frames=pale, rig=rig)
    for name, missing in MISSING.items():
        yield Case(name=name, frames=frames, rig=rig, missing=missing)
    yield Case(name="dust", frames={camera: _dusty(frame, rng) for camera, frame in frames.items()}, rig=rig)


def _put_off(rig: RigCalibration, off_px: float, rng: np.random.Generator) -> RigCalibration:
    """Return the rig with each principal point off, as by cameras that were knocked."""
    cameras = []
    for camera in rig.cameras:
        K = camera.K.copy()
        K[:2, 2] += off_px * rng.normal(size=2)
        cameras.append(replace(camera, K=K))
    return replace(rig, cameras=tuple(cameras))


def _pale(frame: Frame, is_body: np.ndarray, gain: float) -> Frame:
    """Return the image with the body's grey levels nearer to their mean."""
    image = frame.image.astype(float)
    mean = image[is_body].mean()
    image[is_body] = mean + gain * (image[is_body] - mean)
    return replace(frame, image=np.clip(np.rint(image), 0, 255).astype(np.uint8))


def _dusty(frame: Frame, rng: np.random.Generator) -> Frame:
    """Return the image with specks on the lens, a little out of focus."""
    image = frame.image.copy()
    height, width = image.shape
    for _ in range(N_SPECKS):
        at = (int(rng.integers(width)), int(rng.integers(height)))
        cv2.circle(image, at, int(rng.integers(4, 14)), int(rng.integers(60, 160)), -1)
    return replace(frame, image=np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0)))


def _trimesh(mesh: ParticleMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


if __name__ == "__main__":
    sys.exit(main())
