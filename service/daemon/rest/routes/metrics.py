"""What Prometheus reads: the state of the daemon and the counts of results as text.

Names say the unit; what counts up ends in `_total` and starts again with the daemon, but the stones, which are those of
the store. `deploy/README.md` lists them, `deploy/alerts.yml` has rules for them.
"""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from importlib.metadata import version
from typing import Any

from fastapi import APIRouter, Response
from prometheus_client import Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from pipeline.views.quality import Quality
from service.base.camera_status import CameraOptics, CameraStatus
from service.base.status import AcquisitionState, AcquisitionStatus, CheckStatus, DeviceState, Health, Ne107
from service.calibration.calibrations import Calibrations
from service.calibration.verifications import Verification
from service.daemon.overview.result_delays import ResultDelays
from service.health.facts import Facts
from service.results.fields import LossReason, Outcome, Verified
from service.results.version import ALGORITHM_VERSION
from service.store.accounting import OutcomeCounts
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.version import API_VERSION

router = APIRouter(prefix="/metrics", tags=["health"], dependencies=READABLE)

KEEP_S = 1.0
"""For so long everybody gets the same text."""
NONE_YET = {(Outcome.MEASURED.value, "", quality.value): 0 for quality in Quality} | {
    (Outcome.LOST.value, reason.value, ""): 0 for reason in LossReason
}
"""Counted from the beginning: Prometheus sees no increase in the first of a kind that was not there before."""
SEVERITY = {CheckStatus.PASS: 0, CheckStatus.WARN: 1, CheckStatus.FAIL: 2}

Values = float | Mapping[Any, float | None] | None
"""The value of a metric, or values by that of its label, or by those of several; None is left out."""

CAMERA_COUNTERS: Sequence[tuple[str, str, Callable[[CameraStatus], float]]] = (
    ("frames", "Frames that arrived complete", lambda camera: camera.frames),
    ("frames_lost", "Frames reported lost", lambda camera: camera.lost),
    ("frames_late", "Frames after their bundle was closed", lambda camera: camera.late),
    ("frames_missing", "Bundles without a frame of this camera", lambda camera: camera.missing),
    ("frames_stray", "Frames without a trigger", lambda camera: camera.strays),
    ("packets_missing", "Packets that never came", lambda camera: camera.missing_packets),
    ("packets_resent", "Packets that came when requested again", lambda camera: camera.resent_packets),
    ("recoveries", "How often it came back from a loss", lambda camera: camera.recoveries),
)
CAMERA_GAUGES: Sequence[tuple[str, str, Callable[[CameraStatus], float | None]]] = (
    ("armed", "1: armed, 0: closed or lost", lambda camera: camera.state is DeviceState.ARMED),
    ("temperature_celsius", "Temperature that it reports", lambda camera: camera.temperature_c),
    ("last_frame_age_seconds", "Since its last frame", lambda camera: camera.last_frame_age_s),
    ("tangency_pixels", "Epipolar residual; from 0.3 it has moved", lambda camera: camera.tangency_px),
    ("brightness_ratio", "Light, 1: clean rig", lambda camera: _optics(camera).brightness),
    ("dust_ratio", "Share of the light lost in patches", lambda camera: _optics(camera).dust),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot(Collector):
    """Everything that is reported, at one moment; the metrics are made of it in any thread."""

    facts: Facts
    outcomes: OutcomeCounts
    histograms: Sequence[Histogram]
    verified: Verified
    last_verification: Verification | None

    def collect(self) -> Iterable[Metric]:
        yield from _stones(self.outcomes)
        for histogram in self.histograms:
            yield from histogram.collect()
        yield from _rig(self.facts.acquisition)
        yield from _cameras(self.facts.cameras)
        yield from _health(self.facts.health)
        yield from _machine(self.facts)
        yield from _calibration(self)
        build = {
            "version": version("stonefall"),
            "api_version": API_VERSION,
            "algorithm_version": ALGORITHM_VERSION,
        }
        yield InfoMetricFamily("stonefall_build", "Versions of package, interface and algorithm", build)


@router.get(
    "", response_class=Response, responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}}
)
async def metrics(context: Context) -> Response:
    """Get the metrics in Prometheus' text format: stones, delays, stages, requests, queue, cameras, health."""
    return Response(await metrics_of(context), media_type=CONTENT_TYPE_PLAIN_0_0_4)


async def metrics_of(context: ApiContext) -> bytes:
    """Return the text."""
    return await context.shared.get("metrics", lambda: _text(context), keep_s=KEEP_S)


async def _text(context: ApiContext) -> bytes:
    control = context.control
    calibrations, delays = control.part(Calibrations), control.part(ResultDelays)
    snapshot = Snapshot(
        facts=control.part(Facts),
        outcomes=await context.counted.now(context.store),
        histograms=(delays.histogram, delays.stages, context.times.histogram),
        verified=calibrations.verified,
        last_verification=calibrations.verifications.last(calibrations.rig_file.calibration_id),
    )
    return await asyncio.to_thread(generate_latest, snapshot)


def _stones(outcomes: OutcomeCounts) -> Iterator[Metric]:
    by_outcome = NONE_YET | dict(outcomes.n)
    yield _counter("stones", "Triggers with an outcome", by_outcome, "outcome", "reason", "quality")
    yield _gauge("stones_in_progress", "Triggers without an outcome yet", outcomes.in_progress)


def _rig(rig: AcquisitionStatus) -> Iterator[Metric]:
    yield _one_of("acquisition_state", "1 for the state of the rig", AcquisitionState, rig.state)
    yield _gauge("gate_armed", "1: the light gate is armed", rig.gate is DeviceState.ARMED)
    yield _gauge("cameras", "Cameras of the rig", rig.cameras)
    yield _gauge("cameras_armed", "Cameras that are armed", rig.cameras_armed)
    yield _gauge("last_stone_age_seconds", "Since the last stone", rig.last_stone_age_s)
    since = "since the rig was armed"
    yield _counter("gate_orphans", f"Stones that the gate did not announce; {since}", rig.orphans)
    yield _counter("gate_unseen", f"Stones that only the gate's counter shows; {since}", rig.unseen)
    yield _counter("gate_ignored", f"Bounces, and late announcements; {since}", rig.triggers_ignored)
    yield _counter("frames_refused", "Frames that the daemon was too slow for", rig.events_refused)


def _cameras(cameras: Sequence[CameraStatus]) -> Iterator[Metric]:
    for name, text, n_of in CAMERA_COUNTERS:
        yield _counter(f"camera_{name}", text, {each.id: n_of(each) for each in cameras}, "camera")
    for name, text, value_of in CAMERA_GAUGES:
        yield _gauge(f"camera_{name}", text, {each.id: value_of(each) for each in cameras}, "camera")


def _health(health: Health) -> Iterator[Metric]:
    yield _one_of("ne107_state", "1 for the word of NAMUR NE 107", Ne107, health.ne107)
    yield _gauge("ready", "1: the next stone will be measured", health.ready)
    checks = {name: SEVERITY[check.status] for name, check in health.checks.items()}
    yield _gauge("health_check", "0: passes, 1: warns, 2: fails", checks, "check")


def _machine(facts: Facts) -> Iterator[Metric]:
    yield _gauge("queue_bundles", "Bundles that wait for a worker", facts.waiting)
    yield _gauge("queue_limit_bundles", "Bundles that may wait", facts.max_waiting)
    yield _gauge("workers", "Processes that measure", facts.workers)
    yield _gauge("workers_configured", "Processes that should", facts.slots)
    yield _counter("worker_restarts", "Processes that were replaced", facts.worker_restarts)
    yield _counter("archive_left_out", "Results whose frames were not archived", facts.left_out)
    seen, kept = facts.refinement, facts.retention
    yield _gauge("refinement_supported_ratio", "Surface that pixels tell of", seen.supported_share)
    yield _gauge("refinement_rushed_ratio", "Stones left out in a rush", seen.rushed_share)
    yield _gauge("loop_delay_seconds", "Longest within a minute", facts.loop_ms / 1e3)
    yield _gauge("disk_free_bytes", "Of the disk of the store", facts.free_bytes)
    if (use := kept.use) is not None:
        taken = {"files": use.files_bytes, "results": use.results_bytes, "recordings": kept.recordings_bytes}
        yield _gauge("store_bytes", "What the store takes", taken, "kind")
        yield _gauge("disk_days_left", "Until the disk is full", use.days_left)


def _calibration(snapshot: Snapshot) -> Iterator[Metric]:
    used = snapshot.facts.calibration
    about = {"calibration_id": used.calibration_id, "method": used.method}
    yield InfoMetricFamily("stonefall_calibration", "The calibration in use", about)
    yield _gauge("calibration_activated_timestamp_seconds", "Since when", _unix_s(used.used_since))
    yield _one_of("verification_state", "1 for what the last balls said", Verified, snapshot.verified)
    if (last := snapshot.last_verification) is not None:
        yield _gauge("verification_timestamp_seconds", "When the last one ended", _unix_s(last.changed_at))


def _one_of(name: str, text: str, states: type[StrEnum], present: StrEnum) -> Metric:
    return _gauge(name, text, {state: state is present for state in states}, "state")


def _gauge(name: str, text: str, values: Values, *labels: str) -> Metric:
    return _filled(GaugeMetricFamily(f"stonefall_{name}", text, labels=labels), values)


def _counter(name: str, text: str, values: Values, *labels: str) -> Metric:
    return _filled(CounterMetricFamily(f"stonefall_{name}", text, labels=labels), values)


def _filled(family: GaugeMetricFamily | CounterMetricFamily, values: Values) -> Metric:
    for labels, value in (values if isinstance(values, Mapping) else {(): values}).items():
        if value is not None:
            family.add_metric([labels] if isinstance(labels, str) else labels, value)
    return family


def _optics(camera: CameraStatus) -> CameraOptics:
    return camera.optics or CameraOptics()


def _unix_s(time: str) -> float:
    return datetime.fromisoformat(time).timestamp()
