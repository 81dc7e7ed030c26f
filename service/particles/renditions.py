"""Meshes and images of a stored particle in the formats that clients ask for, made in the process `stonefall-draw`."""

import json
from contextlib import suppress
from dataclasses import asdict
from enum import StrEnum
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from drivers.errors import RecordingError
from drivers.files.compact_mesh import read_compact_mesh
from drivers.files.mesh_file import ply_bytes
from drivers.files.mesh_parsing import parse_mesh
from drivers.files.recording import read_bundle, read_header
from drivers.files.silhouette_file import read_silhouettes
from pipeline.arrays import Faces, Greys, Mask, PointsMM
from pipeline.errors import MeshError
from pipeline.frames import CameraId, Image
from pipeline.geometry.decimation import decimated
from pipeline.measuring.contacts import contacts_of
from pipeline.preview import PREVIEW_NAME, encode_png, preview_png

if TYPE_CHECKING:
    import trimesh

COARSE_VERTICES = 2500
"""Vertices of a mesh that is a preview: as GLB it has about 100 kB."""
STONE, UNKNOWN = 255, 128  # labels of a silhouette
OUTLINE_STYLE = (
    "path{fill:none;stroke-width:2;vector-effect:non-scaling-stroke}"
    ".stone{stroke:var(--sf-outline,#d9480f)}.unknown{stroke:var(--sf-unknown,#868e96);stroke-dasharray:6 4}"
)
PNG_END = b"IEND\xaeB`\x82"
MM_Z_UP_TO_M_Y_UP = 0.001 * np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""From the frame of the rig to that of glTF 2.0, section 3.4: right-handed, metres, +y up; x stays, z becomes y."""


class MeshFormat(StrEnum):
    """File format of a mesh: PLY and STL in mm with z up, GLB in metres with y up."""

    PLY = "ply"
    STL = "stl"
    GLB = "glb"


class Detail(StrEnum):
    """Detail of a mesh: a preview has about 2500 vertices, a fortieth of the full mesh of a large stone."""

    PREVIEW = "preview"
    FULL = "full"


class NotKeptError(Exception):
    """The file was never written, was removed since, or is damaged."""


def mesh_bytes(folder: Path, mesh_format: MeshFormat, detail: Detail) -> bytes:
    """Return the mesh as a file of this format; raise `NotKeptError` without a mesh."""
    exact = folder / "mesh.ply"
    if mesh_format is MeshFormat.PLY and detail is Detail.FULL and exact.exists():
        return exact.read_bytes()
    mesh = stored_mesh(folder)
    if detail is Detail.PREVIEW:
        mesh = _mesh_of(*decimated(mesh.vertices, mesh.faces, _greys(mesh), COARSE_VERTICES))
    if mesh_format is MeshFormat.PLY:
        return ply_bytes(mesh.vertices, mesh.faces, _greys(mesh))
    if mesh_format is MeshFormat.GLB:
        mesh.vertices = mesh.vertices @ MM_Z_UP_TO_M_Y_UP.T
    exported = BytesIO()
    mesh.export(exported, file_type=mesh_format)
    return exported.getvalue()


def kept_preview(folder: Path, size_px: int) -> bytes | None:
    """Return the picture of this edge that was drawn with the stone, None where there is none."""
    with suppress(FileNotFoundError):
        png = (folder / PREVIEW_NAME.format(size_px)).read_bytes()
        return png if png.endswith(PNG_END) else None  # torn by a power cut
    return None


def stone_png(folder: Path, size_px: int) -> bytes:
    """Return a picture of the mesh, (`size_px`, `size_px`); raise `NotKeptError` without a mesh."""
    if (png := kept_preview(folder, size_px)) is not None:
        return png
    mesh = stored_mesh(folder)
    return preview_png(mesh.vertices, mesh.faces, _greys(mesh), size_px)


def view_png(folder: Path, camera: str) -> bytes:
    """Return the image of one camera from the archived bundle; raise `NotKeptError` where there is none."""
    archive = stored_file(folder / "bundle.tiff")
    try:
        header = read_header(archive)
        bundle = read_bundle(archive, [*header.frames, *header.missing])
    except RecordingError as err:
        raise NotKeptError(err.problem) from err
    frame = bundle.frames.get(CameraId(camera))
    if frame is None:
        raise NotKeptError(f"the view is missing: {bundle.missing.get(CameraId(camera), 'unknown camera')}")
    return encode_png(frame.image)


def silhouette_png(folder: Path, camera: str) -> bytes:
    """Return one silhouette (0 outside, 128 unknown, 255 inside); raise `NotKeptError` where there is none."""
    return encode_png(stored_silhouette(folder, camera))


def stored_silhouette(folder: Path, camera: str) -> Image:
    """Return the labels (H, W) of one view; raise `NotKeptError` where there are none."""
    try:
        silhouettes = read_silhouettes(stored_file(folder / "silhouettes.tiff"))
    except RecordingError as err:
        raise NotKeptError(err.problem) from err
    labels = silhouettes.get(CameraId(camera))
    if labels is None:
        raise NotKeptError("the view is missing")
    return labels


def stored_file(path: Path) -> Path:
    """Return the path of a file that is there; raise `NotKeptError` if it is not."""
    if not path.is_file():
        raise NotKeptError(f"{path.name} was not kept")
    return path


def stored_mesh(folder: Path) -> "trimesh.Trimesh":
    """Return the mesh, whether it was stored compact or exact."""
    path = folder / "mesh.ply" if (folder / "mesh.ply").exists() else stored_file(folder / "mesh.sfmesh")
    try:
        mesh = parse_mesh(path) if path.suffix == ".ply" else _mesh_of(*read_compact_mesh(path))
    except RecordingError as err:
        raise NotKeptError(f"{path.name} {err.problem}") from err
    if mesh.faces.size == 0 or not np.isfinite(mesh.vertices).all():
        raise NotKeptError(f"{path.name} is damaged")
    return mesh


def _mesh_of(vertices_mm: PointsMM, faces: Faces, greys: Greys | None) -> "trimesh.Trimesh":
    import trimesh  # here: with its dependencies it takes a second

    colors = None if greys is None else np.repeat(greys[:, None], 3, axis=1)
    return trimesh.Trimesh(vertices_mm, faces, vertex_colors=colors, process=False)


def _greys(mesh: "trimesh.Trimesh") -> Greys | None:
    """Return the grey of each vertex, None where they have none."""
    from trimesh.visual import ColorVisuals

    visual = mesh.visual
    if not isinstance(visual, ColorVisuals) or visual.kind != "vertex":
        return None
    return np.asarray(visual.vertex_colors[:, 0])


def calipers_json(folder: Path) -> bytes:
    """Return the contacts of the mesh as JSON; raise `NotKeptError` without a mesh that can be measured."""
    mesh = stored_mesh(folder)
    try:
        contacts = contacts_of(mesh.vertices, mesh.faces)
    except MeshError as err:
        raise NotKeptError(f"the mesh cannot be measured: {err}") from err
    return json.dumps(asdict(contacts), allow_nan=False).encode()


def outline_svg(folder: Path, camera: str) -> bytes:
    """Return the borders of stone and unknown in one view; raise `NotKeptError` where there is no silhouette."""
    labels = stored_silhouette(folder, camera)
    height, width = labels.shape
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">'
        f"<style>{OUTLINE_STYLE}</style>"
        f'<path class="unknown" d="{_border(labels == UNKNOWN)}"/>'
        f'<path class="stone" d="{_border(labels == STONE)}"/></svg>'
    ).encode()


def _border(mask: Mask) -> str:
    """Return the closed polygons around a region and its holes, as path data in pixels of the image.

    They run through the centres of the outermost pixels, half a pixel within the region; pixel (u, v) covers the square
    from (u, v) to (u + 1, v + 1).
    """
    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    return "".join(
        "M" + "L".join(f"{u + 0.5:g} {v + 0.5:g}" for u, v in contour[:, 0]) + "Z" for contour in found
    )
