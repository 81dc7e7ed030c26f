"""The files of one particle: mesh, preview, views and silhouettes.

They never change but by being removed, and what a `seq` or a view names is the same for ever; an `id` names the newest
revision. Content negotiation and caching go as far as such files need them (RFC 9110, sections 12.5.1 and 13).
"""

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response

from pipeline.measuring.contacts import Contacts
from service.particles.calipers import calipers_json
from service.particles.outlines import outline_svg
from service.particles.renditions import (
    MeshFormat,
    NotKeptError,
    mesh_bytes,
    preview_png,
    silhouette_png,
    view_png,
)
from service.particles.routes.particles import ParticleKey, find_record
from service.results.fields import Outcome
from service.store import Record
from service.store.particle_files import first_seq
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.etags import NOT_MODIFIED, Responses, has_version
from service.web.negotiation import best_match
from service.web.parameters import CameraName
from service.web.problems import Problem, problem_responses

router = APIRouter(prefix="/particles", tags=["particles"], dependencies=READABLE)

MEDIA_TYPES = {
    MeshFormat.PLY: "model/ply",
    MeshFormat.STL: "model/stl",
    MeshFormat.GLB: "model/gltf-binary",
}
CACHE_FOREVER = "private, max-age=31536000, immutable"
ASK_AGAIN = "private, no-cache"
"""For what another revision may replace: it may be kept, and is asked for by its ETag."""
OUTLINE_POLICY = "default-src 'none'; style-src 'unsafe-inline'"
"""What a browser lets the SVG do that is opened by itself: it has no scripts and loads nothing."""

IMAGE: Responses = {200: {"content": {"image/png": {}}}, **NOT_MODIFIED, **problem_responses(404, 410)}
MESH: Responses = {
    200: {"content": {media_type: {} for media_type in MEDIA_TYPES.values()}},
    **NOT_MODIFIED,
}


@router.get("/{particle_id}/mesh", response_class=Response, responses={**MESH, **problem_responses(406, 410)})
async def mesh(context: Context, request: Request, particle_id: ParticleKey) -> Response:
    """Get the mesh in the format that `Accept` prefers: PLY or STL in mm with z up, or GLB in metres with y up.

    Where `[body] texture` made them, PLY and GLB have the stone's grey as colours of the vertices.
    """
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
    "/{particle_id}/mesh.{mesh_format}", response_class=Response, responses={**MESH, **problem_responses(410)}
)
async def mesh_file(
    context: Context,
    request: Request,
    particle_id: ParticleKey,
    mesh_format: Annotated[MeshFormat, Path(description="Format of the file")],
) -> Response:
    """Download the mesh as a file: PLY or STL in mm with z up, or GLB in metres with y up, by the suffix.

    Where `[body] texture` made them, PLY and GLB have the stone's grey as colours of the vertices.
    """
    return await _mesh_response(context, request, particle_id, mesh_format)


@router.get(
    "/{particle_id}/calipers", response_model=Contacts, responses={**NOT_MODIFIED, **problem_responses(410)}
)
async def calipers(context: Context, request: Request, particle_id: ParticleKey) -> Response:
    """Get the caliper points: where length, width, thickness, both Feret diameters and the sieve touch the mesh.

    Lengths may differ from those of the result by what is known beyond the mesh: corners that it cuts, and of an
    estimate the hull around it. 404 `not-kept` without a mesh.
    """
    record = await find_record(context, particle_id)
    return await _file(
        context,
        request,
        record,
        "calipers",
        "application/json",
        calipers_json,
        is_fixed=particle_id.isdecimal(),
    )


@router.get("/{particle_id}/preview.png", response_class=Response, responses=IMAGE)
async def preview(context: Context, request: Request, particle_id: ParticleKey) -> Response:
    """Get a picture of the mesh, in the grey of its vertices if they have any."""
    record = await find_record(context, particle_id)
    return await _file(
        context, request, record, "preview", "image/png", preview_png, is_fixed=particle_id.isdecimal()
    )


@router.get("/{particle_id}/views/{camera}.png", response_class=Response, responses=IMAGE)
async def view(context: Context, request: Request, particle_id: ParticleKey, camera: CameraName) -> Response:
    """Get the image of a stone by one camera; 404 `not-kept` when the raw images were not kept or are gone."""
    record = await _record_with_view(context, particle_id, camera)
    frames = {**record, "seq": first_seq(record["id"]), "revision": 1}  # the stone's, whatever measured it
    return await _file(context, request, frames, camera, "image/png", view_png, camera, is_fixed=True)


@router.get("/{particle_id}/views/{camera}/silhouette.png", response_class=Response, responses=IMAGE)
async def silhouette(
    context: Context, request: Request, particle_id: ParticleKey, camera: CameraName
) -> Response:
    """Get the silhouette of a stone in one view: 0 outside, 128 unknown, 255 inside."""
    record = await _record_with_view(context, particle_id, camera)
    return await _file(
        context,
        request,
        record,
        f"{camera}.silhouette",
        "image/png",
        silhouette_png,
        camera,
        is_fixed=particle_id.isdecimal(),
    )


@router.get(
    "/{particle_id}/views/{camera}/outline.svg",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {}}}, **NOT_MODIFIED, **problem_responses(410)},
)
async def outline(
    context: Context, request: Request, particle_id: ParticleKey, camera: CameraName
) -> Response:
    """Draw the outline of a stone in one view: in pixels of the image; dashed is what is unknown.

    Paths have the classes `stone`, its holes among it, and `unknown`.
    """
    record = await _record_with_view(context, particle_id, camera)
    response = await _file(
        context,
        request,
        record,
        f"{camera}.outline",
        "image/svg+xml",
        outline_svg,
        camera,
        is_fixed=particle_id.isdecimal(),
    )
    response.headers["Content-Security-Policy"] = OUTLINE_POLICY
    return response


async def _record_with_view(context: ApiContext, key: str, camera: str) -> Record:
    record = await find_record(context, key)
    names_all_views = (
        record["outcome"] != Outcome.REJECTED
    )  # a rejection names only the views that it is about
    if names_all_views and camera not in {*record.get("views", ()), *record.get("dropped_views", ())}:
        raise Problem(404, "unknown-camera", f"particle {record['id']} has no view of a camera {camera!r}")
    return record


async def _mesh_response(
    context: ApiContext, request: Request, key: str, mesh_format: MeshFormat
) -> Response:
    record = await find_record(context, key)
    response = await _file(
        context,
        request,
        record,
        mesh_format,
        MEDIA_TYPES[mesh_format],
        mesh_bytes,
        mesh_format,
        is_fixed=key.isdecimal(),
    )
    response.headers["Vary"] = "Accept"
    return response


async def _file(
    context: ApiContext,
    request: Request,
    record: Record,
    name: str,
    media_type: str,
    load: Callable[..., bytes],
    *choice: str,
    is_fixed: bool,
) -> Response:
    """Answer with `load(folder, *choice)`, 304 when the client has it; one that is fixed it may cache for ever."""
    members: dict[str, Any] = {"outcome": record["outcome"], "reason": record.get("reason")}
    if (removed := record["files_removed"]) is not None:
        detail = (
            f"mesh and images of particle {record['id']} were removed for {removed}, its numbers are kept"
        )
        raise Problem(410, "files-removed", detail, files_removed=removed, **members)
    revision = record.get("revision", 1)
    etag = f'"{record["id"]}.{name}"' if revision == 1 else f'"{record["id"]}.r{revision}.{name}"'
    headers = {"ETag": etag, "Cache-Control": CACHE_FOREVER if is_fixed else ASK_AGAIN}
    if has_version(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    try:
        content = await context.reading.run(load, await context.store.folder(record["seq"]), *choice)
    except NotKeptError as err:
        raise Problem(
            404, "not-kept", f"particle {record['id']} ({record['outcome']}): {err}", **members
        ) from err
    return Response(content, media_type=media_type, headers=headers)
