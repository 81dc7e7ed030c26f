"""Metrics for Prometheus."""

import asyncio

from fastapi import APIRouter, Response
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4

from service.calibration.calibrations import Calibrations
from service.daemon.rest.metrics import Snapshot, metrics_text
from service.health.facts import Facts
from service.web.auth import READABLE
from service.web.context import ApiContext, Context

router = APIRouter(prefix="/metrics", tags=["health"], dependencies=READABLE)

KEEP_S = 1.0
"""For so long everybody gets the same text."""


@router.get(
    "", response_class=Response, responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}}
)
async def metrics(context: Context) -> Response:
    """Get the metrics in Prometheus' text format: stones, delays, queue, cameras, health, calibration."""
    return Response(await metrics_of(context), media_type=CONTENT_TYPE_PLAIN_0_0_4)


async def metrics_of(context: ApiContext) -> bytes:
    """Return the text."""
    return await context.shared.get("metrics", lambda: _text(context), keep_s=KEEP_S)


async def _text(context: ApiContext) -> bytes:
    control = context.control
    calibrations = control.part(Calibrations)
    snapshot = Snapshot(
        facts=control.part(Facts),
        outcomes=await context.counted.now(context.store),
        delays=control.delays,
        verified=calibrations.verified,
        last_verification=calibrations.verifications.last(calibrations.rig_file.calibration_id),
    )
    return await asyncio.to_thread(metrics_text, snapshot)
