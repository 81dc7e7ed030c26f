"""Routes of the acquisition, which arm and disarm the rig, and of its cameras, live."""

import logging
from dataclasses import asdict
from typing import Any

from fastapi import APIRouter
from fastapi.responses import Response
from pydantic import BaseModel, Field

from drivers.errors import CameraUnavailableError
from service.acquisition.acquisition import Acquisition
from service.acquisition.pictures import (
    SHEET_COLUMNS,
    SHEET_TILE_PX,
    contact_sheet_jpg,
    snapshot_png,
    subsampled,
)
from service.base.camera_status import CameraStatus
from service.base.schema import RequestBody
from service.base.status import AcquisitionStatus, AcquisitionTarget
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import ApiContext, Context
from service.web.parameters import ANEW, CameraName
from service.web.problems import Problem, problem_responses

log = logging.getLogger(__name__)

acquiring = APIRouter(prefix="/acquisition", tags=["acquisition"])


class AcquisitionRequest(RequestBody):
    """Request for a state of the rig."""

    state: AcquisitionTarget = Field(description="`armed`: measure every stone; `disarmed`: ignore them")


@acquiring.get("", dependencies=READABLE)
async def acquisition(context: Context) -> AcquisitionStatus:
    """Get the state of the rig: are stones being measured, and if not, why."""
    return context.part(AcquisitionStatus)


@acquiring.put("", dependencies=OPERABLE, responses=problem_responses(409))
async def set_acquisition(context: Context, wanted: AcquisitionRequest, asking: Who) -> AcquisitionStatus:
    """Arm or disarm the rig. Repeating a request changes nothing; 409 when the current state forbids it."""
    rig = context.part(Acquisition)
    before, state = rig.state, rig.request(wanted.state)
    log.info("acquisition requested target=%s state=%s", wanted.state, state)
    await context.store.note_change(
        asking, f"acquisition {wanted.state}", "rig", before={"state": before}, after={"state": state}
    )
    return rig.status()


router = APIRouter(prefix="/cameras", tags=["cameras"], dependencies=READABLE)
acting = APIRouter(prefix="/cameras", tags=["cameras"], dependencies=OPERABLE)
"""What needs another scope than `read`."""

SHEET_KEPT_S = 2.0
"""For so long all who ask get the same contact sheet, however many watch."""


class Cameras(BaseModel):
    """All cameras of the rig."""

    items: list[CameraStatus] = Field(description="By place in the rig")


class IdentifyRequest(RequestBody):
    """Request to show which of the cameras this one is."""

    seconds: float = Field(default=20, ge=1, le=60, strict=True, description="How long its lamp blinks")


class IdentifiedCamera(BaseModel):
    """A camera whose lamp blinks, as it answers itself."""

    id: str = Field(description="Place of the rig that the configuration has it in")
    seconds: float = Field(description="How long its lamp blinks from now on, unless the rig is armed")
    serial: str | None = Field(description="Serial number, as the camera says; null: it does not say")
    model: str | None = Field(description="Its model, as the camera says; null: it does not say")
    address: str | None = Field(description="IPv4 address that it answers at; null: it has none")


@router.get("", response_model=Cameras)
async def cameras(context: Context) -> dict[str, Any]:
    """List the cameras, with their state and counters."""
    return {"items": context.control.cameras()}


@router.get(
    "/contact-sheet.jpg",
    response_class=Response,
    dependencies=[ANEW],
    responses={200: {"content": {"image/jpeg": {}}}},
    description=f"Get the contact sheet: the latest frames of all cameras as one picture, {SHEET_COLUMNS} a row in the"
    f" order of `/cameras`, each {SHEET_TILE_PX} px wide, grey before its first frame. A few seconds old at most.",
)
async def contact_sheet(context: Context) -> Response:
    """Return the latest frames of all cameras as one picture, made once for all who ask at about the same time."""

    async def make() -> bytes:
        latest = context.part(Acquisition).cameras.latest_image
        images = [latest(status.id) for status in context.control.cameras()]
        return await context.drawing.run(
            contact_sheet_jpg, [None if image is None else subsampled(image) for image in images]
        )

    jpg = await context.shared.get("contact sheet", make, keep_s=SHEET_KEPT_S)
    return Response(jpg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})


@router.get("/{camera}")
async def camera_status(context: Context, camera: CameraName) -> CameraStatus:
    """Get the state and counters of a camera."""
    return _status_of(context, camera)


@router.get(
    "/{camera}/snapshot.png",
    response_class=Response,
    dependencies=[ANEW],
    responses={200: {"content": {"image/png": {}}}},
)
async def snapshot(context: Context, camera: CameraName) -> Response:
    """Get the latest frame of a camera; 404 `not-kept` before the first."""
    image = context.part(Acquisition).cameras.latest_image(_status_of(context, camera).id)
    if image is None:
        raise Problem(404, "not-kept", f"camera {camera} has delivered no frame yet")
    png = await context.drawing.run(snapshot_png, image)
    return Response(png, media_type="image/png", headers={"Cache-Control": "no-store"})


@acting.post("/{camera}/identify", response_model=IdentifiedCamera)
async def identify_camera(
    context: Context, camera: CameraName, wanted: IdentifyRequest, asking: Who
) -> dict[str, Any]:
    """Blink the lamp of a camera: a person sees which one it is; one before it stops. 409 unless disarmed.

    The lamp is the status lamp (`DeviceIndicatorMode`), of a camera that has no switch for it what hangs on the line
    of its strobe. 503 `camera-unavailable` when it does not answer, is another one than configured, or has no lamp.
    Arming the rig ends it.
    """
    name = _status_of(context, camera).id
    try:
        vitals = await context.part(Acquisition).show_camera(name, wanted.seconds)
    except CameraUnavailableError as err:
        raise Problem(503, "camera-unavailable", str(err), cause=err.cause) from err
    log.info("camera shown camera=%s for_s=%g", name, wanted.seconds)
    after = {"seconds": wanted.seconds, "serial": vitals.serial}
    await context.store.note_change(asking, "camera identified", name, after=after)
    return {"id": name, "seconds": wanted.seconds, **asdict(vitals)}


def _status_of(context: ApiContext, camera: str) -> CameraStatus:
    for status in context.control.cameras():
        if status.id == camera:
            return status
    raise Problem(404, "unknown-camera", f"the rig has no camera {camera!r}")


ROUTERS = (acquiring, acting, router)
