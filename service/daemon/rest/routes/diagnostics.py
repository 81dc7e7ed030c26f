"""One archive for support."""

import asyncio
from dataclasses import asdict, replace
from typing import Any

from fastapi import APIRouter, Response

from service.base.status import AcquisitionStatus, ConfigurationState, Health
from service.calibration.calibrations import Calibrations
from service.daemon.diagnostics.archive import Inputs, build_archive
from service.daemon.overview.result_delays import ResultDelays
from service.daemon.rest.routes.metrics import metrics_of
from service.web.auth import CONFIGURABLE
from service.web.context import ApiContext, Context

router = APIRouter(prefix="/diagnostics", tags=["configuration"])

KEEP_S = 5.0
"""For so long everybody gets the same archive, so that requests cannot keep a process busy."""


@router.get(
    "",
    response_class=Response,
    dependencies=CONFIGURABLE,
    responses={200: {"content": {"application/gzip": {}}}},
)
async def diagnostics(context: Context) -> Response:
    """Download diagnostics for support: configuration, versions, health, alarms, accounting, host, log, as .tar.gz.

    Keys, tokens and secrets are replaced by `redacted`; it has no images, meshes or results. It is made at the lowest
    priority, in 30 s at most, and names in `missing.txt` what could not be had. It names devices and addresses of the
    plant: scope `configure`.
    """
    content = await context.shared.get("diagnostics", lambda: _archive(context), keep_s=KEEP_S)
    name = 'attachment; filename="stonefall-diagnostics.tar.gz"'
    return Response(content, media_type="application/gzip", headers={"Content-Disposition": name})


async def _archive(context: ApiContext) -> bytes:
    control = context.control
    health = control.part(Health)
    live: dict[str, Any] = {
        "health.json": {
            "ne107": health.ne107,
            "ready": health.ready,
            "reasons": health.reasons,
            "checks": {name: check.model_dump(mode="json") for name, check in health.checks.items()},
        },
        "acquisition.json": control.part(AcquisitionStatus).model_dump(mode="json"),
        "cameras.json": [camera.model_dump(mode="json") for camera in control.cameras()],
        "configuration-state.json": control.part(ConfigurationState).model_dump(mode="json"),
        "calibration.json": asdict(control.part(Calibrations).facts()),
        "latest-delays-s.json": list(control.part(ResultDelays).latest_s),
        "metrics.txt": (await metrics_of(context)).decode(),
    }
    inputs = await asyncio.to_thread(context.part, Inputs)
    return await context.reading.run(build_archive, replace(inputs, live=live))
