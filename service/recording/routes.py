"""Routes of recordings: record bundles of images while measuring; fetch and delete recordings."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Path, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from service.recording.live_recording import RecordingState, RecordingStatus
from service.recording.recording_tar import members_of, tar_bytes, tar_pieces
from service.recording.recordings import NAME, RecordingRefusedError, RecordingRequest, Recordings, Refusal
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.problems import existing, problem_responses
from service.web.version import BASE

router = APIRouter(prefix="/recordings", tags=["recordings"])

RecordingName = Annotated[str, Path(pattern=NAME, description="Name of the recording")]


class RecordingsAnswer(BaseModel):
    """All recordings, by name."""

    items: list[RecordingStatus] = Field(description="By name")


@router.get("", dependencies=READABLE)
async def recordings(context: Context) -> RecordingsAnswer:
    """List the recordings, including those that failed since the daemon was started."""
    return RecordingsAnswer(items=await context.part(Recordings).all())


@router.post("", status_code=201, dependencies=OPERABLE, responses=problem_responses(507))
async def start_recording(
    context: Context, wanted: RecordingRequest, response: Response, asking: Who
) -> RecordingStatus:
    """Begin a recording. 409 while another one is running or when the name is taken, 507 without disk space."""
    status = await context.part(Recordings).start(wanted)
    after = {name: value for name, value in asdict(wanted).items() if name != "name"}
    await context.store.note_change(asking, "recording started", status.name, after=after)
    response.headers["Location"] = f"{BASE}/recordings/{status.name}"
    return status


@router.get(
    "/{name}.tar",
    response_class=StreamingResponse,
    dependencies=READABLE,
    responses={200: {"content": {"application/x-tar": {}}}, **problem_responses(409)},
)
async def download_recording(context: Context, name: RecordingName) -> StreamingResponse:
    """Download a recording: all its files as one tar file; 409 while it is under way."""
    recordings = context.part(Recordings)
    if existing(await recordings.find(name), "recording", repr(name)).state is RecordingState.RECORDING:
        raise RecordingRefusedError(Refusal.RUNNING, f"recording {name} is under way: stop it first")
    members = await context.reading.run(members_of, recordings.path(name))
    return StreamingResponse(
        tar_pieces(context.reading, members),
        media_type="application/x-tar",
        headers={
            "Content-Length": str(tar_bytes(members)),
            "Content-Disposition": f'attachment; filename="{name}.tar"',
        },
    )


@router.delete(
    "/{name}",
    status_code=204,
    response_class=Response,
    dependencies=OPERABLE,
    responses=problem_responses(409),
)
async def delete_recording(context: Context, name: RecordingName, asking: Who) -> None:
    """Delete a recording and all its files; 409 while it is under way."""
    recordings = context.part(Recordings)
    before = existing(await recordings.find(name), "recording", repr(name))
    existing(await recordings.delete(name) or None, "recording", repr(name))
    await context.store.note_change(asking, "recording deleted", name, before=_facts(before))


@router.get("/{name}", dependencies=READABLE)
async def recording(context: Context, name: RecordingName) -> RecordingStatus:
    """Get a recording."""
    return existing(await context.part(Recordings).find(name), "recording", repr(name))


@router.post("/{name}/stop", dependencies=OPERABLE)
async def stop_recording(context: Context, name: RecordingName, asking: Who) -> RecordingStatus:
    """End a recording early: keep what it has, and answer when it is complete. Repeating changes nothing."""
    recordings = context.part(Recordings)
    before = existing(await recordings.find(name), "recording", repr(name))
    after = existing(await recordings.stop(name), "recording", repr(name))
    await context.store.note_change(
        asking, "recording stopped", name, before=_facts(before), after=_facts(after)
    )
    return after


def _facts(status: RecordingStatus) -> dict[str, Any]:
    """Return the facts about a recording that the audit keeps."""
    return {name: value for name, value in asdict(status).items() if name not in ("name", "made_by")}


ROUTERS = (router,)
