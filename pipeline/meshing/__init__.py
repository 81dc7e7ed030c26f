"""The surface of the visual hull as a closed triangle mesh."""

from pipeline.meshing.surface import Mesher, MeshingParameters, ParticleMesh, mesh_hull, warm_up

__all__ = ["Mesher", "MeshingParameters", "ParticleMesh", "mesh_hull", "warm_up"]
