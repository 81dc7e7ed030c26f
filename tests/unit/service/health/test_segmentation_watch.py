"""Whether the network runs as it should, told from what results say of it."""

import numpy as np
from support.networks import GPU, difference_network, start_on_gpu

from pipeline.segmentation.network import load_network
from service.health.segmentation_watch import WINDOW, SegmentationWatch
from service.processing.segmenters import SegmenterPlan

PLAN = SegmenterPlan(wanted="auto", model=b"model")


def record(flag: str | None = None, found_by: str = "network") -> dict[str, dict[str, str]]:
    flags = {} if flag is None else {"c02": flag}
    return {"segmenters": {"c01": "background", "c02": found_by}, "segmentation_flags": flags}


def failed_in_a_run() -> str:
    network = load_network(difference_network(), (GPU,), start=start_on_gpu(n_runs=0))
    network.probability(np.ones((2, 256, 256), np.float32))
    assert network.fallback is not None
    return network.fallback


def test_doubts_are_no_trouble() -> None:
    watch = SegmentationWatch(PLAN)
    for flag in (None, "no background yet", "30% of the outline unseen; the network sees no more"):
        watch.feed(record(flag))
    watch.feed({"outcome": "lost"})
    assert watch.warning is None


def test_a_provider_that_fails_in_a_run_is_told_until_the_network_runs_again() -> None:
    watch = SegmentationWatch(PLAN)
    fallback = failed_in_a_run()
    watch.feed(record(f"no background yet; {fallback}"))
    assert watch.warning == fallback
    for _ in range(2 * WINDOW):
        watch.feed(record(None, "background"))  # nobody asked it
    for _ in range(WINDOW - 1):
        watch.feed(record("no background yet"))
    assert watch.warning == fallback
    watch.feed(record())
    assert watch.warning is None


def test_a_network_that_cannot_be_run_is_told_though_the_background_took_its_place() -> None:
    watch = SegmentationWatch(PLAN)
    watch.feed(record("40% of the outline unseen; model x: cannot be run: out of memory", "background"))
    assert watch.warning == "model x: cannot be run: out of memory"


def test_what_was_known_from_the_start_stays() -> None:
    watch = SegmentationWatch(SegmenterPlan(wanted="auto", trouble="roi.onnx: is damaged"))
    watch.feed(record(None))
    assert watch.warning == "classical mode: roi.onnx: is damaged"
