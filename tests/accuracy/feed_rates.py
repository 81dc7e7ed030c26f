"""The share of stones that are measured, by the rate of the feed, with stones that fall at random.

    .venv/bin/python tests/accuracy/feed_rates.py [--seconds 30] [--seed 1] [--rendered 24] [--json]

Stones of all forms and of 5 to 40 mm (`random_size_mm`) pass the light gate at random times (Poisson), in one
orientation, and are photographed in another, 1.5 mm (sd) beside the axis; the delay is that of the mean stone. They
pass it from rest, or at 1.4 m/s, after 100 mm of free fall. A stone that comes while another still closes the beam is
not announced; one within the dead time of 12 ms, that of a frame on the wire, is not photographed. A camera sees the
convex hull of the stone's mesh, projected, without an image. `cut`: more than the picture holds, also alone. `several`:
rejected. `merged`: stones in which a view in use shows another one that covers it, by whether the gate announced that.

With `--rendered`, so many stones at 10 a second, each with another in the picture, are photographed through F2.0 and
measured, with the other one and without it.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.parts import parts_in, views_of
from support.printed import show

from pipeline.arrays import Matrix33, PointsMM, Vector
from pipeline.evaluation.scene import EvaluationScene, build_scene
from pipeline.evaluation.surface_distances import Surface, surface_distances
from pipeline.fall import Fall, pulse_width_ns, speed_mm_s
from pipeline.frames import FrameBundle, NearStone, Trigger
from pipeline.particle import PipelineParameters, measure_bundle
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.subtraction import BackgroundSegmenter, SegmentationParameters
from pipeline.synthesis.bodies import Body
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset
from pipeline.synthesis.placement import OFFSET_SD_MM
from pipeline.synthesis.renderer import PlacedBody
from pipeline.synthesis.stones import STONE_FORMS, random_size_mm, stone
from pipeline.views.near_stones import predicted_places, tell_apart
from pipeline.views.quality import ViewsParameters

RATES_HZ = (2, 4, 6, 8, 10, 13, 20)
STARTS_MM = (0.0, 100.0)
"""Heights above the beam from which stones start."""
DEAD_TIME_S = 0.012
IN_VIEW_S = 0.05
N_BODIES = 50
RENDERED_RATE_HZ = 10
RIG = as_built(nominal_rig(), 1)
MAX_UNUSABLE = ViewsParameters().max_unusable


@dataclass(frozen=True, eq=False)
class Falling:
    """A stone that passes the gate."""

    at_s: float
    body: Body
    R_gate: Matrix33
    R_exposed: Matrix33
    beside_mm: Vector  # x, y

    @property
    def gate_mm(self) -> tuple[float, float]:
        """Lowest and highest point at the gate, from the centre."""
        heights_mm = self.body.mesh.vertices @ self.R_gate[2]
        return float(heights_mm.min()), float(heights_mm.max())

    def placed(self, lowest_mm: float) -> PlacedBody:
        """The stone at the exposure, whose lowest point, as it was at the gate, is at this height."""
        offset_mm = np.array([*self.beside_mm, lowest_mm - self.gate_mm[0]])
        return PlacedBody(body=self.body, R=self.R_exposed, offset_mm=offset_mm)


@dataclass(frozen=True, eq=False)
class Exposed:
    """A stone that is due, as its trigger says, and all stones that are at or near the centre then."""

    trigger: Trigger
    due: PlacedBody
    others: Sequence[PlacedBody]

    @property
    def is_announced(self) -> bool:
        """True when the gate has announced all of the others."""
        return len(self.trigger.near_stones) == len(self.others)


def falling(rate_hz: float, seconds: float, seed: int) -> list[Falling]:
    """Stones in the order in which they reach the gate."""
    rng = stream(seed, round(1000 * rate_hz))
    bodies = _bodies(seed)
    at_s, found = 0.0, []
    while (at_s := at_s + float(rng.exponential(1 / rate_hz))) < seconds:
        body = bodies[int(rng.integers(N_BODIES))]
        mesh = trimesh.Trimesh(body.mesh.vertices * random_size_mm(rng) / 20, body.mesh.faces, process=False)
        gate, exposed = (turn.as_matrix() for turn in Rotation.random(2, rng=rng))
        beside_mm = OFFSET_SD_MM * rng.normal(size=2)
        found.append(Falling(at_s, replace(body, mesh=mesh), gate, exposed, beside_mm))
    return found


@cache
def _bodies(seed: int) -> list[Body]:
    """Bodies of 20 mm, of all forms in turn."""
    forms = list(STONE_FORMS)
    return [stone(forms[n % len(forms)], 20.0, stream(seed, 1, n)) for n in range(N_BODIES)]


def gated(stones: Sequence[Falling], fall: Fall) -> tuple[list[tuple[Falling, int]], int]:
    """Return the stones that the gate announces, with their pulses' widths in ns, and how many it does not."""
    announced: list[tuple[Falling, int]] = []
    closed_until_s, n_hidden = 0.0, 0
    for each in stones:
        lowest_mm, highest_mm = each.gate_mm
        width_ns = pulse_width_ns(highest_mm - lowest_mm, fall.speed_at_gate_mm_s)
        if each.at_s < closed_until_s:  # the beam is closed for as long as either of them is in it
            first, _ = announced[-1]
            closed_until_s = max(closed_until_s, each.at_s + width_ns / 1e9)
            announced[-1] = (first, round((closed_until_s - first.at_s) * 1e9))
            n_hidden += 1
            continue
        closed_until_s = each.at_s + width_ns / 1e9
        announced.append((each, width_ns))
    return announced, n_hidden


def exposures(stones: Sequence[Falling], fall: Fall) -> tuple[list[Exposed], int, int]:
    """Return the exposures of stones, and how many had none: not announced, or in the dead time."""
    announced, n_hidden = gated(stones, fall)
    mean_mm = float(np.mean([np.ptp(each.gate_mm) for each in stones]))
    found: list[Exposed] = []
    last_s, n_dead = -1.0, 0
    for due, width_ns in announced:
        if due.at_s - last_s < DEAD_TIME_S:
            n_dead += 1
            continue
        last_s = due.at_s

        def later_ns(other: Falling, due: Falling = due) -> int:
            return round((other.at_s - due.at_s) * 1e9)

        near = [(other, width) for other, width in announced if other is not due and _is_near(other, due)]
        trigger = Trigger(
            sequence=len(found) + 1,
            received_ns=0,
            device_ns=0,
            utc="2026-01-01T00:00:00Z",
            pulse_width_ns=width_ns,
            near_stones=tuple(NearStone(later_ns(other), width) for other, width in near),
        )
        others = [other for other in stones if other is not due and _is_near(other, due)]
        lowest_mm = -mean_mm / 2  # the delay is that of the mean stone
        found.append(
            Exposed(
                trigger=trigger,
                due=due.placed(lowest_mm),
                others=[other.placed(lowest_mm + fall.height_above_mm(later_ns(other))) for other in others],
            )
        )
    return found, n_hidden, n_dead


def _is_near(other: Falling, due: Falling) -> bool:
    return abs(other.at_s - due.at_s) <= IN_VIEW_S


def outcome(exposed: Exposed, fall: Fall) -> tuple[str, str, int]:
    """Return the fate of a stone, that with no other announced, and the number of used views that show it merged."""
    rig, share = RIG, SegmentationParameters().second_body_share
    due, others = _points(exposed.due), [_points(other) for other in exposed.others]
    alone = views_of(rig, [due])
    if sum(bool(view.parts.is_cut.any()) for view in alone) > MAX_UNUSABLE:
        return "cut", "cut", 0
    if not others:
        return "good", "good", 0
    views = [parts_in(camera, [due, *others]) for camera in rig.cameras]
    told = tell_apart(views, predicted_places(exposed.trigger, fall))
    n_unused, n_unused_before, n_merged = 0, 0, 0
    for view, single in zip(views, alone, strict=True):
        numbers = view.parts.numbers
        left = np.where(told.others.get(view.camera.id, np.zeros(numbers.shape, np.bool_)), 0, numbers)
        n_unused_before += _shows_several(numbers, share)
        is_unused = view.camera.id in told.covered or _shows_several(left, share)
        n_unused += is_unused
        n_merged += not is_unused and not np.array_equal(left > 0, single.parts.numbers > 0)

    def word(n: int) -> str:
        return "several" if n > MAX_UNUSABLE else ("reduced" if n else "good")

    return word(n_unused), word(n_unused_before), n_merged


def _shows_several(numbers: np.ndarray, share: float) -> bool:
    """True when the second part is more than dust beside the first."""
    *_, second, first = sorted([0, 0, *np.bincount(numbers.ravel())[1:]])
    return bool(second > share * first)


def _points(placed: PlacedBody) -> PointsMM:
    return np.asarray(placed.body.mesh.vertices[::3] @ placed.R.T + placed.offset_mm)


def shares(start_mm: float, seconds: float, seed: int) -> Table:
    """The table of all rates."""
    fall = Fall(speed_at_gate_mm_s=speed_mm_s(start_mm))
    headings = (
        "start mm",
        "rate",
        "stones",
        "beam closed %",
        "dead time %",
        "cut %",
        "several %",
        "reduced %",
        "good %",
    )
    table = Table(
        *headings,
        "measured a second",
        "unannounced: measured %",
        "merged: announced, not",
        title="Random feed",
    )
    for rate_hz in track(RATES_HZ, "falling", console=Console(stderr=True), transient=True):
        stones = falling(rate_hz, seconds, seed)
        found, n_hidden, n_dead = exposures(stones, fall)
        outcomes = [outcome(each, fall) for each in found]
        now, before, merged = zip(*outcomes, strict=True)

        def percent(n: int, n_stones: int = len(stones)) -> str:
            return f"{100 * n / n_stones:.1f}"

        def n_merged(
            is_announced: bool, found: Sequence[Exposed] = found, merged: Sequence[int] = merged
        ) -> int:
            pairs = zip(found, merged, strict=True)
            return sum(n > 0 and each.is_announced == is_announced for each, n in pairs)

        n_measured = now.count("good") + now.count("reduced")
        table.add_row(
            f"{start_mm:g}",
            str(rate_hz),
            str(len(stones)),
            percent(n_hidden),
            percent(n_dead),
            *(percent(now.count(word)) for word in ("cut", "several", "reduced", "good")),
            f"{n_measured / seconds:.1f}",
            percent(before.count("good") + before.count("reduced")),
            ", ".join(str(n_merged(is_announced)) for is_announced in (True, False)),
        )
    return table


def errors(n_stones: int, seed: int) -> Table:
    """The table of rendered stones with another one in the picture."""
    scene = build_scene(seed, exposure=LENS_PRESETS[LensPreset.F2])
    fall = Fall(speed_at_gate_mm_s=speed_mm_s(STARTS_MM[1]))
    fallen, *_ = exposures(falling(RENDERED_RATE_HZ, 60.0, seed), fall)
    crowded = (
        each for each in fallen if len(each.others) == 1 and outcome(each, fall)[:2] == ("good", "several")
    )
    chosen = list(islice(crowded, n_stones))
    rows = []
    for number, each in enumerate(track(chosen, "measuring", console=Console(stderr=True), transient=True)):
        truth = Surface(each.due.world_mesh)
        for bodies in ([each.due], [each.due, *each.others]):
            bundle = render_bundle(bodies, scene.simulated, stream(seed, 2, number), sequence=number + 1)
            rows.append(_errors(replace(bundle, trigger=each.trigger), truth, scene, fall, seed))
    table = Table("", "measured", "good", "mean distance mm", "volume %", title="The same stones")
    for name, found in (("alone", rows[::2]), ("with another", rows[1::2])):
        measured = [row for row in found if row is not None]
        distances_mm, volumes, goods = (np.array(column) for column in zip(*measured, strict=True))
        table.add_row(
            name,
            f"{len(measured)} of {len(found)}",
            str(int(goods.sum())),
            f"{distances_mm.mean():.4f}",
            f"{volumes.mean():+.2f}, {np.sqrt((volumes**2).mean()):.2f}",
        )
    both = [(a, b) for a, b in zip(rows[::2], rows[1::2], strict=True) if a and b]
    change = np.array([b[1] - a[1] for a, b in both])
    table.add_row(
        "change",
        str(len(both)),
        "",
        f"{np.mean([b[0] - a[0] for a, b in both]):+.4f}",
        f"{change.mean():+.3f}, {np.sqrt((change**2).mean()):.3f}",
    )
    return table


def _errors(
    bundle: FrameBundle, truth: Surface, scene: EvaluationScene, fall: Fall, seed: int
) -> tuple[float, float, bool] | None:
    parameters = PipelineParameters(fall=fall)
    result = measure_bundle(bundle, scene.true_rig, scene.background, BackgroundSegmenter(), parameters)
    if result.mesh is None or result.measurement is None:
        return None
    mesh = trimesh.Trimesh(result.mesh.vertices_mm, result.mesh.faces, process=False)
    mean_mm = surface_distances(mesh, truth, stream(seed, 3)).mean_mm
    return mean_mm, 100 * (result.measurement.volume_mm3 / truth.mesh.volume - 1), result.quality == "good"


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rendered", type=int, default=24)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    tables = [shares(start_mm, options.seconds, options.seed) for start_mm in STARTS_MM]
    if options.rendered:
        tables.append(errors(options.rendered, options.seed))
    show(*tables, as_json=options.json)


if __name__ == "__main__":
    main()
