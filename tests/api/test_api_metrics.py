"""Metrics as Prometheus reads them, beside the answers that they must agree with; the configuration without secrets."""

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from support.outcomes import add, measured, rejected, trigger
from support.rest import SICK_HEALTH, FakeControl, app_of, client_of

from service.base.redaction import redacted
from service.configuration.settings import Settings, load_settings
from service.daemon.overview.result_delays import LIMITS_S, STAGES
from service.daemon.rest.routes.metrics import Snapshot
from service.results.fields import Verified
from service.store import Store
from service.store.accounting import OutcomeCounts, outcome_counts
from service.store.retention import RetentionLimits, remove_results
from service.web.request_times import RequestTimes
from service.web.settings import ApiSettings

ROOT = Path(__file__).parents[2]
DASHBOARD = ROOT / "deploy" / "grafana.json"
GUIDE, ALERTS = ROOT / "deploy" / "README.md", ROOT / "deploy" / "alerts.yml"


def samples_of(text: str) -> dict[str, dict[tuple[str, ...], float]]:
    """Return the values of all samples by name and by the values of their labels."""
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for family in text_string_to_metric_families(text):
        assert family.documentation
        assert family.type in ("counter", "gauge", "histogram")
        for sample in family.samples:
            values = found.setdefault(sample.name, {})
            labels = tuple(sample.labels.values())
            assert labels not in values, f"{sample.name} {labels} twice"
            values[labels] = sample.value
    return found


async def scraped(client: httpx.AsyncClient) -> dict[str, dict[tuple[str, ...], float]]:
    answer = await client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
    return samples_of(answer.text)


def counted(found: dict[str, dict[tuple[str, ...], float]]) -> dict[tuple[str, ...], float]:
    """Return the stones by outcome, quality and reason, where there are any."""
    return {labels: n for labels, n in found["stonefall_stones_total"].items() if n}


async def test_stones_are_counted_as_in_the_accounting(
    store: Store, session: int, control: FakeControl
) -> None:
    async with client_of(app_of(store, control)) as client:
        none_yet = (await scraped(client))["stonefall_stones_total"]
        assert set(none_yet.values()) == {0}
        assert {("lost", "", "queue_full"), ("measured", "degraded", "")} < none_yet.keys()
    await add(store, session, 1, measured())
    await add(store, session, 2, measured(quality="reduced"))
    await add(store, session, 3, rejected("clipped"))
    await store.begin_session({"is_replay": True})
    async with client_of(app_of(store, control)) as client:
        assert counted(await scraped(client)) == {
            ("measured", "good", ""): 1,
            ("measured", "reduced", ""): 1,
            ("rejected", "", "clipped"): 1,
        }
    await add(store, session, 4, measured())
    await store.record_triggers(session, {"open": trigger(5)})
    async with client_of(app_of(store, control)) as client:
        found = await scraped(client)
        counts = (await client.get("/accounting")).json()
    stones = found["stonefall_stones_total"]
    for outcome in ("measured", "rejected", "lost"):
        assert sum(n for labels, n in stones.items() if labels[0] == outcome) == counts[outcome]
    for reason, n in counts["by_reason"].items():
        assert sum(value for labels, value in stones.items() if labels[2] == reason) == n
    for quality, n in counts["by_quality"].items():
        assert stones["measured", quality, ""] == n
    assert found["stonefall_stones_in_progress"] == {(): counts["in_progress"]}
    assert sum(stones.values()) + counts["in_progress"] == counts["triggers"]


async def test_counts_go_on_from_the_last_time_and_forget_nothing_that_was_removed(
    store: Store, session: int
) -> None:
    known = OutcomeCounts()
    limits = RetentionLimits(results_days=1)
    later = datetime(2027, 1, 1, tzinfo=UTC)
    for sequence in range(1, 9):
        await add(store, session, sequence, measured() if sequence % 2 else rejected("empty"))
        if sequence in (1, 2, 5):
            known = await store.read(outcome_counts, known)
            assert known == await store.read(outcome_counts, OutcomeCounts())
        if sequence in (4, 7):  # those that were counted, and some that were not
            await store.write(remove_results, limits, later)
    counts = await store.read(outcome_counts, known)
    assert counts == await store.read(outcome_counts, OutcomeCounts())
    assert counts.n == {("measured", "", "good"): 4, ("rejected", "empty", ""): 4}


async def test_what_health_says_is_there_with_labels(client: httpx.AsyncClient, control: FakeControl) -> None:
    control.condition = SICK_HEALTH
    control.delays.note(0.41)
    control.delays.note(7.0)
    found = await scraped(client)
    assert found["stonefall_queue_bundles"] == {(): 3}
    assert found["stonefall_worker_restarts_total"] == {(): 1}
    assert found["stonefall_camera_armed"] == {("c01",): 1, ("c02",): 1, ("c03",): 1}
    assert found["stonefall_camera_frames_total"]["c02",] == 7
    assert "stonefall_camera_temperature_celsius" not in found  # it reports none
    assert found["stonefall_acquisition_state"]["disarmed",] == 1
    assert sum(found["stonefall_ne107_state"].values()) == 1
    assert found["stonefall_ne107_state"]["failure",] == 1
    assert found["stonefall_ready"] == {(): 0}
    assert found["stonefall_health_check"] == {("camera:c02",): 2}
    assert found["stonefall_refinement_supported_ratio"] == {(): 0.8}
    assert found["stonefall_refinement_rushed_ratio"] == {(): 0.25}
    assert found["stonefall_verification_state"]["never",] == 1
    assert found["stonefall_calibration_activated_timestamp_seconds"][()] > 1.7e9
    buckets = found["stonefall_result_delay_seconds_bucket"]
    assert [buckets[f"{limit}",] for limit in (0.4, 0.45, 5.0, 10.0)] == [0, 1, 1, 2]
    assert len(buckets) == len(LIMITS_S) + 1
    assert found["stonefall_result_delay_seconds_sum"][()] == pytest.approx(7.41)
    assert not any(name.endswith("_created") for name in found)
    assert not any(name.startswith(("python_", "process_")) for name in found)


async def test_a_store_that_cannot_be_read_does_not_silence_them(
    store: Store, session: int, control: FakeControl, state_dir: Path
) -> None:
    await add(store, session, 1, measured())
    async with client_of(app_of(store, control)) as client:
        await scraped(client)
        client._transport.app.state.context.shared._answers.clear()  # type: ignore[attr-defined]
        database = state_dir / "results.sqlite"
        database.rename(state_dir / "aside")
        found = await scraped(client)
    assert counted(found) == {("measured", "good", ""): 1}


def test_the_guide_names_every_metric_and_the_rules_name_no_other(control: FakeControl) -> None:
    facts = control.facts()
    snapshot = Snapshot(
        facts=facts,
        outcomes=OutcomeCounts(n={("measured", "", "good"): 1}),
        histograms=(control.delays.histogram, control.delays.stages, RequestTimes().histogram),
        verified=Verified.NEVER,
        last_verification=None,
    )
    families = {family.name for family in text_string_to_metric_families(generate_latest(snapshot).decode())}
    guide = GUIDE.read_text(encoding="utf-8")
    named = {re.sub(r"_total$", "", name) for name in re.findall(r"`(stonefall_\w+)`", guide)}
    assert families - named == set()
    conditional = {
        "stonefall_store_bytes",
        "stonefall_disk_days_left",
        "stonefall_verification_timestamp_seconds",
    }
    assert named - families <= conditional
    rules = re.findall(r"\b(stonefall_\w+)", ALERTS.read_text(encoding="utf-8").replace("job=", ""))
    in_rules = {re.sub(r"_(total|bucket|count)$", "", name) for name in rules}
    assert in_rules <= families | conditional
    dashboard = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    queries = [target["expr"] for panel in dashboard["panels"] for target in panel.get("targets", ())]
    shown = {
        re.sub(r"_(total|bucket|sum|count)$", "", name)
        for query in queries
        for name in re.findall(r"\bstonefall_\w+", query)
    }
    assert len(shown) > 15
    assert shown <= families | conditional


async def test_stages_and_requests_are_timed_with_bounded_labels(
    store: Store, session: int, control: FakeControl
) -> None:
    await add(store, session, 1, measured())
    control.delays.note_stages({"segment": 80.0, "store": 3.0, "total": 120.0, "of a later algorithm": 1.0})
    async with client_of(app_of(store, control)) as client:
        for path in ("/particles/1", "/particles/999", "/particles/1?x=y", "/nowhere/1", "/nowhere/2"):
            await client.get(path)
        await client.request("BREW", "/particles/1")
        await client.head("/particles/1")
        found = await scraped(client)
    stages = found["stonefall_stage_seconds_count"]
    assert {labels: n for labels, n in stages.items() if n} == {("segment",): 1, ("store",): 1}
    assert len(stages) == len(STAGES)
    assert found["stonefall_stage_seconds_bucket"]["0.1", "segment"] == 1
    assert found["stonefall_stage_seconds_sum"]["segment",] == pytest.approx(0.08)
    route = "/api/v1/particles/{particle_id}"
    assert found["stonefall_http_request_seconds_count"] == {
        ("GET", route, "2xx"): 2,
        ("GET", route, "4xx"): 2,
        ("GET", "other", "4xx"): 2,
        ("other", route, "4xx"): 1,
    }


def test_no_rule_adds_up_several_rigs() -> None:
    rules = ALERTS.read_text(encoding="utf-8")
    assert "sum without (" in rules
    assert re.findall(r"\b(?:sum|avg|min|max|count)(?: by)? ?\((?!outcome)", rules) == []


async def test_the_configuration_is_served_without_secrets(
    store: Store, control: FakeControl, tmp_path: Path
) -> None:
    path = tmp_path / "stonefall.toml"
    path.write_text(
        '[rig]\nrecording = "r"\n[spool]\ndir = "spool"\n[store]\ndir = "state"\n[[api.keys]]\nname = "mes"\n'
        f'sha256 = "{64 * "a"}"\nscopes = ["read"]\n'
    )
    settings = load_settings(path)
    control.settings = settings
    async with client_of(app_of(store, control, ApiSettings())) as client:
        answer = await client.get("/config")
    assert 64 * "a" not in answer.text
    document = answer.json()["settings"]
    assert document.keys() == Settings.model_fields.keys()
    assert document["api"]["keys"] == [{"name": "mes", "sha256": "redacted", "scopes": ["read"]}]
    assert document["store"]["keep_raw"] == settings.store.keep_raw
    assert document["measuring"]["volume_model"] is None


def test_everything_whose_name_says_so_is_redacted() -> None:
    secret = {
        "hooks": [
            {"url": "https://user:pw@mes/x/key?token=1", "signing_secret": "whsec_1", "token_file": "/t"}
        ]
    }
    assert redacted(
        {**secret, "password": None, "keys": ["a"], "keep_raw": 1, "more": {"apiToken": [1]}}
    ) == {
        "hooks": [
            {"url": "https://redacted@mes/x/redacted", "signing_secret": "redacted", "token_file": "redacted"}
        ],
        "password": None,
        "keys": ["a"],
        "keep_raw": 1,
        "more": {"apiToken": "redacted"},
    }
