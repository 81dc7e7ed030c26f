"""Record bundles of images while measuring; fetch and delete recordings."""

from dataclasses import asdict
from typing import Annotated, Any, Self

from fastapi import APIRouter, Depends, Path, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field, model_validator

from service.api.auth import Who, require
from service.api.context import Context
from service.api.problems import Problem, existing, problem_responses
from service.api.recording_tar import members_of, tar_bytes, tar_pieces
from service.api.settings import Scope
from service.api.version import BASE
from service.base.schema import TIME
from service.recording.live_recording import RecordingState, RecordingStatus
from service.recording.recordings import RecordingPlan, RecordingRefusedError, Refusal

router = APIRouter(prefix="/recordings", tags=["recordings"])

NAME = r"^[A-Za-z0-9_-]{1,64}$"
RecordingName = Annotated[str, Path(pattern=NAME, description="Name of the recording")]
STATUS_OF_REFUSAL = {Refusal.EXISTS: 409, Refusal.RUNNING: 409, Refusal.NO_ROOM: 507}


class Recording(BaseModel):
    """State of a recording. A `complete` one can be replayed and measured, a `failed` one left no usable files."""

    name: str = Field(description="Name of its folder, and in the addresses")
    state: RecordingState = Field(
        description="`recording`: under way; `complete`: usable; `failed`: no usable files"
    )
    created_at: str = Field(description="RFC 3339 UTC", json_schema_extra=TIME)
    bundles: int = Field(description="Bundles written so far, exposures of the empty rig included")
    bytes: int = Field(description="Size of the bundles on disk")
    stones: int | None = Field(
        description="Stones and balls among the bundles so far, those before it began included; null unless it is under"
        " way"
    )
    ended_by: str | None = Field(
        description="Why it ended: `count`, `duration` or `stop` as requested; `low_disk` or `slow_disk`: earlier than"
        " requested; null while it runs"
    )
    reason: str | None = Field(description="Why it failed, in words; null unless `failed`")
    made_by: dict[str, Any] = Field(description="How it was made, as in recording.json")


class Recordings(BaseModel):
    """All recordings, by name."""

    items: list[Recording] = Field(description="By name")


class RecordingRequest(BaseModel):
    """Request for a recording. It ends when `count` or `duration_s` is reached, whichever comes first."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(pattern=NAME, description="Name of its folder; must be new")
    count: int | None = Field(
        default=None, ge=1, le=1_000_000, strict=True, description="Number of stones to record from now on"
    )
    duration_s: float | None = Field(
        default=None, gt=0, le=86_400, strict=True, description="Seconds to record from now on"
    )
    pre_trigger: int = Field(
        default=0,
        ge=0,
        le=1000,
        strict=True,
        description="Number of stones before now to record as well, as far as their frames are kept",
    )

    @model_validator(mode="after")
    def _ends(self) -> Self:
        if self.count is None and self.duration_s is None:
            raise ValueError("give count, duration_s or both: a recording must end")
        return self


@router.get("", response_model=Recordings, dependencies=[Depends(require(Scope.READ))])
async def recordings(context: Context) -> dict[str, Any]:
    """List the recordings, including those that failed since the daemon was started."""
    return {"items": [asdict(status) for status in await context.control.recordings.all()]}


@router.post(
    "",
    status_code=201,
    response_model=Recording,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(409, 507),
)
async def start_recording(
    context: Context, wanted: RecordingRequest, response: Response, asking: Who
) -> dict[str, Any]:
    """Begin a recording. 409 while another one is running or when the name is taken, 507 without disk space."""
    try:
        status = await context.control.recordings.start(RecordingPlan(**wanted.model_dump()))
    except RecordingRefusedError as err:
        raise Problem(STATUS_OF_REFUSAL[err.refusal], err.refusal, str(err)) from err
    await context.store.note_change(
        asking, "recording started", status.name, after=wanted.model_dump(exclude={"name"})
    )
    response.headers["Location"] = f"{BASE}/recordings/{status.name}"
    return asdict(status)


@router.get(
    "/{name}.tar",
    response_class=StreamingResponse,
    dependencies=[Depends(require(Scope.READ))],
    responses={200: {"content": {"application/x-tar": {}}}, **problem_responses(404, 409)},
)
async def download_recording(context: Context, name: RecordingName) -> StreamingResponse:
    """Download a recording: all its files as one tar file; 409 while it is under way."""
    recordings = context.control.recordings
    if existing(await recordings.find(name), "recording", repr(name)).state is RecordingState.RECORDING:
        raise Problem(409, Refusal.RUNNING, f"recording {name} is under way: stop it first")
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
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(404, 409),
)
async def delete_recording(context: Context, name: RecordingName, asking: Who) -> None:
    """Delete a recording and all its files; 409 while it is under way."""
    recordings = context.control.recordings
    before = existing(await recordings.find(name), "recording", repr(name))
    try:
        existing(await recordings.delete(name) or None, "recording", repr(name))
    except RecordingRefusedError as err:
        raise Problem(STATUS_OF_REFUSAL[err.refusal], err.refusal, str(err)) from err
    await context.store.note_change(asking, "recording deleted", name, before=_facts(before))


@router.get(
    "/{name}",
    response_model=Recording,
    dependencies=[Depends(require(Scope.READ))],
    responses=problem_responses(404),
)
async def recording(context: Context, name: RecordingName) -> dict[str, Any]:
    """Get a recording."""
    return asdict(existing(await context.control.recordings.find(name), "recording", repr(name)))


@router.post(
    "/{name}/stop",
    response_model=Recording,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(404),
)
async def stop_recording(context: Context, name: RecordingName, asking: Who) -> dict[str, Any]:
    """End a recording early: keep what it has, and answer when it is complete. Repeating changes nothing."""
    recordings = context.control.recordings
    before = existing(await recordings.find(name), "recording", repr(name))
    after = existing(await recordings.stop(name), "recording", repr(name))
    await context.store.note_change(
        asking, "recording stopped", name, before=_facts(before), after=_facts(after)
    )
    return asdict(after)


def _facts(status: RecordingStatus) -> dict[str, Any]:
    """Return what the audit is to know of a recording."""
    return {name: value for name, value in asdict(status).items() if name not in ("name", "made_by")}
