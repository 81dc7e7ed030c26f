"""How soon a camera that was hit is named, and what is named without cause.

    .venv/bin/python tests/accuracy/bumps.py [--seed 5] [--noise-px 0.08] [--recalibrate]

A rig with the deviations of a workshop sees random convex stones; then one camera, chosen at random, is turned
about a random axis through its optical centre, and the stones fall on. Outlines are exact but for their noise:
0.08 px a point gives healthy cameras scores of 0.09 px, a little more than those of rendered images (0.07).
A turn about the line of sight moves the image of a stone in the middle only a little: the column "image px" says how
far the stones moved in the image.

With --recalibrate, the camera is then put back from 20 stones, and the hull of a 15 mm sphere is measured before
the bump, after it with all views, and with the new calibration.
"""

import sys
from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.outlines import bumped, stone_outlines, watch_record
from support.silhouettes import sphere_silhouettes

from pipeline.calibration.self_calibration import MIN_STONES, recalibrate
from pipeline.carving import CarvingParameters, carve
from pipeline.frames import CameraId
from pipeline.meshing import mesh_hull
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.views.prepared import prepare_views
from service.health.rig_watch import RigWatch

TURNS_DEG = (0.1, 0.5)
N_BUMPS = 10
N_HEALTHY = 100
N_AFTER = 20
N_RECALIBRATIONS = 3
N_BEFORE = 20
"""Healthy stones before the bump: the watch is not fresh when it happens."""


@dataclass(frozen=True)
class Bump:
    camera: CameraId
    turn_deg: float
    image_px: float  # how far the bump moved the middle of the rig in the image
    named_after: int | None  # stones; `None` if not within `N_AFTER`
    dropped: int  # of the stones since, measured without it
    others_named: int
    said: str


def bump(rig: RigCalibration, turn_deg: float, rng: np.random.Generator, noise_px: float) -> Bump:
    """One camera is turned after some healthy stones.

    The calibration stays and the camera moves: the stones are seen by the turned rig, judged by the old one.
    """
    camera = rig.camera_ids[int(rng.integers(len(rig.cameras)))]
    axis = rng.normal(size=3)
    hit = bumped(rig, camera, turn_deg * axis / np.linalg.norm(axis))
    watch = RigWatch(rig)
    for _ in range(N_BEFORE):
        watch.feed(watch_record(stone_outlines(rig, rng, noise_px), rig))
    named_after, dropped, others, said = None, 0, set(), ""
    for stone in range(1, N_AFTER + 1):
        record = watch_record(stone_outlines(hit, rng, noise_px), rig)
        watch.feed(record)
        dropped += camera in record["dropped_views"]
        for suspicion in watch.suspicions():
            if suspicion.camera == camera:
                named_after, said = named_after or stone, suspicion.detail
            else:
                others.add(suspicion.camera)
    (before_uv,), (after_uv,) = (
        view.subset([camera]).cameras[0].project([[0.0, 0.0, 0.0]])[0] for view in (rig, hit)
    )
    image_px = float(np.linalg.norm(after_uv - before_uv))
    return Bump(camera, turn_deg, image_px, named_after, dropped, len(others), said.partition(": recal")[0])


def false_alarms(rig: RigCalibration, rng: np.random.Generator, noise_px: float) -> tuple[int, float]:
    """Suspicions in the course of `N_HEALTHY` stones, and the highest score of any camera in any of them."""
    watch, alarms, highest_px = RigWatch(rig), 0, 0.0
    for _ in range(N_HEALTHY):
        record = watch_record(stone_outlines(rig, rng, noise_px), rig)
        watch.feed(record)
        alarms += len(watch.suspicions())
        highest_px = max(highest_px, *record["tangency_px"].values())
    return alarms, highest_px


def recalibration(turn_deg: float, rng: np.random.Generator, noise_px: float) -> tuple[str, ...]:
    """A row of the second table: a camera is hit, and put back from stones."""
    rig = as_built(nominal_rig(), int(rng.integers(1 << 31)))
    camera = rig.camera_ids[int(rng.integers(len(rig.cameras)))]
    axis = rng.normal(size=3)
    hit = bumped(rig, camera, turn_deg * axis / np.linalg.norm(axis))
    stones = [stone_outlines(hit, rng, noise_px) for _ in range(MIN_STONES)]
    found = recalibrate(stones, rig, created_at="2026-01-01T00:00:00Z", name="from stones")
    diameters_mm = (
        sphere_hull_diameter_mm(rig, rig),
        sphere_hull_diameter_mm(hit, rig),
        sphere_hull_diameter_mm(hit, found.rig),
    )
    return (
        f"{turn_deg:g}",
        camera,
        ", ".join(found.moved),
        f"{found.moved[camera].rotation_deg:.3f}",
        *(f"{scores_px[camera]:.2f}" for scores_px in (found.scores_before_px, found.scores_after_px)),
        *(f"{diameter_mm:.4f}" for diameter_mm in diameters_mm),
    )


def sphere_hull_diameter_mm(seen_with: RigCalibration, judged_by: RigCalibration) -> float:
    """Diameter of the sphere of the volume of the hull that all views of a 15 mm sphere make."""
    mesh = mesh_hull(carve(prepare_views(sphere_silhouettes(seen_with), judged_by), CarvingParameters()))
    if mesh is None:
        return 0.0
    volume_mm3 = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).volume
    return float(np.cbrt(6 * volume_mm3 / np.pi))


def bumps(seed: int, noise_px: float, n_bumps: int = N_BUMPS) -> list[Bump]:
    """`n_bumps` of each size, on a rig each."""
    found = []
    for turn_deg in TURNS_DEG:
        for number in range(n_bumps):
            rng = np.random.default_rng([seed, round(1000 * turn_deg), number])
            rig = as_built(nominal_rig(), int(rng.integers(1 << 31)))
            found.append(bump(rig, turn_deg, rng, noise_px))
    return found


def main() -> None:
    parser = ArgumentParser(description="How soon a camera that was hit is named.")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--noise-px", type=float, default=0.08)
    parser.add_argument("--recalibrate", action="store_true")
    arguments = parser.parse_args()
    table = Table("turn °", "camera", "image px", "named after", "dropped", "others named", "what it says")
    for found in bumps(arguments.seed, arguments.noise_px):
        named = "not named" if found.named_after is None else str(found.named_after)
        table.add_row(
            f"{found.turn_deg:g}",
            found.camera,
            f"{found.image_px:.1f}",
            named,
            f"{found.dropped}/{N_AFTER}",
            str(found.others_named),
            found.said,
        )
    console = Console(width=160)
    console.print(table)
    if arguments.recalibrate:
        table = Table(
            "turn °", "camera", "solved", "found °", "before px", "after px", "sphere mm", "hit", "put back"
        )
        for number in range(2 * N_RECALIBRATIONS):
            rng = np.random.default_rng([arguments.seed, 1, number])
            table.add_row(*recalibration(TURNS_DEG[number % 2], rng, arguments.noise_px))
        console.print(table)
    rng = np.random.default_rng([arguments.seed, 0])
    alarms, highest_px = false_alarms(as_built(nominal_rig(), arguments.seed), rng, arguments.noise_px)
    console.print(f"{N_HEALTHY} healthy stones: {alarms} false alarms, highest score {highest_px:.2f} px")


if __name__ == "__main__":
    main()
