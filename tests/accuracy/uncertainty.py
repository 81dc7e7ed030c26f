"""Whether the uncertainty of a stone holds: known bodies under ever worse conditions, beside what results say of them.

Bodies of all forms are rendered in random poses by rigs with deviations, and measured with the true rig. Errors are the
mean distance of the measured to the true surface, and the volume's. Perfect images of the same body in the same pose
give what silhouettes can do: beyond that no good stone may be further off than 0.1 mm or 2 % of its volume. And in less
than one of a hundred the whole error may exceed three of the sigmas that the result states.

Run: .venv/bin/python tests/accuracy/uncertainty.py [--conditions sharp,blur3,f2] [--stones 14] [--jobs 2]
     .venv/bin/python tests/accuracy/uncertainty.py --out uncertainty.json
     .venv/bin/python tests/benchmarks/plots.py uncertainty.json     # the distribution of error / sigma
"""

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from math import hypot
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.printed import show

from pipeline.evaluation.scene import EvaluationScene, build_scene
from pipeline.evaluation.surface_distances import Surface, surface_distances
from pipeline.frames import CameraId, FrameBundle
from pipeline.particle import PipelineParameters, measure_bundle
from pipeline.segmentation import Segmenter
from pipeline.segmentation.subtraction import SegmentationParameters
from pipeline.synthesis.bodies import Body, cube, cylinder, sphere
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.disturbance import Disturbance, dust
from pipeline.synthesis.exposure import LENS_PRESETS, ExposureParameters, LensPreset
from pipeline.synthesis.irregular_bodies import IRREGULAR_FORMS, irregular_body
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import STONE_FORMS, stone
from pipeline.views.quality import Quality
from service.processing.models.networks import read_model
from service.processing.segmenters import SegmenterPlan, build_segmenter

Random = np.random.Generator
STANDARDS: Mapping[str, Callable[[], Body]] = {"sphere": sphere, "cylinder": cylinder, "cube": cube}
FORMS = (*STANDARDS, *STONE_FORMS, *IRREGULAR_FORMS)
SIZES_MM = (10.0, 36.0)
BODIES_PER_RIG = len(FORMS)
POSE, EXPOSURE = 1, 2
"""Purposes of random streams: a body and its pose are the same under all conditions."""
MAX_BEYOND_MM, MAX_BEYOND_PERCENT = 0.1, 2.0
"""What perfect images give may be exceeded by so much by a good stone."""
MAX_SIGMAS, MAX_SHARE = 3.0, 0.01
IDEAL = "ideal"


def as_it_is(body: Body, rng: Random) -> Body:
    return body


def bright(body: Body, rng: Random) -> Body:
    return replace(body, grey=rng.uniform(110, 200), contrast=rng.uniform(0.05, 0.35))


def wet(body: Body, rng: Random) -> Body:
    return replace(body, grey=rng.uniform(40, 110), gloss=rng.uniform(0.5, 1.0))


def black(body: Body, rng: Random) -> Body:
    return replace(body, grey=10.0, contrast=0.0, gloss=0.0)


DESIGN = ExposureParameters()


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """How stones are photographed."""

    exposure: ExposureParameters = DESIGN
    dust: tuple[float, float] | None = None  # strengths that lenses got since the empty rig was exposed
    look: Callable[[Body, Random], Body] = as_it_is


F2 = LENS_PRESETS[LensPreset.F2]
CONDITIONS: Mapping[str, Condition] = {
    IDEAL: Condition(
        exposure=ExposureParameters(
            blur_px=0.3, read_noise=0, shot_noise=0, exposure_us=0, flash_sd=0, camera_flash_sd=0
        ),
        look=black,
    ),
    "sharp": Condition(),
    **{f"blur{px:g}": Condition(exposure=ExposureParameters(blur_px=px)) for px in (1.5, 2, 3, 4, 6)},
    **{f"motion{px}": Condition(exposure=ExposureParameters(exposure_us=20.0 * px)) for px in (5, 9)},
    **{f"noise{grey}": Condition(exposure=ExposureParameters(read_noise=grey)) for grey in (3, 7, 10)},
    **{preset.value: Condition(exposure=LENS_PRESETS[preset]) for preset in (LensPreset.F8, LensPreset.F4)},
    "f2": Condition(exposure=F2),
    "f2-noise5-dust": Condition(exposure=replace(F2, read_noise=5.0), dust=(0.15, 0.5)),
    "bright": Condition(look=bright),
    "wet": Condition(look=wet),
    "bright-f2": Condition(exposure=F2, look=bright),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One stone under one condition by one segmenter; what is not measured is None."""

    condition: str
    segmenter: str
    form: str
    number: int
    rejection: str | None
    quality: str | None = None
    causes: tuple[str, ...] = ()
    error_mm: float | None = None  # mean distance of the measured surface to the true one
    volume_error_percent: float | None = None
    surface_sd_mm: float | None = None
    volume_sd_percent: float | None = None
    surface_mm: Mapping[str, float] | None = None  # by cause, one sigma
    volume_percent: Mapping[str, float] | None = None


def body(number: int, seed: int) -> Body:
    """Return body `number`: all forms in turn, of random form and size but for the standards."""
    name, rng = FORMS[number % len(FORMS)], stream(seed, number, 0)
    if name in STANDARDS:
        return STANDARDS[name]()
    size_mm = float(rng.uniform(*SIZES_MM))
    return stone(name, size_mm, rng) if name in STONE_FORMS else irregular_body(name, size_mm, rng)


@cache
def segmenter_of(name: str) -> Segmenter:
    plan = SegmenterPlan(wanted="auto", model=read_model() if name == "network" else None)
    return build_segmenter(plan, SegmentationParameters())


def photographed(
    number: int, scene: EvaluationScene, condition: Condition, seed: int
) -> tuple[FrameBundle, trimesh.Trimesh]:
    """Return an exposure of body `number`, and its true surface."""
    pose, rng = stream(seed, number, POSE), stream(seed, number, EXPOSURE)
    placed = tumble(condition.look(body(number, seed), pose), scene.true_rig, pose)
    disturbances: dict[CameraId, Disturbance] = {}
    if condition.dust is not None:
        for camera in scene.true_rig.cameras:
            disturbances[camera.id] = dust(rng.uniform(*condition.dust), rng, camera.image_size_px)
    bundle = render_bundle([placed], scene.simulated, rng, sequence=1, disturbances=disturbances)
    return bundle, placed.world_mesh


def measured(
    number: int, scene: EvaluationScene, name: str, segmenters: Sequence[str], seed: int
) -> Iterator[Row]:
    """Measure body `number` under one condition by each segmenter."""
    bundle, truth = photographed(number, scene, CONDITIONS[name], seed)
    surface = Surface(truth)
    for segmenter in segmenters:
        result = measure_bundle(
            bundle, scene.true_rig, scene.background, segmenter_of(segmenter), PipelineParameters()
        )
        row = Row(
            condition=name,
            segmenter=segmenter,
            form=FORMS[number % len(FORMS)],
            number=number,
            rejection=None if result.rejection is None else str(result.rejection),
        )
        if result.mesh is None or result.measurement is None:
            yield row
            continue
        mesh = trimesh.Trimesh(result.mesh.vertices_mm, result.mesh.faces, process=False)
        found = result.measurement.uncertainty
        yield replace(
            row,
            quality=str(result.quality),
            causes=tuple(map(str, result.quality_causes)),
            error_mm=surface_distances(mesh, surface, stream(seed, number)).mean_mm,
            volume_error_percent=100 * (result.measurement.volume_mm3 / truth.volume - 1),
            surface_sd_mm=found.surface_sd_mm,
            volume_sd_percent=found.volume_sd_percent,
            surface_mm={str(cause): sd for cause, sd in found.surface_mm.items()},
            volume_percent={str(cause): sd for cause, sd in found.volume_percent.items()},
        )


def measure_job(job: tuple[str, range, Sequence[str], int]) -> list[Row]:
    """Measure the bodies of one rig under one condition."""
    name, numbers, segmenters, seed = job
    cv2.setNumThreads(1)
    with threadpool_limits(1):
        scene = build_scene(seed + numbers.start, exposure=CONDITIONS[name].exposure)
        return [row for number in numbers for row in measured(number, scene, name, segmenters, seed)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A measured stone beside its sigmas, and beside what perfect images give."""

    row: Row
    sigmas: float  # error over sigma: of the surface, or of the volume where that is more
    is_too_far: bool  # further off than a good stone may be

    @property
    def is_beyond(self) -> bool:
        return self.sigmas > MAX_SIGMAS


def judged(rows: Sequence[Row]) -> list[Judged]:
    """Judge all measured rows but the ideal ones."""
    ideal = {row.number: row for row in rows if row.condition == IDEAL}
    found = []
    for row in rows:
        best = ideal[row.number]
        if row.condition == IDEAL or row.error_mm is None:
            continue
        surface = row.error_mm / row.surface_sd_mm
        volume = abs(row.volume_error_percent) / row.volume_sd_percent
        beyond_mm = row.error_mm - (best.error_mm or 0.0)
        beyond_percent = abs(row.volume_error_percent) - abs(best.volume_error_percent or 0.0)
        is_too_far = beyond_mm > MAX_BEYOND_MM or beyond_percent > MAX_BEYOND_PERCENT
        found.append(Judged(row=row, sigmas=max(surface, volume), is_too_far=is_too_far))
    return found


def table(rows: Sequence[Row]) -> Table:
    """Return one line for each condition and segmenter, and one for all."""
    columns = (
        "condition", "segmenter", "stones", "mm, median", "worst", "volume %, rms", "sd mm", "sd %",
        "error/sigma, median", "99 %", "beyond 3", "good", "reduced", "degraded", "rejected", "good, too far",
        "why not good",
    )  # fmt: skip
    found = Table(*columns)
    keys = list(dict.fromkeys((row.condition, row.segmenter) for row in rows if row.condition != IDEAL))
    for key in [*keys, None]:
        own = [
            row for row in rows if row.condition != IDEAL and key in (None, (row.condition, row.segmenter))
        ]
        stones = [each for each in judged(rows) if key in (None, (each.row.condition, each.row.segmenter))]
        if not stones:
            found.add_row(*(key or ("all", "both")), str(len(own)), *[""] * 10, str(len(own)))
            continue
        errors_mm = [each.row.error_mm for each in stones]
        sigmas = [each.sigmas for each in stones]
        words = Counter(each.row.quality for each in stones)
        why = Counter(each.row.causes[0] for each in stones if each.row.causes)
        found.add_row(
            *(key or ("all", "both")),
            str(len(own)),
            f"{np.median(errors_mm):.3f}",
            f"{max(errors_mm):.3f}",
            f"{hypot(*(each.row.volume_error_percent for each in stones)) / len(stones) ** 0.5:.2f}",
            f"{np.median([each.row.surface_sd_mm for each in stones]):.3f}",
            f"{np.median([each.row.volume_sd_percent for each in stones]):.2f}",
            f"{np.median(sigmas):.2f}",
            f"{np.quantile(sigmas, 0.99):.2f}",
            str(sum(each.is_beyond for each in stones)),
            *(str(words[quality]) for quality in Quality),
            str(len(own) - len(stones)),
            str(sum(each.is_too_far and each.row.quality == Quality.GOOD for each in stones)),
            " ".join(f"{cause} {n}" for cause, n in why.most_common(3)),
        )
    return found


def forms_table(rows: Sequence[Row]) -> Table:
    """Return mean distances, mean volume errors and quality words of the standards, and of all stones together."""
    found = Table(
        "condition", "segmenter", *(f"{form}: mm, volume %, words" for form in (*STANDARDS, "stones"))
    )
    for condition, segmenter in dict.fromkeys((row.condition, row.segmenter) for row in rows):
        cells = []
        for form in (*STANDARDS, "stones"):
            own = [
                row
                for row in rows
                if (row.condition, row.segmenter) == (condition, segmenter)
                and form == (row.form if row.form in STANDARDS else "stones")
            ]
            measured = [row for row in own if row.error_mm is not None]
            words = Counter(row.quality or "rejected" for row in own)
            cell = [" ".join(f"{word} {n}" for word, n in words.items())]
            if measured:
                error_mm = np.mean([row.error_mm for row in measured])
                percent = np.mean([row.volume_error_percent for row in measured])
                cell = [f"{error_mm:.3f}", f"{percent:+.2f}", *cell]
            cells.append(", ".join(cell))
        found.add_row(condition, segmenter, *cells)
    return found


def broken_promises(rows: Sequence[Row]) -> list[str]:
    """Return what does not hold, stone by stone for those called good though they are too far from the truth."""
    stones = judged(rows)
    n_beyond = sum(each.is_beyond for each in stones)
    broken = []
    if n_beyond >= MAX_SHARE * len(stones):
        broken.append(f"{n_beyond} of {len(stones)} errors exceed {MAX_SIGMAS:g} sigma")
    for each in stones:
        row = each.row
        if each.is_too_far and row.quality == Quality.GOOD:
            broken.append(
                f"{row.condition}, {row.segmenter}, {row.form} {row.number} is good:"
                f" {row.error_mm:.3f} mm, {row.volume_error_percent:+.2f} %"
            )
    return broken


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    conditions = [name for name in CONDITIONS if name != IDEAL]
    parser.add_argument("--conditions", default=",".join(conditions))
    parser.add_argument("--segmenters", default="network,background")
    parser.add_argument("--stones", type=int, default=len(FORMS), help="bodies under each condition")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--out", type=Path, help="JSON of all rows, which tests/benchmarks/plots.py draws")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    names, segmenters = arguments.conditions.split(","), arguments.segmenters.split(",")
    if unknown := set(names) - set(CONDITIONS):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(conditions)}")
    ranges = [
        range(first, min(first + BODIES_PER_RIG, arguments.stones))
        for first in range(0, arguments.stones, BODIES_PER_RIG)
    ]
    jobs = [(IDEAL, numbers, ["background"], arguments.seed) for numbers in ranges]
    jobs += [(name, numbers, segmenters, arguments.seed) for name in names for numbers in ranges]
    rows: list[Row] = []
    with ProcessPoolExecutor(arguments.jobs, get_context("forkserver")) as pool:
        for done in pool.map(measure_job, jobs):
            rows += done
            if arguments.out is not None:  # after each rig, as all of them take long
                arguments.out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    show(forms_table(rows), table(rows), as_json=arguments.json, width=220)
    broken = broken_promises(rows)
    Console(stderr=True).print("\n".join(broken) or "All promises hold.")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
