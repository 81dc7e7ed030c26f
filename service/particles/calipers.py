"""Where calipers and the sieve touch the mesh of a stored particle, made in the process `stonefall-read`."""

import json
from dataclasses import asdict
from pathlib import Path

from pipeline.errors import MeshError
from pipeline.measuring.contacts import contacts_of
from service.particles.renditions import NotKeptError, stored_mesh


def calipers_json(folder: Path) -> bytes:
    """Return the contacts of the mesh as JSON; raise `NotKeptError` without a mesh that can be measured."""
    mesh = stored_mesh(folder)
    try:
        contacts = contacts_of(mesh.vertices, mesh.faces)
    except MeshError as err:
        raise NotKeptError(f"the mesh cannot be measured: {err}") from err
    return json.dumps(asdict(contacts), allow_nan=False).encode()
