"""One stone after another: its result, its mesh, what was seen of it."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from fastapi import Path as PathParameter
from fastapi.responses import JSONResponse, Response
from pydantic import AfterValidator

from pipeline.frames import rfc3339
from service.api.context import ApiContext, Context
from service.api.negotiation import FOREVER, best_match, names_etag
from service.api.pages import page_of
from service.api.problems import Problem, documented, found
from service.api.routes import particle_files as pictures
from service.api.routes.cameras import CameraName
from service.api.routes.particle_files import MeshFormat, NotKeptError
from service.api.routes.results import MAX_SEQ
from service.api.schemas import ParticlesPage
from service.results.fields import Outcome, Result, completed
from service.store import ParticleFilter, Record

router = APIRouter(prefix="/particles", tags=["particles"])

MEDIA_TYPES = {
    MeshFormat.PLY: "model/ply",
    MeshFormat.STL: "model/stl",
    MeshFormat.GLB: "model/gltf-binary",
}

ParticleKey = Annotated[
    str, PathParameter(pattern=r"^([0-9a-f]{8}-)?[0-9]{1,15}$", description="`id`, or `seq` as a number")
]
SizeMm = Annotated[float | None, Query(ge=0, allow_inf_nan=False)]
Time = Annotated[
    str, AfterValidator(rfc3339), Query(description="RFC 3339", json_schema_extra={"format": "date-time"})
]
Responses = dict[int | str, dict[str, Any]]

IMAGE: Responses = {
    200: {"content": {"image/png": {}}},
    304: {"description": "You have it"},
    **documented(404),
}
MESH: Responses = {
    200: {"content": {media_type: {} for media_type in MEDIA_TYPES.values()}},
    304: {"description": "You have it"},
}


@router.get("", response_model=ParticlesPage, responses=documented())
async def particles(
    context: Context,
    outcome: Literal["measured", "rejected", "lost"] | None = None,
    quality: Literal["good", "reduced", "degraded"] | None = None,
    kind: Literal["particle", "ball"] | None = None,
    min_sieve_size_mm: SizeMm = None,
    max_sieve_size_mm: SizeMm = None,
    since: Annotated[Time | None, Query(description="Captured at or after")] = None,
    until: Annotated[Time | None, Query(description="Captured before")] = None,
    cursor: Annotated[
        str | None, Query(pattern=r"^[0-9]{1,15}$", description="`next_cursor` of a page")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """Results that fit all filters, newest first. To follow production use the feed, `/results`."""
    wanted = ParticleFilter(
        outcome=outcome,
        quality=quality,
        kind=kind,
        min_sieve_size_mm=min_sieve_size_mm,
        max_sieve_size_mm=max_sieve_size_mm,
        since=since,
        until=until,
    )
    records = await context.store.particles(wanted, MAX_SEQ if cursor is None else int(cursor), limit + 1)
    items = records[:limit]
    return await page_of({"next_cursor": str(items[-1]["seq"]) if len(records) > limit else None}, items)


@router.get("/{particle_id}", response_model=Result, responses=documented(404))
async def particle(context: Context, particle_id: ParticleKey) -> JSONResponse:
    """One result."""
    return JSONResponse(completed(await _record(context, particle_id)))


@router.get("/{particle_id}/mesh", response_class=Response, responses={**MESH, **documented(404, 406)})
async def mesh(context: Context, request: Request, particle_id: ParticleKey) -> Response:
    """Give the mesh in the format that `Accept` prefers: PLY or STL in mm, or GLB in metres with y up."""
    formats = list(MEDIA_TYPES)
    choice = best_match(request.headers.get("accept"), list(MEDIA_TYPES.values()))
    if choice is None:
        raise Problem(
            406,
            "not-acceptable",
            "a mesh comes as " + ", ".join(MEDIA_TYPES.values()),
            headers={"Vary": "Accept"},
        )
    return await _mesh_response(context, request, particle_id, formats[choice])


@router.get(
    "/{particle_id}/mesh.{mesh_format}", response_class=Response, responses={**MESH, **documented(404)}
)
async def mesh_file(
    context: Context, request: Request, particle_id: ParticleKey, mesh_format: MeshFormat
) -> Response:
    """Give the mesh in the format of the suffix: PLY or STL in mm, or GLB in metres with y up."""
    return await _mesh_response(context, request, particle_id, mesh_format)


@router.get("/{particle_id}/preview.png", response_class=Response, responses=IMAGE)
async def preview(context: Context, request: Request, particle_id: ParticleKey) -> Response:
    """Render a picture of the mesh."""
    record = await _record(context, particle_id)
    return await _file(context, request, record, "preview", "image/png", pictures.preview_png)


@router.get("/{particle_id}/views/{camera}.png", response_class=Response, responses=IMAGE)
async def view(context: Context, request: Request, particle_id: ParticleKey, camera: CameraName) -> Response:
    """Show what a camera saw, where the raw images were kept."""
    record = await _record_seen_by(context, particle_id, camera)
    return await _file(
        context, request, record, camera, "image/png", lambda folder: pictures.view_png(folder, camera)
    )


@router.get("/{particle_id}/views/{camera}/silhouette.png", response_class=Response, responses=IMAGE)
async def silhouette(
    context: Context, request: Request, particle_id: ParticleKey, camera: CameraName
) -> Response:
    """Show the stone's silhouette in a view: 0 outside, 128 unknown, 255 inside."""
    record = await _record_seen_by(context, particle_id, camera)
    return await _file(
        context,
        request,
        record,
        f"{camera}.silhouette",
        "image/png",
        lambda folder: pictures.silhouette_png(folder, camera),
    )


async def _record(context: ApiContext, key: str) -> Record:
    record = await context.store.particle(int(key) if key.isdecimal() else key)
    return found(record, "particle", key)


async def _record_seen_by(context: ApiContext, key: str, camera: str) -> Record:
    record = await _record(context, key)
    is_told = record["outcome"] != Outcome.REJECTED  # a rejection names only the views that it is about
    if is_told and camera not in {*record.get("views", ()), *record.get("dropped_views", ())}:
        raise Problem(404, "unknown-camera", f"particle {record['id']} has no view of a camera {camera!r}")
    return record


async def _mesh_response(
    context: ApiContext, request: Request, key: str, mesh_format: MeshFormat
) -> Response:
    record = await _record(context, key)
    response = await _file(
        context,
        request,
        record,
        mesh_format,
        MEDIA_TYPES[mesh_format],
        lambda folder: pictures.mesh_bytes(folder, mesh_format),
    )
    response.headers["Vary"] = "Accept"
    return response


async def _file(
    context: ApiContext,
    request: Request,
    record: Record,
    name: str,
    media_type: str,
    load: Callable[[Path], bytes],
) -> Response:
    """Answer with a file of the particle: it never changes, so the client may keep it for ever."""
    etag = f'"{record["id"]}.{name}"'
    headers = {"ETag": etag, "Cache-Control": FOREVER}
    if names_etag(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    try:
        async with context.rendering:
            content = await asyncio.to_thread(load, context.store.particles_dir / record["id"])
    except NotKeptError as err:
        members: dict[str, Any] = {"outcome": record["outcome"], "reason": record.get("reason")}
        raise Problem(
            404, "not-kept", f"particle {record['id']} ({record['outcome']}): {err}", **members
        ) from err
    return Response(content, media_type=media_type, headers=headers)
