"""Measure accuracy and speed of each segmenter, on views that are hard to segment and on clean ones.

Run: .venv/bin/python tests/benchmarks/segmentation.py [--views 10] [--seed 40000] [--cases clean,dust]
     [--segmenters background,auto] [--size-mm 15] [--pictures DIR] [--json]
U2-Net-p takes part once `stonefall models fetch` has been run. Milliseconds are processor time on one thread.
"""

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.progress import track
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.mask_segmenters import difference, plain_difference
from support.printed import show
from support.segmentation_tables import (
    AUTO,
    BACKGROUND,
    MASK,
    NETWORK,
    PLAIN,
    U2NETP,
    Outcome,
    accuracy_table,
    remark,
    time_table,
)

from pipeline.errors import ModelError
from pipeline.evaluation.hard_cases import HardCase, HardView, hard_view
from pipeline.evaluation.silhouette_errors import (
    TrueEdge,
    silhouette_errors,
    true_edge,
    true_status,
)
from pipeline.evaluation.silhouette_picture import silhouette_picture
from pipeline.segmentation import Segmenter, ViewStatus
from pipeline.segmentation.mask_segmenter import MaskSegmenter
from pipeline.segmentation.network import Network
from pipeline.segmentation.network_segmenter import NetworkSegmenter
from pipeline.segmentation.segmenter_choice import ChoosingSegmenter
from pipeline.segmentation.subtraction import BackgroundSegmenter, SegmentationParameters
from service.processing.models.networks import load_model

SEED = 40_000
"""Default seed of the first view; seeds of training and tuning are far from it."""
NO_BACKGROUND = "no background"
"""Name of the clean case without exposures of the empty rig."""
CASES = (*(case.value for case in HardCase), NO_BACKGROUND)
SEGMENTERS = (PLAIN, BACKGROUND, NETWORK, AUTO, U2NETP, MASK)
WIDTH = 205
"""Width of a table that is written into a file, in characters."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--views", type=int, default=10, help="number of views of each case")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the first view of each case")
    parser.add_argument("--cases", type=chosen(CASES), default=CASES, help=", ".join(CASES))
    parser.add_argument(
        "--segmenters", type=chosen(SEGMENTERS), default=SEGMENTERS, help=", ".join(SEGMENTERS)
    )
    parser.add_argument("--size-mm", type=float, help="size of all stones; random without")
    parser.add_argument("--pictures", type=Path, help="folder for one picture of each case")
    parser.add_argument("--models", type=Path, help="folder of fetched models")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    threadpool_limits(1)
    segmenters, missing = all_segmenters(arguments.models)
    segmenters = {name: each for name, each in segmenters.items() if name in arguments.segmenters}
    outcomes, plain, bare = run(segmenters, arguments)
    first, last = arguments.seed, arguments.seed + arguments.views - 1
    show(
        accuracy_table(outcomes, f"{arguments.views} views a case, seeds {first} to {last}"),
        time_table(outcomes, plain, bare),
        as_json=arguments.json,
        width=WIDTH,
    )
    for name in arguments.segmenters:
        if name in missing:
            Console(stderr=True).print(f"{name}: {missing[name]}")
    return 0


def chosen(names: Sequence[str]) -> Callable[[str], list[str]]:
    def parse(text: str) -> list[str]:
        parts = text.split(",")
        if wrong := [part for part in parts if part not in names]:
            raise argparse.ArgumentTypeError(f"{wrong[0]!r} is none of {', '.join(names)}")
        return parts

    return parse


def all_segmenters(models_dir: Path | None) -> tuple[dict[str, Segmenter], dict[str, str]]:
    """Return the segmenters whose model is there, and why the others are missing."""
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
) -> tuple[list[Outcome], list[float], list[float]]:
    """Run each segmenter on each view, with `plain_ms` and `bare_ms` beside it; return outcomes and both times."""
    outcomes: list[Outcome] = []
    plain: list[float] = []
    bare: list[float] = []
    network = load_model()
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
            bare.append(bare_ms(network))
        if arguments.pictures and number == 0:
            arguments.pictures.mkdir(parents=True, exist_ok=True)
            found = {each.segmenter: (each.silhouette, remark(each)) for each in of_view}
            picture = silhouette_picture(
                view.frame.image, truth, view.coverage > 0.5, found, f"{case}, seed {arguments.seed}"
            )
            cv2.imwrite(str(arguments.pictures / f"{case.replace(' ', '-')}.png"), picture[..., ::-1])
    return outcomes, plain or [float("nan")], bare or [float("nan")]


def tried(
    name: str, segmenter: Segmenter, view: HardView, truth: TrueEdge, case: str, number: int
) -> Outcome:
    if name not in (U2NETP, MASK):  # these are too slow for a second run, and for it to matter
        # from the second stone on, what follows from a background is kept
        _ = segmenter(view.frame, view.background).fine_px
    start = time.process_time()
    silhouette = segmenter(view.frame, view.background)
    found = time.process_time()
    _ = silhouette.fine_px
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
    """Time the least that finds a body in a whole image: difference, threshold, connected components."""
    empty = view.background[view.frame.camera].mean.astype(np.uint8)
    start = time.process_time()
    cv2.connectedComponentsWithStats(difference(view.frame.image, empty))
    return 1000 * (time.process_time() - start)


def bare_ms(network: Network) -> float:
    """Time our own network alone on its largest square."""
    view = np.ones((2, network.size_px, network.size_px), np.float32)
    start = time.process_time()
    network.probability(view)
    return 1000 * (time.process_time() - start)


if __name__ == "__main__":
    sys.exit(main())
