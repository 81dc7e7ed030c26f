"""The cameras of the rig, live."""

from typing import Annotated, Any

from fastapi import APIRouter, Path
from fastapi.responses import Response

from service.api.context import ApiContext, Context
from service.api.problems import Problem, documented
from service.api.schemas import Camera, Cameras
from service.status import CameraStatus

router = APIRouter(prefix="/cameras", tags=["cameras"])

CameraName = Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$")]


@router.get("", response_model=Cameras, responses=documented())
async def cameras(context: Context) -> dict[str, Any]:
    """State and counters of all cameras."""
    return {"items": context.control.cameras()}


@router.get("/{camera}", response_model=Camera, responses=documented(404))
async def camera_status(context: Context, camera: CameraName) -> CameraStatus:
    """State and counters of one camera."""
    return _status_of(context, camera)


@router.get(
    "/{camera}/snapshot.png",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}}, **documented(404)},
)
async def snapshot(context: Context, camera: CameraName) -> Response:
    """Show the camera's latest frame."""
    png = await context.control.snapshot(_status_of(context, camera).id)
    if png is None:
        raise Problem(404, "not-kept", f"camera {camera} has delivered no frame yet")
    return Response(png, media_type="image/png", headers={"Cache-Control": "no-store"})


def _status_of(context: ApiContext, camera: str) -> CameraStatus:
    for status in context.control.cameras():
        if status.id == camera:
            return status
    raise Problem(404, "unknown-camera", f"the rig has no camera {camera!r}")
