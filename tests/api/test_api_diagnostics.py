"""`GET /diagnostics`: scope, content, and that it is made once for all who ask."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.configurations import KEY, KEY_SHA256, REPLAY
from support.diagnostics import files_of
from support.rest import FakeControl, app_of, client_of

from service.configuration.settings import load_settings
from service.daemon.diagnostics.diagnostic_inputs import diagnostic_inputs
from service.store import Store
from service.store.keys import sha256_of
from service.web.settings import ApiKey, ApiSettings, Scope


@pytest.fixture
def diagnosed(store: Store, control: FakeControl, tmp_path: Path) -> FakeControl:
    path = tmp_path / "stonefall.toml"
    path.write_text(REPLAY + KEY)
    control.diagnosed = replace(diagnostic_inputs(load_settings(path)), store_dir=store.dir)
    return control


async def test_it_has_what_the_daemon_says_and_no_secret(store: Store, diagnosed: FakeControl) -> None:
    async with client_of(app_of(store, diagnosed, ApiSettings())) as client:
        answer = await client.get("/diagnostics")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/gzip"
    texts = files_of(answer.content)
    assert json.loads(texts["health.json"])["ne107"] == diagnosed.health().ne107
    assert len(json.loads(texts["cameras.json"])) == len(diagnosed.cameras())
    assert "stonefall_ready" in texts["metrics.txt"]
    assert json.loads(texts["store.json"])["instance_id"] == store.instance_id
    assert json.loads(texts["configuration.json"])["api"]["keys"][0]["name"] == "mes"
    assert KEY_SHA256 not in "".join(texts.values())
    assert "no daemon runs" not in texts["missing.txt"]


async def test_it_needs_the_scope_configure(store: Store, diagnosed: FakeControl) -> None:
    keys = tuple(
        ApiKey(name=scope, sha256=sha256_of(f"token-{scope}"), scopes=(scope,))
        for scope in (Scope.READ, Scope.CONFIGURE)
    )
    async with client_of(app_of(store, diagnosed, ApiSettings(keys=keys))) as client:
        statuses = [
            (await client.get("/diagnostics", headers={"Authorization": f"Bearer token-{scope}"})).status_code
            for scope in (Scope.READ, Scope.CONFIGURE)
        ]
        assert (await client.get("/diagnostics")).status_code == 401
    assert statuses == [403, 200]
