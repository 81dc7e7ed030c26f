"""Where calipers and the sieve touch the mesh of a stored particle, made in the process `stonefall-read`."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field

from pipeline.errors import MeshError
from pipeline.measuring.contacts import contacts_of
from service.api.renditions import NotKeptError, stored_mesh

Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]


class CaliperDocument(BaseModel):
    """Two parallel planes that touch the stone from both sides."""

    value_mm: float = Field(description="Distance of the planes, mm")
    a_mm: Vector3 = Field(description="Where one plane touches (x, y, z), mm; a vertex of the mesh")
    b_mm: Vector3 = Field(description="Where the other one does")
    direction: Vector3 = Field(description="Unit normal of both planes, towards `a_mm`")


class SquareHoleDocument(BaseModel):
    """The smallest square that the stone passes by translation."""

    value_mm: float = Field(description="Edge of the square, mm")
    direction: Vector3 = Field(description="Unit vector along which the stone passes")
    corners_mm: list[Vector3] = Field(description="The four corners around, in the plane of the centre, mm")
    touches_mm: list[Vector3] = Field(description="Vertices of the mesh that touch a side as it passes, mm")


class CalipersDocument(BaseModel):
    """Where calipers and sieve touch a mesh, in the frame of the rig (z up)."""

    length: CaliperDocument = Field(description="Greatest dimension (ASTM D4791 length)")
    width: CaliperDocument = Field(
        description="Greatest dimension at right angles to the length (ASTM D4791 width)"
    )
    thickness: CaliperDocument = Field(description="At right angles to both (ASTM D4791 thickness)")
    max_feret: CaliperDocument = Field(description="Greatest distance of tangent planes (EN 933-4 length L)")
    min_feret: CaliperDocument = Field(description="Least distance of tangent planes (EN 933-4 thickness E)")
    sieve: SquareHoleDocument = Field(description="Square hole of the sieve size (EN 933-2)")
    volume_mm3: float = Field(description="Volume of the mesh, mm³")
    center_mm: Vector3 = Field(description="Centre of mass of the mesh, mm")


def calipers_json(folder: Path) -> bytes:
    """Return the contacts of the mesh as JSON; raise `NotKeptError` without a mesh that can be measured."""
    mesh = stored_mesh(folder)
    try:
        contacts = contacts_of(mesh.vertices, mesh.faces)
    except MeshError as err:
        raise NotKeptError(f"the mesh cannot be measured: {err}") from err
    return json.dumps(asdict(contacts), allow_nan=False, default=np.ndarray.tolist).encode()
