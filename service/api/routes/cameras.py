"""The cameras of the rig, live."""

from typing import Annotated, Any

from fastapi import APIRouter, Path
from fastapi.responses import Response
from pydantic import BaseModel, Field

from service.api.context import ApiContext, Context
from service.api.problems import Problem, problem_responses
from service.api.renditions import SHEET_COLUMNS, SHEET_TILE_PX, contact_sheet_jpg, snapshot_png, subsampled
from service.status import CameraStatus

router = APIRouter(prefix="/cameras", tags=["cameras"])

CameraName = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$", description="Place of the camera in the rig, such as `c01`")
]


SHEET_KEPT_S = 2.0
"""For so long all who ask get the same contact sheet, however many watch."""


class Camera(CameraStatus):
    """State of one camera; counters begin when the daemon starts, unless a field says otherwise."""


class Cameras(BaseModel):
    """All cameras of the rig."""

    items: list[Camera] = Field(description="By place in the rig")


@router.get("", response_model=Cameras, responses=problem_responses())
async def cameras(context: Context) -> dict[str, Any]:
    """Return state and counters of all cameras."""
    return {"items": context.control.cameras()}


@router.get(
    "/contact-sheet.jpg",
    response_class=Response,
    responses={200: {"content": {"image/jpeg": {}}}, **problem_responses()},
    description=f"Return the latest frames of all cameras as one picture: {SHEET_COLUMNS} a row in the order of"
    f" `/cameras`, each {SHEET_TILE_PX} px wide, grey before its first frame. A few seconds old at most.",
)
async def contact_sheet(context: Context) -> Response:
    """Return the latest frames of all cameras as one picture, made once for all who ask at about the same time."""

    async def make() -> bytes:
        images = [context.control.latest_image(status.id) for status in context.control.cameras()]
        return await context.reading.run(
            contact_sheet_jpg, [None if image is None else subsampled(image) for image in images]
        )

    jpg = await context.shared.get("contact sheet", make, keep_s=SHEET_KEPT_S)
    return Response(jpg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})


@router.get("/{camera}", response_model=Camera, responses=problem_responses(404))
async def camera_status(context: Context, camera: CameraName) -> CameraStatus:
    """Return state and counters of one camera."""
    return _status_of(context, camera)


@router.get(
    "/{camera}/snapshot.png",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}}, **problem_responses(404)},
)
async def snapshot(context: Context, camera: CameraName) -> Response:
    """Return the latest frame of the camera; 404 `not-kept` before the first."""
    image = context.control.latest_image(_status_of(context, camera).id)
    if image is None:
        raise Problem(404, "not-kept", f"camera {camera} has delivered no frame yet")
    png = await context.reading.run(snapshot_png, image)
    return Response(png, media_type="image/png", headers={"Cache-Control": "no-store"})


def _status_of(context: ApiContext, camera: str) -> CameraStatus:
    for status in context.control.cameras():
        if status.id == camera:
            return status
    raise Problem(404, "unknown-camera", f"the rig has no camera {camera!r}")
