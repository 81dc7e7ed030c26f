"""How exact and how fast each segmenter is, on views that are hard to segment and on clean ones.

Run: .venv/bin/python tests/benchmarks/segmentation.py [--views 10] [--seed 40000] [--cases clean,dust]
     [--segmenters background,auto] [--size-mm 15] [--pictures DIR] [--json]
U2-Net-p takes part once `stonefall models fetch` has been run. Milliseconds are those of the CPU, on one thread.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.mask_segmenters import MaskSegmenter, difference, plain_difference

from pipeline.errors import ModelError
from pipeline.segmentation import Segmenter, Silhouette, ViewStatus
from pipeline.segmentation.choice import ChoosingSegmenter
from pipeline.segmentation.neural import NetworkSegmenter
from pipeline.segmentation.subtraction import BackgroundSegmenter, SegmentationParameters
from pipeline.synthesis.hard_cases import HardCase, HardView, hard_view
from pipeline.synthesis.silhouette_errors import (
    SilhouetteErrors,
    TrueEdge,
    silhouette_errors,
    true_edge,
    true_status,
)
from pipeline.synthesis.silhouette_picture import silhouette_picture
from service.models import load_model

SEED = 40_000
"""Far from the seeds of training and tuning."""
NO_BACKGROUND = "no background"
"""The clean case, before the rig was ever seen empty."""
CASES = (*(case.value for case in HardCase), NO_BACKGROUND)
SEGMENTERS = (PLAIN, BACKGROUND, NETWORK, AUTO, U2NETP, MASK) = (
    "plain", "background", "network", "auto", "u2netp", "u2netp mask",
)  # fmt: skip
"""What differs, to whole pixels; the service's three; U2-Net-p with the edge by grey levels; as the paper uses it."""
WIDTH = 205
"""Of a table that is written into a file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one segmenter made of one view."""

    case: str
    number: int
    segmenter: str
    silhouette: Silhouette
    wanted: ViewStatus
    ms: float
    distance_ms: float
    errors: SilhouetteErrors | None  # where there is a silhouette, and should be

    @property
    def is_failure(self) -> bool:
        return self.silhouette.status is not self.wanted


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--views", type=int, default=10, help="of each case")
    parser.add_argument("--seed", type=int, default=SEED, help="of the first view of each case")
    parser.add_argument("--cases", type=chosen(CASES), default=CASES, help=", ".join(CASES))
    parser.add_argument(
        "--segmenters", type=chosen(SEGMENTERS), default=SEGMENTERS, help=", ".join(SEGMENTERS)
    )
    parser.add_argument("--size-mm", type=float, help="of all stones; random without")
    parser.add_argument("--pictures", type=Path, help="folder for one picture of each case")
    parser.add_argument("--models", type=Path, help="folder of fetched models")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    threadpool_limits(1)
    segmenters, missing = all_segmenters(arguments.models)
    segmenters = {name: each for name, each in segmenters.items() if name in arguments.segmenters}
    outcomes, plain = run(segmenters, arguments)
    if arguments.json:
        sys.stdout.write(json.dumps([as_json(outcome) for outcome in outcomes], indent=2) + "\n")
        return 0
    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    first, last = arguments.seed, arguments.seed + arguments.views - 1
    console.print(accuracy_table(outcomes, f"{arguments.views} views a case, seeds {first} to {last}"))
    console.print(time_table(outcomes, plain))
    for name in arguments.segmenters:
        if name in missing:
            console.print(f"{name}: {missing[name]}")
    return 0


def chosen(names: Sequence[str]) -> Callable[[str], list[str]]:
    def parse(text: str) -> list[str]:
        parts = text.split(",")
        if wrong := [part for part in parts if part not in names]:
            raise argparse.ArgumentTypeError(f"{wrong[0]!r} is none of {', '.join(names)}")
        return parts

    return parse


def all_segmenters(models_dir: Path | None) -> tuple[dict[str, Segmenter], dict[str, str]]:
    """Those whose model there is, and why the others are missing."""
    parameters = SegmentationParameters()
    background = BackgroundSegmenter(parameters)
    segmenters: dict[str, Segmenter] = {PLAIN: plain_difference, BACKGROUND: background}
    missing = {}
    network = None
    try:
        network = NetworkSegmenter(load_model("", models_dir), parameters)
        segmenters[NETWORK] = network
    except ModelError as err:
        missing[NETWORK] = str(err)
    segmenters[AUTO] = ChoosingSegmenter(classical=background, network=network)
    try:
        published = load_model(U2NETP, models_dir)
        segmenters[U2NETP] = NetworkSegmenter(published, parameters)
        segmenters[MASK] = MaskSegmenter(published)
    except ModelError as err:
        missing[U2NETP] = missing[MASK] = str(err)
    return segmenters, missing


def run(
    segmenters: Mapping[str, Segmenter], arguments: argparse.Namespace
) -> tuple[list[Outcome], list[float]]:
    """Each segmenter on each view, one after the other, and `plain_ms` of each."""
    outcomes: list[Outcome] = []
    plain: list[float] = []
    jobs = [(case, number) for case in arguments.cases for number in range(arguments.views)]
    for case, number in track(jobs, console=Console(stderr=True), transient=True):
        view = hard_view(
            HardCase.CLEAN if case == NO_BACKGROUND else HardCase(case),
            arguments.seed + number,
            with_background=case != NO_BACKGROUND,
            size_mm=arguments.size_mm,
        )
        truth = true_edge(view.coverage, view.contrast)
        of_view = [
            tried(name, segmenter, view, truth, case, number) for name, segmenter in segmenters.items()
        ]
        outcomes += of_view
        if view.background:
            plain.append(plain_ms(view))
        if arguments.pictures and number == 0:
            arguments.pictures.mkdir(parents=True, exist_ok=True)
            found = {each.segmenter: (each.silhouette, remark(each)) for each in of_view}
            picture = silhouette_picture(
                view.frame.image, truth, view.coverage > 0.5, found, f"{case}, seed {arguments.seed}"
            )
            cv2.imwrite(str(arguments.pictures / f"{case.replace(' ', '-')}.png"), picture[..., ::-1])
    return outcomes, plain or [float("nan")]


def tried(
    name: str, segmenter: Segmenter, view: HardView, truth: TrueEdge, case: str, number: int
) -> Outcome:
    if name not in (U2NETP, MASK):  # too slow for a second time, and too slow to notice
        # what is kept of a background is there from the second stone on
        _ = segmenter(view.frame, view.background).distance_px
    start = time.process_time()
    silhouette = segmenter(view.frame, view.background)
    found = time.process_time()
    _ = silhouette.distance_px
    end = time.process_time()
    wanted = true_status(view.coverage, SegmentationParameters())
    is_judged = silhouette.is_usable and wanted is ViewStatus.OK
    return Outcome(
        case=case,
        number=number,
        segmenter=name,
        silhouette=silhouette,
        wanted=wanted,
        ms=1000 * (found - start),
        distance_ms=1000 * (end - found),
        errors=silhouette_errors(silhouette, truth) if is_judged else None,
    )


def plain_ms(view: HardView) -> float:
    """What the least takes that finds a body in a whole image: difference, threshold, components."""
    empty = view.background[view.frame.camera].mean.astype(np.uint8)
    start = time.process_time()
    cv2.connectedComponentsWithStats(difference(view.frame.image, empty))
    return 1000 * (time.process_time() - start)


def remark(outcome: Outcome) -> str:
    """One line below a picture."""
    errors = outcome.errors
    if errors is None:
        return str(outcome.silhouette.status) + (
            f", should be {outcome.wanted}" if outcome.is_failure else ""
        )
    return (
        f"IoU {errors.iou:.4f}, bias {errors.bias_px:+.3f} px, RMS {errors.rms_px:.3f} px,"
        f" unknown {errors.unknown_share:.1%}, {outcome.silhouette.found_by}"
    )


def accuracy_table(outcomes: Sequence[Outcome], title: str) -> Table:
    table = Table(
        title=f"{title}; IoU: median; bias and RMS in px: of the outlines where the true edge is visible; seen: of"
        " that edge; unknown: of the body's pixels; wrong: pixels beyond the rim"
    )
    for heading in (
        "case", "segmenter", "found by", "IoU", "worst", "bias", "worst", "RMS", "seen %", "unknown %", "wrong %",
        "status right", "not right", "ms CPU", "10-90 %",
    ):  # fmt: skip
        table.add_column(heading, no_wrap=True)
    last_case = ""
    for group in grouped(outcomes, lambda each: (each.case, each.segmenter)):
        first = group[0]
        if first.case != last_case:
            table.add_section()
        found_by = Counter(each.silhouette.found_by for each in group if each.silhouette.is_usable)
        wrong = Counter(f"{each.silhouette.status} for {each.wanted}" for each in group if each.is_failure)
        ms = [each.ms for each in group]
        table.add_row(
            first.case if first.case != last_case else "",
            first.segmenter,
            ", ".join(f"{name} {count}" for name, count in found_by.items()),
            *error_cells([each.errors for each in group if each.errors is not None]),
            f"{sum(not each.is_failure for each in group)} of {len(group)}",
            ", ".join(f"{count} {name}" for name, count in wrong.items()),
            f"{np.median(ms):.1f}",
            f"{np.quantile(ms, 0.1):.1f}-{np.quantile(ms, 0.9):.1f}",
        )
        last_case = first.case
    return table


def error_cells(judged: Sequence[SilhouetteErrors]) -> list[str]:
    """From IoU to wrong pixels."""
    offsets_px = np.concatenate([np.zeros(0), *(errors.offsets_px for errors in judged)])
    if len(offsets_px) == 0:
        return ["-"] * 8
    ious = [errors.iou for errors in judged]
    return [
        f"{np.median(ious):.4f}",
        f"{min(ious):.4f}",
        f"{offsets_px.mean():+.3f}",
        f"{max((errors.bias_px for errors in judged), key=abs):+.3f}",
        f"{np.sqrt(np.mean(offsets_px**2)):.3f}",
        percent([errors.seen_share for errors in judged]),
        percent([errors.unknown_share for errors in judged]),
        percent([errors.wrong_share for errors in judged]),
    ]


def percent(shares: Sequence[float]) -> str:
    return f"{100 * np.nanmean(shares):.2f}"


def time_table(outcomes: Sequence[Outcome], plain: Sequence[float]) -> Table:
    """Of the clean views, and of all; the ratios are those of the medians over clean views."""
    clean = [each for each in outcomes if each.case == HardCase.CLEAN] or outcomes
    medians_ms = {
        group[0].segmenter: float(np.median([each.ms for each in group]))
        for group in grouped(clean, lambda each: (each.segmenter,))
    }
    table = Table(
        "segmenter", "ms CPU a clean image", "16 of them", "images/s a core", "plain takes x", f"{U2NETP} takes x",
        "distance field, ms", "ms of all images", "10-90 %",
        title=f"{len(plain)} images, one thread; plain: absdiff, threshold, connectedComponentsWithStats of an image,"
        f" {np.median(plain):.2f} ms ({np.quantile(plain, 0.1):.2f}-{np.quantile(plain, 0.9):.2f})",
    )  # fmt: skip
    for group in grouped(outcomes, lambda each: (each.segmenter,)):
        ms = [each.ms for each in group]
        distance_ms = [each.distance_ms for each in group if each.silhouette.is_usable]
        median_ms = medians_ms[group[0].segmenter]
        table.add_row(
            group[0].segmenter,
            f"{median_ms:.2f}",
            f"{16 * median_ms:.0f}",
            f"{1000 / median_ms:.0f}",
            f"{np.median(plain) / median_ms:.2f}",
            f"{medians_ms[MASK] / median_ms:.1f}" if MASK in medians_ms else "-",
            f"{np.median(distance_ms):.2f}" if distance_ms else "-",
            f"{np.median(ms):.2f}",
            f"{np.quantile(ms, 0.1):.2f}-{np.quantile(ms, 0.9):.2f}",
        )
    return table


def grouped(outcomes: Sequence[Outcome], key: Callable[[Outcome], tuple[str, ...]]) -> list[list[Outcome]]:
    groups: dict[tuple[str, ...], list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(key(outcome), []).append(outcome)
    return list(groups.values())


def as_json(outcome: Outcome) -> dict[str, Any]:
    errors = outcome.errors
    found = outcome.silhouette
    row: dict[str, Any] = {
        "case": outcome.case,
        "number": outcome.number,
        "segmenter": outcome.segmenter,
        "status": found.status,
        "wanted_status": outcome.wanted,
        "found_by": found.found_by,
        "fallback": found.fallback,
        "ms": outcome.ms,
        "distance_ms": outcome.distance_ms,
    }
    if errors is not None:
        names = ("iou", "bias_px", "rms_px", "seen_share", "unknown_share", "wrong_share")
        row |= {name: getattr(errors, name) for name in names}
    return row


if __name__ == "__main__":
    sys.exit(main())
