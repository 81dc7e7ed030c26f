"""What retention shows to clients: files that were removed, pins, consumers, the feed's beginning, recordings."""

import asyncio
import io
import tarfile
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
import trimesh
from support.outcomes import add, measured, rejected
from support.recordings import make_bundle
from support.rest import FakeControl, app_of, assert_problem, client_of, particle_files
from support.stores import folder_of

from drivers.files.compact_mesh import write_compact_mesh
from drivers.files.mesh_file import write_mesh
from drivers.files.recording import open_recording
from service.store import Store, retention
from service.store.retention import Disk, RetentionLimits, mark_files, remove_results
from service.web.settings import ApiKey, ApiSettings, Scope

LATER = datetime.now(UTC) + timedelta(days=40)
WIDE = Disk(10**12, 10**11)


async def test_a_compact_mesh_comes_in_every_format(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path
) -> None:
    body = trimesh.creation.icosphere(subdivisions=3, radius=9.0)
    write_compact_mesh(tmp_path / "mesh.sfmesh", body.vertices, body.faces)
    await add(store, session, 1, measured(), {"mesh.sfmesh": tmp_path / "mesh.sfmesh"})
    record = (await client.get("/particles/1")).json()
    assert (await client.get(f"/{record['mesh']}")).content.startswith(b"ply")
    for suffix, scale in (("ply", 1.0), ("stl", 1.0), ("glb", 1e-9)):
        content = (await client.get(f"/particles/1/mesh.{suffix}")).content
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type=suffix)
        mesh.merge_vertices()
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(body.volume * scale, rel=1e-5)
    path = folder_of(store.dir, record["id"]) / "mesh.sfmesh"
    path.write_bytes(path.read_bytes()[:-1])
    for name in ("mesh.ply", "mesh.stl", "preview.png"):
        answer = await client.get(f"/particles/1/{name}")
        assert_problem(answer, 404, "not-kept")
        assert "mesh.sfmesh is damaged: its checksum is wrong" in answer.json()["detail"]


@pytest.mark.parametrize("name", ["mesh.sfmesh", "mesh.ply"])
async def test_a_textured_mesh_has_its_greys_in_ply_glb_and_picture(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path, name: str
) -> None:
    body = trimesh.creation.icosphere(subdivisions=3, radius=9.0)
    greys = np.where(body.vertices[:, 2] > 0, 200, 10).astype(np.uint8)
    write = write_mesh if name.endswith("ply") else write_compact_mesh
    write(tmp_path / name, body.vertices, body.faces, greys)
    await add(store, session, 1, measured(), {name: tmp_path / name})
    for suffix in ("ply", "glb"):
        content = (await client.get(f"/particles/1/mesh.{suffix}")).content
        mesh = trimesh.load_mesh(io.BytesIO(content), file_type=suffix, process=False)
        assert isinstance(mesh.visual, trimesh.visual.ColorVisuals)
        np.testing.assert_array_equal(mesh.visual.vertex_colors[:, :3], np.repeat(greys[:, None], 3, axis=1))
    assert (await client.get("/particles/1/mesh.stl")).status_code == 200
    answer = await client.get("/particles/1/preview.png")
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert np.ptp(image[240, 240]) == 0, "grey, as the cameras are"
    assert image[120, 240].mean() > 2 * image[400, 240].mean()


async def test_files_that_were_removed_are_gone_and_say_why(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path
) -> None:
    await add(store, session, 1, measured(), await asyncio.to_thread(particle_files, tmp_path / "out"))
    tag = (await client.get("/particles/1/mesh.ply")).headers["ETag"]
    await store.write(mark_files, RetentionLimits(files_days=30), WIDE, LATER)
    for name in ("mesh", "mesh.stl", "preview.png", "views/c01.png", "views/c01/silhouette.png"):
        answer = await client.get(f"/particles/1/{name}", headers={"If-None-Match": tag})
        assert_problem(answer, 410, "files-removed")
        assert answer.json()["files_removed"] == "age"
    for record in (
        (await client.get("/particles/1")).json(),
        (await client.get("/results")).json()["items"][0],
        (await client.get("/particles")).json()["items"][0],
    ):
        assert (record["files_removed"], record["sieve_size_mm"]) == ("age", 20.0)


async def test_pin_and_unpin(client: httpx.AsyncClient, store: Store, session: int) -> None:
    await add(store, session, 1, rejected("empty"))
    assert (await client.get("/particles/1")).json()["is_pinned"] is False
    answer = await client.put("/particles/1/pin", json={"is_pinned": True, "reason": "complaint 7"})
    assert answer.status_code == 200
    for record in (answer.json(), (await client.get("/results")).json()["items"][0]):
        assert (record["is_pinned"], record["pin_reason"]) == (True, "complaint 7")
    answer = await client.put("/particles/1/pin", json={"is_pinned": False})
    assert (answer.json()["is_pinned"], answer.json()["pin_reason"]) == (False, None)
    assert_problem(await client.put("/particles/9/pin", json={"is_pinned": True}), 404, "unknown-particle")
    for wrong in ({}, {"is_pinned": 1}, {"is_pinned": True, "reason": "x" * 301}, {"pinned": True}):
        assert (await client.put("/particles/1/pin", json=wrong)).status_code == 422


async def test_consumers(
    client: httpx.AsyncClient, store: Store, session: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(1, 5):
        await add(store, session, number, rejected("empty"))
    assert (await client.get("/consumers")).json() == {"items": []}
    mes = (await client.put("/consumers/mes/cursor", json={"after": 1})).json()
    assert (mes["name"], mes["after"], mes["unread"], mes["is_overrun"]) == ("mes", 1, 3, False)
    assert (await client.get("/consumers")).json() == {"items": [mes]}
    assert_problem(await client.put("/consumers/mes/cursor", json={"after": 5}), 409, "cursor-ahead")

    limits = RetentionLimits(results_days=10, consumer_days=5)
    assert await store.write(remove_results, limits, LATER) == 3
    (overrun,) = (await client.get("/consumers")).json()["items"]
    assert overrun == {**mes, "is_overrun": True}
    answer = await client.get("/results?after=1")
    assert_problem(answer, 410, "cursor-expired")
    assert (answer.json()["first_seq"], answer.json()["last_seq"]) == (4, 4)
    assert "results 2 to 3 were removed: go on with after=3" in answer.json()["detail"]
    assert_problem(await client.put("/consumers/mes/cursor", json={"after": 2}), 410, "cursor-expired")
    assert [item["seq"] for item in (await client.get("/results?after=3")).json()["items"]] == [4]
    assert (await client.put("/consumers/mes/cursor", json={"after": 4})).json()["is_overrun"] is False

    monkeypatch.setattr(retention, "MAX_CONSUMERS", 1)
    assert_problem(await client.put("/consumers/more/cursor", json={"after": 4}), 409, "too-many-consumers")
    assert (await client.delete("/consumers/mes")).status_code == 204
    assert_problem(await client.delete("/consumers/mes"), 404, "unknown-consumer")
    for name, body in (("mes", {"after": -1}), ("mes", {"after": "4"}), ("mes", {}), ("a b", {"after": 4})):
        assert (await client.put(f"/consumers/{name}/cursor", json=body)).status_code == 422


async def test_while_the_store_is_held_writers_are_told_at_once(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await add(store, session, 1, rejected("empty"))
    (store.dir / "results.sqlite").unlink()
    await store.forget_gate_count(session)
    assert store.trouble is not None
    for path, body in (("particles/1/pin", {"is_pinned": True}), ("consumers/mes/cursor", {"after": 1})):
        assert (await client.put(f"/{path}", json=body)).status_code in (500, 503)


async def record(control: FakeControl, client: httpx.AsyncClient) -> None:
    await client.post("/recordings", json={"name": "r1", "count": 5})
    for number in range(1, 4):
        control.recordings.offer(make_bundle(number))
    await client.post("/recordings/r1/stop")


async def test_a_recording_is_downloaded_as_tar_and_deleted(
    client: httpx.AsyncClient, control: FakeControl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.recording.recording_tar.PIECE_BYTES", 1000)
    await record(control, client)
    answer = await client.get("/recordings/r1.tar")
    assert answer.headers["Content-Type"] == "application/x-tar"
    assert int(answer.headers["Content-Length"]) == len(answer.content)
    with tarfile.open(fileobj=io.BytesIO(answer.content)) as tar:
        tar.extractall(tmp_path / "copy")  # noqa: S202 - our own
    original = {path.name: path.read_bytes() for path in (tmp_path / "recordings/r1").rglob("*.*")}
    assert {path.name: path.read_bytes() for path in (tmp_path / "copy/r1").rglob("*.*")} == original
    assert len(open_recording(tmp_path / "copy/r1").headers) == 3

    assert (await client.delete("/recordings/r1")).status_code == 204
    assert not any((tmp_path / "recordings").iterdir())
    for gone in (await client.delete("/recordings/r1"), await client.get("/recordings/r1.tar")):
        assert_problem(gone, 404, "unknown-recording")


async def test_a_recording_under_way_is_neither_deleted_nor_downloaded(
    client: httpx.AsyncClient, control: FakeControl
) -> None:
    await client.post("/recordings", json={"name": "r1", "count": 5})
    assert_problem(await client.delete("/recordings/r1"), 409, "recording-running")
    assert_problem(await client.get("/recordings/r1.tar"), 409, "recording-running")
    await client.post("/recordings/r1/stop")


async def test_who_may_only_read_holds_and_deletes_nothing(store: Store, control: FakeControl) -> None:
    keys = (ApiKey(name="reader", sha256=sha256(b"token").hexdigest(), scopes=(Scope.READ,)),)
    async with client_of(app_of(store, control, ApiSettings(keys=keys))) as client:
        client.headers["Authorization"] = "Bearer token"
        assert (await client.get("/consumers")).status_code == 200
        for method, path, body in (
            ("PUT", "/consumers/mes/cursor", {"after": 0}),
            ("DELETE", "/consumers/mes", None),
            ("PUT", "/particles/1/pin", {"is_pinned": True}),
            ("DELETE", "/recordings/r1", None),
        ):
            assert_problem(await client.request(method, path, json=body), 403, "forbidden")
