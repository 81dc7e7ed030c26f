"""Whether the network runs as it should, told from what workers say of each bundle."""

from support.outcomes import result

from service.base.messages import Code, message
from service.base.status import trouble_check
from service.health.segmentation_watch import WINDOW, SegmentationWatch
from service.processing.measure_job import MeasuredBundle
from service.processing.segmenters import SegmenterPlan

PLAN = SegmenterPlan(wanted="auto", model=b"model")
BY_NETWORK = result(segmenters={"c01": "background", "c02": "network"})
BY_BACKGROUND = result(segmenters={"c01": "background"})
RUNS, NOT_ASKED = MeasuredBundle(BY_NETWORK), MeasuredBundle(BY_BACKGROUND)
ON_CPU = MeasuredBundle(BY_NETWORK, "GPU failed, the CPU computes")
CANNOT_RUN = MeasuredBundle(BY_BACKGROUND, "model x: cannot be run: out of memory")


def warning_of(watch: SegmentationWatch) -> str | None:
    return watch.checks(has_background=True)["segmentation"].detail


def test_a_network_that_runs_or_is_not_asked_is_no_trouble() -> None:
    watch = SegmentationWatch(PLAN)
    for measured in (RUNS, NOT_ASKED):
        watch.feed(measured)
    assert warning_of(watch) is None


def test_a_provider_that_fails_in_a_run_is_told_until_the_network_runs_again() -> None:
    watch = SegmentationWatch(PLAN)
    watch.feed(ON_CPU)
    assert warning_of(watch) == ON_CPU.network_trouble
    for _ in range(2 * WINDOW):
        watch.feed(NOT_ASKED)
    for _ in range(WINDOW - 1):
        watch.feed(RUNS)
    assert warning_of(watch) == ON_CPU.network_trouble
    watch.feed(RUNS)
    assert warning_of(watch) is None


def test_a_network_that_cannot_be_run_is_told_though_the_background_took_its_place() -> None:
    watch = SegmentationWatch(PLAN)
    watch.feed(CANNOT_RUN)
    assert warning_of(watch) == CANNOT_RUN.network_trouble


def test_what_was_known_from_the_start_stays() -> None:
    watch = SegmentationWatch(SegmenterPlan(wanted="auto", trouble="roi.onnx: is damaged"))
    watch.feed(RUNS)
    check = watch.checks(has_background=True)["segmentation"]
    assert check == trouble_check(message(Code.SEGMENTATION_CLASSICAL, reported="roi.onnx: is damaged"))
