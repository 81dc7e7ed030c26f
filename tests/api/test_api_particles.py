"""Particles over REST: filters, single results, meshes and images."""

import asyncio
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
import trimesh
from support.outcomes import add, measured, rejected
from support.rest import BOX_MM, GREY, particle_files
from support.stores import folder_of

from drivers.files.compact_mesh import write_compact_mesh
from service.particles.routes.particles import ParticlesPage
from service.results.fields import Result
from service.store import Store


@pytest.fixture
async def particle_id(store: Store, session: int, tmp_path: Path) -> str:
    """Store a measured box with all its files; return its id."""
    files = await asyncio.to_thread(particle_files, tmp_path / "out")
    seq = await add(store, session, 1, measured(), files)
    return f"{store.instance_id[:8]}-{seq:08d}"


async def listed(client: httpx.AsyncClient, **params: Any) -> list[int]:
    answer = await client.get("/particles", params=params)
    assert answer.status_code == 200, answer.text
    return [item.seq for item in ParticlesPage.model_validate(answer.json(), strict=True).items]


async def test_list_with_filters_and_cursor(client: httpx.AsyncClient, store: Store, session: int) -> None:
    for i in range(1, 6):
        await add(store, session, i, measured(sieve_size_mm=4.0 * i, quality="good" if i % 2 else "reduced"))
    await add(store, session, 6, rejected("empty"))
    assert await listed(client) == [6, 5, 4, 3, 2, 1]
    assert await listed(client, outcome="rejected") == [6]
    assert await listed(client, quality="reduced") == [4, 2]
    assert await listed(client, kind="ball") == []
    assert await listed(client, min_sieve_size_mm=8, max_sieve_size_mm=16) == [4, 3, 2]
    # stone i was captured at i minutes past 23:00 UTC
    assert await listed(client, since="2026-03-01T00:02:00+01:00", until="2026-02-28T23:04:00Z") == [3, 2]
    first = (await client.get("/particles", params={"limit": 4})).json()
    second = (await client.get("/particles", params={"limit": 4, "cursor": first["next_cursor"]})).json()
    assert [item["seq"] for item in first["items"] + second["items"]] == [6, 5, 4, 3, 2, 1]
    assert second["next_cursor"] is None


async def test_filters_by_form_uncertainty_and_what_measured_it(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    flat = {"zingg_class": "disc", "min_feret_mm": 6.0, "max_feret_mm": 19.0, "sieve_size_mm": 15.0}
    round_ = {"zingg_class": "equant", "min_feret_mm": 12.0, "max_feret_mm": 36.0, "sieve_size_mm": 15.0}
    tiny = {**flat, "sieve_size_mm": 3.0}  # below the fractions of EN 933-3 and the range of EN 933-4
    doubtful = {"quality": "reduced", "quality_causes": ["pixels", "focus"], "volume_sd_percent": 3.0}
    await add(store, session, 1, measured(**flat, **doubtful, body="estimate", algorithm_version="11"))
    await add(
        store, session, 2, measured(**round_, volume_sd_percent=0.5, body="photo", algorithm_version="12")
    )
    await add(store, session, 3, measured(**tiny, volume_sd_percent=9.0))
    await add(store, session, 4, rejected("empty"))
    for query, seqs in (
        ("zingg_class=disc", [3, 1]),
        ("is_flaky=true", [1]),
        ("is_flaky=false", [2]),
        ("is_non_cubical=true", [1]),
        ("is_non_cubical=false", [2]),  # three times is not more than three times
        ("min_volume_sd_percent=3", [3, 1]),
        ("max_volume_sd_percent=3", [2, 1]),
        ("quality_cause=focus", [1]),
        ("quality_cause=noise", []),
        ("algorithm_version=12", [2]),
        ("body=estimate&quality=reduced&min_sieve_size_mm=10", [1]),
    ):
        assert await listed(client, **dict(each.split("=") for each in query.split("&"))) == seqs, query


@pytest.mark.parametrize(
    "query",
    [
        "zingg_class=square",
        "quality_cause=mood",
        "body=soul",
        "min_volume_sd_percent=-1",
        "outcome=open",
        "min_sieve_size_mm=nan",
        "since=yesterday",
        "since=0001-01-01T00:00:00%2B14:00",
        "cursor=x",
    ],
)
async def test_filters_are_checked(client: httpx.AsyncClient, query: str) -> None:
    assert (await client.get(f"/particles?{query}")).status_code == 422


async def test_one_by_id_and_by_seq(client: httpx.AsyncClient, particle_id: str) -> None:
    by_id, by_seq = await client.get(f"/particles/{particle_id}"), await client.get("/particles/1")
    assert by_id.json() == by_seq.json()
    result = Result.model_validate(by_id.json(), strict=True)
    assert (result.id, result.seq, result.min_box_mm) == (particle_id, 1, [30.0, 20.0, 10.0])


@pytest.mark.parametrize(
    ("accept", "media_type"),
    [
        (None, "model/ply"),
        ("*/*", "model/ply"),
        ("model/stl", "model/stl"),
        ("text/html, model/*;q=0.5, model/gltf-binary", "model/gltf-binary"),
        ("model/ply;q=0, model/*", "model/stl"),
        ("text/html", None),
        ("*/*;q=0", None),
        ("model/stl;q=high", None),
    ],
)
async def test_the_mesh_as_accepted(
    client: httpx.AsyncClient, particle_id: str, accept: str | None, media_type: str | None
) -> None:
    client.headers.pop("accept")
    answer = await client.get(f"/particles/{particle_id}/mesh", headers={"Accept": accept} if accept else {})
    assert answer.headers["Vary"] == "Accept"
    if media_type is None:
        assert (answer.status_code, answer.json()["type"]) == (406, "urn:stonefall:problem:not-acceptable")
    else:
        assert (answer.status_code, answer.headers["Content-Type"]) == (200, media_type)


@pytest.mark.parametrize(
    ("suffix", "extents"),
    [("ply", BOX_MM), ("stl", BOX_MM), ("glb", (0.010, 0.030, 0.020))],  # glTF: metres, y up
)
async def test_the_mesh_by_suffix(
    client: httpx.AsyncClient, particle_id: str, suffix: str, extents: tuple[float, ...]
) -> None:
    answer = await client.get(f"/particles/{particle_id}/mesh.{suffix}")
    mesh = trimesh.load_mesh(BytesIO(answer.content), file_type=suffix)
    np.testing.assert_allclose(mesh.extents, extents, rtol=1e-6)
    mesh.merge_vertices()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(np.prod(extents), rel=1e-5)  # positive: not turned inside out


async def test_the_mesh_address_of_the_record(client: httpx.AsyncClient, particle_id: str) -> None:
    address = (await client.get(f"/particles/{particle_id}")).json()["mesh"]
    answer = await client.get(f"/{address}")
    assert answer.content.startswith(b"ply")
    assert answer.headers["Content-Type"] == "model/ply"


async def test_views_and_silhouettes(client: httpx.AsyncClient, particle_id: str) -> None:
    for camera, grey in GREY.items():
        answer = await client.get(f"/particles/{particle_id}/views/{camera}.png")
        assert answer.headers["Content-Type"] == "image/png"
        image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
        assert image is not None
        np.testing.assert_array_equal(image, np.full((6, 8), grey))
        answer = await client.get(f"/particles/{particle_id}/views/{camera}/silhouette.png")
        labels = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(labels, np.full((6, 8), grey // 2))


async def test_a_picture_is_drawn_unless_it_came_with_its_stone(
    client: httpx.AsyncClient, store: Store, particle_id: str
) -> None:
    for query, size_px in (("", 480), ("?size_px=240", 240)):
        address = f"/particles/{particle_id}/preview.png{query}"
        answer = await client.get(address)
        image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert image.shape == (size_px, size_px, 3)
        blue, _, red = image[size_px // 2, size_px // 2].astype(int)
        assert red > blue  # a warm grey: the channels are not swapped
        kept = folder_of(store.dir, particle_id) / f"preview-{size_px}.png"
        assert not kept.exists()  # the store alone writes there
        kept.write_bytes(b"kept" + answer.content)
        assert (await client.get(address)).content == b"kept" + answer.content
        kept.write_bytes(answer.content[:-100])  # torn by a power cut
        assert (await client.get(address)).content == answer.content
    assert (await client.get(f"/particles/{particle_id}/preview.png?size_px=9000")).status_code == 422


async def test_the_preview_of_a_mesh_is_small_closed_and_where_the_mesh_is(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path
) -> None:
    full = trimesh.creation.icosphere(subdivisions=6, radius=9.0)
    greys = np.full(len(full.vertices), 77, np.uint8)
    write_compact_mesh(tmp_path / "mesh.sfmesh", full.vertices, full.faces, greys)
    await add(store, session, 1, measured(), {"mesh.sfmesh": tmp_path / "mesh.sfmesh"})
    whole = await client.get("/particles/1/mesh.glb")
    for path in ("mesh.glb", "mesh.ply", "mesh.stl"):
        answer = await client.get(f"/particles/1/{path}?detail=preview")
        preview = trimesh.load_mesh(BytesIO(answer.content), file_type=path[-3:])
        unit = 1000 if path == "mesh.glb" else 1
        assert preview.is_watertight
        assert 1500 < len(preview.vertices) < 3500
        assert preview.volume * unit**3 == pytest.approx(full.volume, rel=0.01)
        assert answer.headers["ETag"] != (await client.get(f"/particles/1/{path}")).headers["ETag"]
    small = await client.get("/particles/1/mesh.glb?detail=preview")
    assert len(small.content) < 130_000 < len(whole.content) / 10
    colors = trimesh.load_mesh(BytesIO(small.content), file_type="glb").visual.vertex_colors
    assert (colors[:, :3] == 77).all()


async def test_files_may_be_cached_for_ever(client: httpx.AsyncClient, particle_id: str) -> None:
    paths = [
        "mesh.ply",
        "mesh.stl",
        "mesh.glb",
        "preview.png",
        "preview.png?size_px=240",
        "mesh.glb?detail=preview",
        "calipers",
        "views/c01.png",
        "views/c01/silhouette.png",
    ]
    paths.append("views/c01/outline.svg")
    answers = [await client.get(f"/particles/{particle_id}/{path}") for path in paths]
    tags = [answer.headers["ETag"] for answer in answers]
    assert len(set(tags)) == len(tags)
    for path, answer, tag in zip(paths, answers, tags, strict=True):
        of_item = await client.get(f"/particles/1/{path}")  # by its seq: an id may get a revision
        assert "immutable" in of_item.headers["Cache-Control"]
        assert ("immutable" in answer.headers["Cache-Control"]) == (path == "views/c01.png")
        assert of_item.headers["ETag"] == tag
        again = await client.get(
            f"/particles/{particle_id}/{path}", headers={"If-None-Match": f'"other", W/{tag}'}
        )
        assert (again.status_code, again.content) == (304, b"")


async def test_what_was_not_kept_says_why(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path
) -> None:
    await add(store, session, 1, rejected("multiple").model_copy(update={"views": ["c01"]}))
    for path in (
        "mesh",
        "preview.png",
        "calipers",
        "views/c01.png",
        "views/c01/silhouette.png",
        "views/c01/outline.svg",
    ):
        problem = (await client.get(f"/particles/1/{path}")).json()
        assert problem["type"] == "urn:stonefall:problem:not-kept"
        assert (problem["status"], problem["outcome"], problem["reason"]) == (404, "rejected", "multiple")

    files = await asyncio.to_thread(particle_files, tmp_path / "out")
    await add(store, session, 2, measured(), files)
    missing = (await client.get("/particles/2/views/c03.png")).json()
    assert "the view is missing: lost" in missing["detail"]
    archive = folder_of(store.dir, f"{store.instance_id[:8]}-00000002") / "bundle.tiff"
    archive.write_bytes(archive.read_bytes()[:100])
    damaged = await client.get("/particles/2/views/c01.png")
    assert (damaged.status_code, damaged.json()["type"]) == (404, "urn:stonefall:problem:not-kept")
    assert str(store.particles_dir) not in damaged.text


@pytest.mark.parametrize("damage", ["garbage", "cut", "no faces", "not finite", "wrong corners"])
async def test_a_damaged_mesh_is_not_kept(
    client: httpx.AsyncClient, store: Store, particle_id: str, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = folder_of(store.dir, particle_id) / "mesh.ply"
    whole = path.read_bytes()
    head, corner = whole.index(b"end_header\n") + 11, np.array([77], "<i4").tobytes()
    content = {
        "garbage": b"garbage",
        "cut": whole[:-5],
        "no faces": whole[: head + 8 * 12].replace(b"element face 12", b"element face 0"),
        "not finite": whole[:head] + np.array([np.nan], "<f4").tobytes() + whole[head + 4 :],
        "wrong corners": whole[:-4] + corner,
    }[damage]
    path.write_bytes(content)
    for name in ("mesh.stl", "mesh.glb", "preview.png"):
        answer = await client.get(f"/particles/{particle_id}/{name}")
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:stonefall:problem:not-kept")
        problem = "has 8 points and no faces" if damage == "no faces" else "is damaged"
        assert f"mesh.ply {problem}" in answer.json()["detail"]
    assert "Traceback" not in caplog.text


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/particles/99", 404),
        ("/particles/00000000-00000001", 404),
        ("/particles/1/views/c09.png", 404),
        ("/particles/1/mesh.exe", 422),
        ("/particles/%2e%2e", 422),
        ("/particles/%2e%2e%2f%2e%2e%2fresults.sqlite", 404),
        ("/particles/..%5cresults/mesh.ply", 422),
        ("/particles/1%00/mesh", 422),
        ("/particles/1/views/..%2f..%2fmesh.png", 404),
        ("/particles/1/views/%2e%2e/silhouette.png", 422),
        ("/particles/1/views/..%5c..%5cmesh.ply%00.png", 422),
    ],
)
async def test_nothing_else_can_be_reached(
    client: httpx.AsyncClient, particle_id: str, path: str, status: int
) -> None:
    request = client.build_request("GET", "/")
    request.url = request.url.copy_with(raw_path=f"/api/v1{path}".encode())  # httpx would tidy it up
    answer = await client.send(request)
    assert (answer.status_code, answer.headers["Content-Type"]) == (status, "application/problem+json")
