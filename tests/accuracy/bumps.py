"""How soon a camera that was hit is named, and what is named without cause.

    .venv/bin/python tests/accuracy/bumps.py [--seed 5] [--noise-px 0.08] [--turns 0.1 0.5] [--lens f2] [--recalibrate]

A rig with the deviations of a workshop sees random convex stones; then one camera, chosen at random, is turned
about a random axis through its optical centre, and the stones fall on. Outlines are exact but for their noise:
0.08 px a point gives healthy cameras scores of 0.09 px, a little more than those of rendered images (0.07).
A turn about the line of sight moves the image of a stone in the middle only a little: the column "image px" says how
far the stones moved in the image.

With --lens, the outlines are those found in rendered images of 40 stones, in one rig; a camera's turn about its own
centre moves each point of an outline to where its ray then lands.

With --recalibrate, the camera is then put back from 20 stones, and the hull of a 15 mm sphere is measured before
the bump, after it with all views, and with the new calibration.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
import trimesh
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.outlines import Array, bumped, stone_outlines, watch_record
from support.printed import show
from support.silhouettes import sphere_silhouettes

from pipeline.calibration.self_calibration import MIN_STONES, recalibrate
from pipeline.carving import CarvingParameters, carve
from pipeline.evaluation.scene import BODY, build_scene
from pipeline.frames import CameraId
from pipeline.meshing import mesh_hull
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation import segment_all
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.background import WallKind
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import STONE_FORMS, random_size_mm, stone
from pipeline.views.epipolar_tangency import outlines_of
from pipeline.views.prepared import prepare_views
from service.health.rig_watch import DISPLACED_IN_A_ROW, RigWatch

TURNS_DEG = (0.1, 0.5)
SOON = DISPLACED_IN_A_ROW
N_BUMPS = 10
N_HEALTHY = 100
N_AFTER = 20
N_RECALIBRATIONS = 3
N_RENDERED = 40
N_BEFORE = 20
"""Healthy stones before the bump: the watch is not fresh when it happens."""

RECALIBRATION = (
    "turn °", "camera", "solved", "found °", "before px", "after px", "sphere mm", "hit", "put back",
)  # fmt: skip
"""Columns of the second table: a camera was turned, and put back from stones."""


@dataclass(frozen=True)
class Bump:
    camera: CameraId
    turn_deg: float
    image_px: float  # how far the bump moved the middle of the rig in the image
    named_after: int | None  # stones; `None` if not within `N_AFTER`
    dropped: int  # of the stones since, measured without it
    others_named: int
    said: str


Seen = Callable[[RigCalibration], Mapping[CameraId, Array]]
"""Outlines of the next stone as it is seen by the true rig, or by that with a camera turned."""
Observed = Callable[[np.random.Generator], tuple[RigCalibration, Seen]]
"""A true rig and what is seen by it."""


def exact_outlines(noise_px: float) -> Observed:
    """Random rigs and convex stones, outlines exact but for noise."""

    def observed(rng: np.random.Generator) -> tuple[RigCalibration, Seen]:
        rig = as_built(nominal_rig(), int(rng.integers(1 << 31)))
        return rig, lambda seen_by: stone_outlines(seen_by, rng, noise_px)

    return observed


def in_images(lens: LensPreset, wall: WallKind, seed: int) -> Observed:
    """The rig of this seed and its stones, as they are found in rendered images, over and over."""
    scene = build_scene(seed, exposure=LENS_PRESETS[lens], wall_kind=wall)
    found = []
    for number in range(N_RENDERED):
        rng = stream(seed, BODY, number)
        body = stone(tuple(STONE_FORMS)[number % len(STONE_FORMS)], random_size_mm(rng), rng)
        bundle = scene.photograph(tumble(body, scene.true_rig, rng), rng, f"stone-{number}")
        found.append(outlines_of(segment_all(bundle.frames, scene.background, BackgroundSegmenter())))
    stones = cycle(found)

    def seen(rig: RigCalibration) -> dict[CameraId, Array]:
        moved = zip(rig.cameras, scene.true_rig.cameras, strict=True)
        cameras = {now.id: (now, true) for now, true in moved}
        return {
            camera: _seen_after(outline_uv, *cameras[camera]) for camera, outline_uv in next(stones).items()
        }

    return lambda _: (scene.true_rig, seen)


def _seen_after(outline_uv: Array, now: CameraCalibration, true: CameraCalibration) -> Array:
    """Where a camera turned about its centre sees an outline."""
    if now is true:
        return outline_uv
    return now.project(true.center_mm + 300.0 * true.rays(outline_uv))[0]


def bump(rig: RigCalibration, turn_deg: float, rng: np.random.Generator, seen: Seen) -> Bump:
    """One camera is turned after some healthy stones.

    The calibration stays and the camera moves: the stones are seen by the turned rig, judged by the old one.
    """
    camera = rig.camera_ids[int(rng.integers(len(rig.cameras)))]
    axis = rng.normal(size=3)
    hit = bumped(rig, camera, turn_deg * axis / np.linalg.norm(axis))
    watch = RigWatch(rig)
    for _ in range(N_BEFORE):
        watch.feed(watch_record(seen(rig), rig))
    named_after, dropped, others, said = None, 0, set(), ""
    for number in range(1, N_AFTER + 1):
        record = watch_record(seen(hit), rig)
        watch.feed(record)
        dropped += camera in record.dropped_views
        for finding in watch.findings():
            if finding.cameras == (camera,):
                named_after, said = named_after or number, finding.detail
            else:
                others.add(finding.cameras)
    (before_uv,), (after_uv,) = (
        view.subset([camera]).cameras[0].project([[0.0, 0.0, 0.0]])[0] for view in (rig, hit)
    )
    image_px = float(np.linalg.norm(after_uv - before_uv))
    return Bump(camera, turn_deg, image_px, named_after, dropped, len(others), said.partition(": recal")[0])


def false_alarms(rig: RigCalibration, seen: Seen, n_stones: int = N_HEALTHY) -> tuple[int, Array]:
    """Findings in the course of healthy stones, and the scores of all cameras in all of them."""
    watch, alarms, scores_px = RigWatch(rig), 0, list[float]()
    for _ in range(n_stones):
        record = watch_record(seen(rig), rig)
        watch.feed(record)
        alarms += len(watch.findings())
        scores_px += record.tangency_px.values()
    return alarms, np.array(scores_px)


def recalibration(
    rig: RigCalibration, turn_deg: float, rng: np.random.Generator, seen: Seen
) -> tuple[str, ...]:
    """A row of the second table: a camera is hit, and put back from stones."""
    camera = rig.camera_ids[int(rng.integers(len(rig.cameras)))]
    axis = rng.normal(size=3)
    hit = bumped(rig, camera, turn_deg * axis / np.linalg.norm(axis))
    stones = [seen(hit) for _ in range(MIN_STONES)]
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


def bumps(
    seed: int, observed: Observed, turns_deg: Sequence[float] = TURNS_DEG, n_bumps: int = N_BUMPS
) -> list[Bump]:
    """`n_bumps` of each size."""
    found = []
    for turn_deg in turns_deg:
        for number in range(n_bumps):
            rng = np.random.default_rng([seed, round(1000 * turn_deg), number])
            rig, seen = observed(rng)
            found.append(bump(rig, turn_deg, rng, seen))
    return found


def summary_of(turned: Sequence[Bump]) -> Table:
    """Return one line for each angle by which cameras were turned."""
    table = Table(
        *("all turns of", "turned", "image px", "named by the second stone", "later", "by stone, at most"),
        *("not named", "left out of stones", "others named"),
    )
    for turn_deg in dict.fromkeys(each.turn_deg for each in turned):
        own = [each for each in turned if each.turn_deg == turn_deg]
        named_after = [each.named_after for each in own if each.named_after is not None]
        table.add_row(
            f"{turn_deg:g}",
            str(len(own)),
            f"{min(each.image_px for each in own):.1f} to {max(each.image_px for each in own):.1f}",
            str(sum(after <= SOON for after in named_after)),
            str(sum(after > SOON for after in named_after)),
            str(max(named_after, default="-")),
            str(len(own) - len(named_after)),
            f"{sum(each.dropped for each in own)} of {N_AFTER * len(own)}",
            str(sum(each.others_named for each in own)),
        )
    return table


def spheres_of(recalibrated: Table) -> Table:
    """Return by how much a sphere measured wrong, at most, with cameras that were hit and with them put back."""
    columns = {column.header: list(column.cells) for column in recalibrated.columns}
    table = Table("recalibrated after turns of", "sphere off, mm, at most", "put back")
    for turn in dict.fromkeys(columns["turn °"]):
        own = [
            tuple(float(str(columns[name][row])) for name in ("sphere mm", "hit", "put back"))
            for row, each in enumerate(columns["turn °"])
            if each == turn
        ]
        table.add_row(
            turn,
            f"{max(abs(hit - true) for true, hit, _ in own):.4f}",
            f"{max(abs(back - true) for true, _, back in own):.4f}",
        )
    return table


def main() -> None:
    parser = ArgumentParser(description="How soon a camera that was hit is named.")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--noise-px", type=float, default=0.08)
    parser.add_argument("--turns", type=float, nargs="+", default=TURNS_DEG, help="degrees")
    parser.add_argument("--lens", type=LensPreset, choices=tuple(LensPreset), help="find outlines in images")
    parser.add_argument("--wall", type=WallKind, choices=tuple(WallKind), default=WallKind.PANELS)
    parser.add_argument("--recalibrate", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    observed = (
        in_images(arguments.lens, arguments.wall, arguments.seed)
        if arguments.lens
        else exact_outlines(arguments.noise_px)
    )
    table = Table("turn °", "camera", "image px", "named after", "dropped", "others named", "what it says")
    turned = bumps(arguments.seed, observed, arguments.turns)
    for found in turned:
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
    tables = [table, summary_of(turned)]
    if arguments.recalibrate:
        again = Table(*RECALIBRATION)
        tables.append(again)
        for number in range(len(arguments.turns) * N_RECALIBRATIONS):
            rng = np.random.default_rng([arguments.seed, 1, number])
            rig, seen = observed(rng)
            again.add_row(*recalibration(rig, arguments.turns[number % len(arguments.turns)], rng, seen))
        tables.append(spheres_of(again))
    rig, seen = observed(np.random.default_rng([arguments.seed, 0]))
    n_healthy = N_RENDERED if arguments.lens else N_HEALTHY
    alarms, scores_px = false_alarms(rig, seen, n_healthy)
    healthy = Table("healthy stones", "false alarms", "highest score px", "median px")
    healthy.add_row(str(n_healthy), str(alarms), f"{scores_px.max():.2f}", f"{np.median(scores_px):.3f}")
    show(*tables, healthy, as_json=arguments.json, width=160)


if __name__ == "__main__":
    main()
