"""A product, lots of it and their stones over REST."""

from typing import Any

import httpx
from support.outcomes import measured

from service.results.fields import Result

PRODUCT = {
    "title": "8/16 basalt",
    "density_kg_m3": 2700,
    "lower_mm": 8,
    "upper_mm": 16,
    "specification": "GC85-20",
    "flakiness_category": "FI20",
}


def stone(size_mm: float, **fields: Any) -> Result:
    """Return the record of a cube-like stone."""
    edges = {"length_mm": size_mm, "width_mm": size_mm, "thickness_mm": 0.8 * size_mm}
    ferets = {"max_feret_mm": 1.5 * size_mm, "min_feret_mm": 0.8 * size_mm}
    sds = {"volume_sd_percent": 0.5, "surface_sd_mm": 0.02}
    return measured(
        **{"sieve_size_mm": size_mm, "volume_mm3": 0.6 * size_mm**3, **edges, **ferets, **sds, **fields}
    )


async def put_product(client: httpx.AsyncClient) -> None:
    """Enter the product `basalt-8-16`."""
    assert (await client.put("/products/basalt-8-16", json=PRODUCT)).status_code == 200


async def opened(client: httpx.AsyncClient, lot: str = "L1", **more: Any) -> httpx.Response:
    """Open a lot of it."""
    return await client.post("/lots", json={"lot": lot, "product": "basalt-8-16", **more})
