"""The files of one particle: mesh, preview, views and silhouettes.

A picture that was drawn with its stone is read; all else is made in the process `stonefall-draw`, once for all who ask
for the same meanwhile. They never change but by being removed, and what a `seq` or a view names is the same for ever;
an `id` names the newest revision. Content negotiation and caching go as far as such files need them (RFC 9110, sections
12.5.1 and 13).
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request
from fastapi.responses import Response

from pipeline.measuring.contacts import Contacts
from pipeline.preview import PICTURE_PX, THUMBNAIL_PX
from service.particles.renditions import (
    Detail,
    MeshFormat,
    NotKeptError,
    calipers_json,
    kept_preview,
    mesh_bytes,
    outline_svg,
    silhouette_png,
    stone_png,
    view_png,
)
from service.particles.routes.particles import ParticleKey, find_record
from service.results.fields import Outcome
from service.store import Record
from service.store.particle_files import first_seq
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.etags import NOT_MODIFIED, Responses, has_version
from service.web.negotiation import negotiated
from service.web.parameters import CameraName
from service.web.problems import Problem, problem_responses
from service.web.shared_documents import POLICY

router = APIRouter(prefix="/particles", tags=["particles"], dependencies=READABLE)

MEDIA_TYPES = {MeshFormat.PLY: "model/ply", MeshFormat.STL: "model/stl", MeshFormat.GLB: "model/gltf-binary"}
CACHE_FOREVER = "private, max-age=31536000, immutable"
ASK_AGAIN = "private, no-cache"
"""For what another revision may replace: it may be kept, and is asked for by its ETag."""
GONE: Responses = {**NOT_MODIFIED, **problem_responses(410)}
IMAGE: Responses = {200: {"content": {"image/png": {}}}, **GONE}
SVG: Responses = {200: {"content": {"image/svg+xml": {}}}, **GONE}
MESH: Responses = {200: {"content": {media_type: {} for media_type in MEDIA_TYPES.values()}}, **GONE}


@dataclass(frozen=True, slots=True, kw_only=True)
class FileRequest:
    """Request for a file of a stone; its `seq` names one revision for ever, its `id` the newest."""

    context: ApiContext
    request: Request
    key: str
    record: Record
    camera: str = ""  # of a view

    async def answer(
        self,
        name: str,
        media_type: str,
        load: Callable[..., bytes],
        *choice: str | int,
        kept: Callable[..., bytes | None] | None = None,
        is_fixed: bool = False,
    ) -> Response:
        """Answer with `load(folder, *choice)`, 304 when the client has it; one that is fixed it may cache for ever.

        `kept(folder, *choice)` takes no time, and returns None for what has to be made.
        """
        record = self.record
        members: dict[str, Any] = {"outcome": record["outcome"], "reason": record.get("reason")}
        if (removed := record["files_removed"]) is not None:
            detail = (
                f"mesh and images of particle {record['id']} were removed for {removed}, its numbers are kept"
            )
            raise Problem(410, "files-removed", detail, files_removed=removed, **members)
        revision = record.get("revision", 1)
        etag = f'"{record["id"]}.{name}"' if revision == 1 else f'"{record["id"]}.r{revision}.{name}"'
        is_lasting = is_fixed or self.key.isdecimal()
        headers = {"ETag": etag, "Cache-Control": CACHE_FOREVER if is_lasting else ASK_AGAIN}
        if has_version(self.request.headers.get("if-none-match"), etag):
            return Response(status_code=304, headers=headers)
        try:
            folder = await self.context.store.folder(record["seq"])
            content = None if kept is None else await asyncio.to_thread(kept, folder, *choice)
            if content is None:
                make = partial(self.context.drawing.run, load, folder, *choice)
                content = await self.context.shared.get((load, folder, *choice), make, keep_s=0)
        except NotKeptError as err:
            detail = f"particle {record['id']} ({record['outcome']}): {err}"
            raise Problem(404, "not-kept", detail, **members) from err
        return Response(content, media_type=media_type, headers=headers)

    async def mesh(self, mesh_format: MeshFormat, detail: Detail) -> Response:
        """Answer with the mesh in this format and detail."""
        name = mesh_format if detail is Detail.FULL else f"{mesh_format}-{detail}"
        response = await self.answer(name, MEDIA_TYPES[mesh_format], mesh_bytes, mesh_format, detail)
        response.headers["Vary"] = "Accept"
        return response


async def file_request(context: Context, request: Request, particle_id: ParticleKey) -> FileRequest:
    """Find the stone; raise the problem 404 where there is none."""
    record = await find_record(context, particle_id)
    return FileRequest(context=context, request=request, key=particle_id, record=record)


async def view_request(
    context: Context, request: Request, particle_id: ParticleKey, camera: CameraName
) -> FileRequest:
    """Find the stone; raise the problem 404 where there is none, or it has no view of this camera."""
    asked = await file_request(context, request, particle_id)
    record = asked.record
    # a rejection names only the views that it is about
    names_all_views = record["outcome"] != Outcome.REJECTED
    if names_all_views and camera not in {*record.get("views", ()), *record.get("dropped_views", ())}:
        raise Problem(404, "unknown-camera", f"particle {record['id']} has no view of a camera {camera!r}")
    return replace(asked, camera=camera)


async def format_of(mesh_format: Annotated[MeshFormat, Path(description="Format of the file")]) -> MeshFormat:
    """Return the format that the path names; a dependency, as parameters of the path stand in its order then."""
    return mesh_format


class PictureSize(IntEnum):
    """Edge of a picture in pixels."""

    THUMBNAIL = THUMBNAIL_PX
    PICTURE = PICTURE_PX


MeshDetail = Annotated[
    Detail,
    Query(description="`preview` has about 2500 vertices, 100 kB as GLB; it shows, it does not measure"),
]
PictureEdge = Annotated[
    PictureSize,
    Query(description="Edge in px. The smaller picture is drawn with its stone, and comes at once"),
]
Asked = Annotated[FileRequest, Depends(file_request)]
AskedView = Annotated[FileRequest, Depends(view_request)]


@router.get("/{particle_id}/mesh", response_class=Response, responses={**MESH, **problem_responses(406)})
async def mesh(asked: Asked, detail: MeshDetail = Detail.FULL) -> Response:
    """Get the mesh in the format that `Accept` prefers: PLY or STL in mm with z up, or GLB in metres with y up.

    Where `[body] texture` made them, PLY and GLB have the stone's grey as colours of the vertices.
    """
    return await asked.mesh(negotiated(asked.request, MEDIA_TYPES, "a mesh"), detail)


@router.get("/{particle_id}/mesh.{mesh_format}", response_class=Response, responses=MESH)
async def mesh_file(
    asked: Asked,
    mesh_format: Annotated[MeshFormat, Depends(format_of)],
    detail: MeshDetail = Detail.FULL,
) -> Response:
    """Download the mesh as a file: PLY or STL in mm with z up, or GLB in metres with y up, by the suffix.

    Where `[body] texture` made them, PLY and GLB have the stone's grey as colours of the vertices.
    """
    return await asked.mesh(mesh_format, detail)


@router.get("/{particle_id}/calipers", response_model=Contacts, responses=GONE)
async def calipers(asked: Asked) -> Response:
    """Get the caliper points: where length, width, thickness, both Feret diameters and the sieve touch the mesh.

    Lengths may differ from those of the result by what is known beyond the mesh: corners that it cuts, and of an
    estimate the hull around it. 404 `not-kept` without a mesh.
    """
    return await asked.answer("calipers", "application/json", calipers_json)


@router.get("/{particle_id}/preview.png", response_class=Response, responses=IMAGE)
async def preview(asked: Asked, size_px: PictureEdge = PictureSize.PICTURE) -> Response:
    """Get a picture of the mesh, in the grey of its vertices if they have any."""
    name = "preview" if size_px is PictureSize.PICTURE else f"preview-{size_px}"
    return await asked.answer(name, "image/png", stone_png, int(size_px), kept=kept_preview)


@router.get("/{particle_id}/views/{camera}.png", response_class=Response, responses=IMAGE)
async def view(asked: AskedView) -> Response:
    """Get the image of a stone by one camera; 404 `not-kept` when the raw images were not kept or are gone."""
    stone = asked.record["id"]  # whatever measured it, its frames are the same
    frames = replace(asked, record={**asked.record, "seq": first_seq(stone), "revision": 1})
    return await frames.answer(asked.camera, "image/png", view_png, asked.camera, is_fixed=True)


@router.get("/{particle_id}/views/{camera}/silhouette.png", response_class=Response, responses=IMAGE)
async def silhouette(asked: AskedView) -> Response:
    """Get the silhouette of a stone in one view: 0 outside, 128 unknown, 255 inside."""
    return await asked.answer(f"{asked.camera}.silhouette", "image/png", silhouette_png, asked.camera)


@router.get("/{particle_id}/views/{camera}/outline.svg", response_class=Response, responses=SVG)
async def outline(asked: AskedView) -> Response:
    """Draw the outline of a stone in one view: in pixels of the image; dashed is what is unknown.

    Paths have the classes `stone`, its holes among it, and `unknown`.
    """
    response = await asked.answer(f"{asked.camera}.outline", "image/svg+xml", outline_svg, asked.camera)
    response.headers["Content-Security-Policy"] = POLICY
    return response
