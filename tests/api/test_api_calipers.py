"""Calipers and outlines of a stored stone, as the passport draws them."""

import asyncio
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter
from support.outcomes import add, measured
from support.rest import BOX_MM, FakeControl, app_of, client_of, particle_files

from drivers.files.silhouette_file import write_silhouettes
from pipeline.frames import CameraId
from pipeline.measuring.contacts import Contacts
from service.store import Store

SVG = "{http://www.w3.org/2000/svg}"
LABELS = np.zeros((60, 80), np.uint8)
LABELS[10:40, 20:60] = 255
LABELS[20:30, 30:40] = 0  # a hole
LABELS[40:50, 20:60] = 128


@pytest.fixture
async def client(store: Store, control: FakeControl, session: int, tmp_path: Path) -> httpx.AsyncClient:
    files = await asyncio.to_thread(particle_files, tmp_path)
    write_silhouettes(files["silhouettes.tiff"], {CameraId("c01"): ((5, 7), LABELS)}, (100, 90))
    await add(store, session, 1, measured(), files)
    return client_of(app_of(store, control))


async def test_calipers_touch_the_mesh_that_is_served(client: httpx.AsyncClient, tmp_path: Path) -> None:
    answer = await client.get("/particles/1/calipers")
    assert answer.status_code == 200, answer.text
    assert answer.headers["Content-Type"] == "application/json"
    found = TypeAdapter(Contacts).validate_json(answer.content, strict=True)
    path = tmp_path / "served.ply"
    path.write_bytes((await client.get("/particles/1/mesh.ply")).content)
    vertices = np.asarray(trimesh.load_mesh(path).vertices)
    assert found.length.value_mm == pytest.approx(np.linalg.norm(BOX_MM))
    assert found.min_feret.value_mm == pytest.approx(min(BOX_MM))
    assert found.sieve.value_mm == pytest.approx(sorted(BOX_MM)[1], rel=1e-3)
    assert found.volume_mm3 == pytest.approx(np.prod(BOX_MM))
    assert found.center_mm == pytest.approx([0, 0, 0], abs=1e-9)
    calipers = (found.length, found.width, found.thickness, found.max_feret, found.min_feret)
    for point in [place for each in calipers for place in (each.a_mm, each.b_mm)] + [*found.sieve.touches_mm]:
        assert np.linalg.norm(vertices - point, axis=1).min() < 1e-3
    assert len(found.sieve.corners_mm) == 4


async def test_an_outline_encloses_the_stone_its_holes_and_what_is_unknown(client: httpx.AsyncClient) -> None:
    answer = await client.get("/particles/1/views/c01/outline.svg")
    assert answer.status_code == 200, answer.text
    assert answer.headers["Content-Type"] == "image/svg+xml"
    assert "script" not in answer.headers["Content-Security-Policy"]
    drawing = ET.fromstring(answer.text)  # noqa: S314 - our own
    assert drawing.get("viewBox") == "0 0 100 90"
    paths = {path.get("class"): path.get("d") or "" for path in drawing.iter(f"{SVG}path")}
    assert set(paths) == {"stone", "unknown"}
    assert "stroke-dasharray" in (drawing.findtext(f"{SVG}style") or "")
    whole = np.zeros((90, 100), np.uint8)
    whole[7:67, 5:85] = LABELS
    for name, label, n_polygons in (("stone", 255, 2), ("unknown", 128, 1)):
        polygons = [
            np.array([pair.split() for pair in text.split("L")], float)
            for text in re.findall(r"M([^Z]+)Z", paths[name])
        ]
        assert len(polygons) == n_polygons
        drawn = np.zeros_like(whole)
        # the even-odd rule leaves holes, whose border is drawn upon the stone
        cv2.fillPoly(drawn, [(each - 0.5).astype(np.int32) for each in polygons], 1)
        cv2.polylines(drawn, [(each - 0.5).astype(np.int32) for each in polygons], True, 1)
        np.testing.assert_array_equal(drawn == 1, whole == label)


async def test_views_that_are_not_there_say_so(client: httpx.AsyncClient) -> None:
    assert (await client.get("/particles/1/views/c02/outline.svg")).status_code == 404  # has no silhouette
    unknown = await client.get("/particles/1/views/c99/outline.svg")
    assert json.loads(unknown.text)["type"] == "urn:stonefall:problem:unknown-camera"
