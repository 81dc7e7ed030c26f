"""Products, lots and their figures over REST."""

import json
import re
import sqlite3
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from support.lots import PRODUCT, opened, put_product, stone
from support.outcomes import add, rejected, trigger
from support.rest import FakeControl, app_of, assert_problem, client_of, particle_files

from pipeline.frames import BundleKind
from pipeline.gradation.evaluation import Gradation
from pipeline.gradation.stones import Lot
from service.daemon.overview.overview_rows import Rows, overview_rows
from service.lots import evaluation, laboratory, products
from service.results.fields import RUSH
from service.results.record import lost_record
from service.store import Store
from service.store.writes import add_revision
from service.web.settings import ApiKey, ApiSettings, Scope


@pytest.fixture
async def product(client: httpx.AsyncClient) -> None:
    await put_product(client)


@pytest.mark.usefixtures("product")
async def test_a_lot_has_what_falls_while_it_is_open(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await add(store, session, 1, stone(10.0))
    answer = await opened(client, sampler="A. Miller", tonnage_t=20.0)
    assert answer.status_code == 201
    assert answer.headers["Location"] == "/api/v1/lots/L1"
    assert (await opened(client, sampler="A. Miller", tonnage_t=20.0)).json() == answer.json()
    await add(store, session, 2, stone(11.0, body="photo"))
    await add(store, session, 3, rejected("clipped"))
    await store.record_triggers(session, {"00000004": trigger(4)})  # falls now, is measured after the end
    closed = (await client.post("/lots/L1/close", json={"tonnage_t": 21.5})).json()
    assert (closed["state"], closed["tonnage_t"], closed["sampler"]) == ("closing", 21.5, "A. Miller")
    await store.finish(session, "00000004", stone(12.0, body="estimate", refinement_fallback=RUSH))
    await add(store, session, 5, stone(13.0))
    figures = (await client.get("/lots/L1/gradation")).json()
    assert (figures["triggers"], figures["measured"], figures["rejected"]) == (3, 2, 1)
    assert figures["unmeasured"]["by_reason"] == {"rejected: clipped": 1}
    assert (figures["by_body"], figures["not_refined"]) == ({"photo": 1, "estimate": 1}, {"rush": 1})
    assert figures["lot"]["n_stones"] == 3
    assert figures["product"]["specification"] == "GC85-20 8/16"
    assert figures["mass_kg"] == pytest.approx(2700e-9 * 0.6 * (11**3 + 12**3))
    (behind,) = (await client.get("/lots/L1/particles?sieve=12.5&sieve_set=en-basic-1")).json()["items"][:1]
    heaviest = (await client.get("/lots/L1/particles?limit=1")).json()
    assert (heaviest["above_mm"], heaviest["up_to_mm"]) == (0, None)
    assert heaviest["items"][0]["volume_mm3"] >= behind["volume_mm3"]
    assert (behind["seq"], behind["sieve_size_mm"]) == (4, 12.0)


@pytest.mark.usefixtures("product")
async def test_masses_of_a_lot_s_stones_are_by_its_product_and_add_up_to_its_own(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    configured = {"mass_g": 2.5, "density_kg_m3": 2500.0, "density_source": "configuration"}
    await add(store, session, 1, stone(10.0, **configured))
    await opened(client)
    for sequence, size_mm in ((2, 11.0), (3, 12.0)):
        await add(store, session, sequence, stone(size_mm, **configured))
    await add(store, session, 4, rejected("clipped"))
    again = (await client.get("/results?after=1&limit=1")).json()["items"][0]["id"]
    await store.write(add_revision, store.particles_dir, again, stone(11.5), {})
    outside, *inside, unfit, revised = (await client.get("/results")).json()["items"]
    assert {name: outside[name] for name in configured} == configured
    assert (unfit["mass_g"], unfit["density_source"]) == (None, None)
    for each in (*inside, revised):
        assert (each["density_kg_m3"], each["density_source"]) == (2700.0, "product")
        assert each["mass_g"] == pytest.approx(2700e-6 * each["volume_mm3"])
    figures = (await client.get("/lots/L1/gradation")).json()
    assert figures["mass_kg"] == pytest.approx(1e-3 * (revised["mass_g"] + inside[1]["mass_g"]))


@pytest.mark.usefixtures("product")
async def test_the_name_of_a_lot_is_safe_in_urls_shells_and_file_systems(client: httpx.AsyncClient) -> None:
    for name in (".", "..", "-rf", ".hidden", "L1.", "L/1", "L 1", "", "x" * 65):
        answer = await client.post("/lots", json={"lot": name, "product": "basalt-8-16"})
        assert_problem(answer, 422, "invalid-request")
    assert_problem(await client.put("/products/-rf", json={"title": "basalt"}), 422, "invalid-request")
    for name in ("A", "L-1.2_x"):
        assert (await client.post("/lots", json={"lot": name, "product": "basalt-8-16"})).status_code == 201
        await client.post(f"/lots/{name}/close", json={})
    answer = await client.post("/lots", json={"lot": "l-1.2_X", "product": "basalt-8-16"})
    assert_problem(answer, 409, "lot-conflict")
    assert "L-1.2_x" in answer.json()["detail"]


@pytest.mark.usefixtures("product")
async def test_stones_that_only_the_gate_counted_are_counted_everywhere(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    assert (await opened(client)).status_code == 201
    await add(store, session, 1, stone(10.0))
    gap = replace(trigger(2), n_stones=1_000_000)
    await store.record_triggers(session, {"gap": gap})
    record = lost_record(gap, bundle="gap", reason="down", detail="", calibration_id="0", is_simulated=True)
    await store.finish(session, "gap", record)
    figures = (await client.get("/lots/L1/gradation")).json()
    assert (figures["triggers"], figures["measured"], figures["lost"]) == (1_000_001, 1, 1_000_000)
    assert figures["unmeasured"]["by_reason"] == {"lost: down": 1_000_000}
    assert (await client.get("/lots/L1")).json()["n_stones"] == 1_000_001
    balance = (await client.get("/accounting")).json()
    assert (balance["triggers"], balance["lost"], balance["by_reason"]) == (1_000_001, 10**6, {"down": 10**6})
    assert (
        'stonefall_stones_total{outcome="lost",quality="",reason="down"} 1e+06'
        in (await client.get("/metrics")).text
    )
    rows = await store.read(overview_rows, session, datetime.now().astimezone(), True, Rows())
    assert rows.accounting.lost == 1_000_000
    assert rows.stones_per_min == 2  # when each of them fell is not known
    items = (await client.get("/results?fields=n_stones,outcome")).json()["items"]
    assert [(item["outcome"], item["n_stones"]) for item in items] == [("measured", 1), ("lost", 1_000_000)]


@pytest.mark.usefixtures("product")
async def test_only_one_lot_is_open_and_none_is_opened_twice(client: httpx.AsyncClient) -> None:
    await opened(client)
    assert_problem(await opened(client, "L2"), 409, "lot-conflict")
    await client.post("/lots/L1/close", json={})
    assert_problem(await opened(client), 409, "lot-conflict")
    assert (await opened(client, "L2")).status_code == 201
    assert_problem(await opened(client, "L3", product="chalk"), 404, "unknown-product")
    assert_problem(await client.post("/lots/L9/close", json={}), 404, "unknown-lot")
    assert [lot["lot"] for lot in (await client.get("/lots?state=open")).json()["items"]] == ["L2"]
    assert {lot["lot"] for lot in (await client.get("/lots")).json()["items"]} == {"L1", "L2"}
    voided = (await client.post("/lots/L1/void", json={"reason": "wrong belt"})).json()
    assert (voided["state"], voided["void_reason"]) == ("void", "wrong belt")
    assert_problem(await client.post("/lots/L1/close", json={}), 409, "lot-conflict")


@pytest.mark.usefixtures("product")
async def test_a_lot_takes_the_place_of_the_open_one_between_two_stones(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await client.put("/products/basalt-11-16", json=PRODUCT)
    await opened(client)
    await add(store, session, 1, stone(10.0))
    await add(store, session, 2, stone(11.0))
    next_lot = {"lot": "L2", "product": "basalt-11-16", "closes": "L1"}
    for wrong, status, kind in (
        ({"closes": "L0"}, 409, "lot-conflict"),
        ({"lot": "L1"}, 409, "lot-conflict"),
        ({"lot": "L 2"}, 422, "invalid-request"),
        ({"product": "no-such"}, 404, "unknown-product"),
    ):
        assert_problem(await client.post("/lots", json=next_lot | wrong), status, kind)
        assert (await client.get("/lots/L1")).json()["state"] == "open"
    answers = [(await client.post("/lots", json=next_lot)).json() for _ in range(2)]
    assert answers[0] == answers[1]
    await add(store, session, 3, stone(12.0))
    lots = (await client.get("/lots")).json()["items"]
    assert [(each["lot"], each["state"], each["n_stones"]) for each in lots] == [
        ("L2", "open", 1),
        ("L1", "closed", 2),
    ]


@pytest.mark.usefixtures("product")
async def test_stones_outside_of_a_lot_are_assigned_by_time_with_an_audit(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    for sequence in range(1, 6):
        await add(store, session, sequence, stone(10.0 + sequence))
    await opened(client)
    await add(store, session, 6, stone(20.0))
    await client.post("/lots/L1/close", json={})
    times = {"since": trigger(2).utc, "until": trigger(5).utc}
    assigned = (await client.post("/lots/L1/assign", json=times)).json()
    assert (assigned["n_assigned"], assigned["lot"]["n_stones"]) == (3, 4)
    assert (await client.post("/lots/L1/assign", json=times)).json()["n_assigned"] == 0
    entries = (await client.get("/audit?subject=L1")).json()["items"]
    assert [entry["action"] for entry in entries] == [
        "lot opened",
        "lot closed",
        "stones assigned",
        "stones assigned",
    ]
    assert entries[2]["after"]["n_stones"] == 3
    assert entries[0]["who"] == "this machine"


async def test_a_change_of_a_product_is_a_version_and_lots_keep_theirs(client: httpx.AsyncClient) -> None:
    first = (await client.put("/products/basalt-8-16", json=PRODUCT)).json()
    assert (await client.put("/products/basalt-8-16", json=PRODUCT)).json() == first
    await opened(client)
    changed = {**PRODUCT, "density_kg_m3": 2900}
    second = (await client.put("/products/basalt-8-16", json=changed)).json()
    assert (first["version"], second["version"]) == (1, 2)
    figures = (await client.get("/lots/L1/gradation")).json()
    assert (figures["product"]["version"], figures["product"]["density_kg_m3"]) == (1, 2700)
    assert (await client.get("/products/basalt-8-16?version=1")).json()["density_kg_m3"] == 2700
    assert [each["version"] for each in (await client.get("/products")).json()["items"]] == [2]
    assert_problem(await client.get("/products/basalt-8-16?version=3"), 404, "unknown-product")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"specification": "GC99"}, "specification"),
        ({"sieve_set": "my sieves"}, "sieve_set"),
        ({"flakiness_category": "FI99"}, "flakiness_category"),
        ({"lower_mm": None}, "lower_mm"),
        ({"lower_mm": 20}, "lower_mm"),
        ({"sieve_set": [4, 2]}, "sieve_set"),
        ({"density_kg_m3": 0}, "density_kg_m3"),
        ({"specification": {"name": "own", "passing": {"8": [90, 10]}}}, "specification"),
        ({"declared_grading": {"8": [50, 10]}}, "declared_grading: 8 mm.*limits 0 to 20 %"),
        ({"declared_grading": {"16 mm": [95, 5]}}, "declared_grading"),
    ],
)
async def test_a_product_that_cannot_be_judged_is_refused(
    client: httpx.AsyncClient, change: dict[str, Any], named: str
) -> None:
    answer = await client.put("/products/basalt-8-16", json={**PRODUCT, **change})
    assert_problem(answer, 422, "invalid-request")
    assert re.search(named, answer.text)
    assert (await client.get("/products")).json() == {"items": []}


@pytest.mark.usefixtures("product")
async def test_a_lot_is_found_by_the_numbers_of_the_plant(client: httpx.AsyncClient) -> None:
    numbers = {"external_id": "4500012345/10", "order": "Los 12", "customer": "BRÜ-7"}
    lot = (await opened(client, **numbers)).json()
    assert {name: lot[name] for name in numbers} == numbers
    await client.post("/lots/L1/close", json={})
    await opened(client, lot="L2")
    for name, number in numbers.items():
        found = (await client.get("/lots", params={name: number})).json()["items"]
        assert [each["lot"] for each in found] == ["L1"]
    for part, fitting in (
        ("2345/1", ["L1"]),
        ("los 1", ["L1"]),
        ("brÜ", ["L1"]),
        ("Basalt", ["L2", "L1"]),
        ("%", []),
    ):
        found = (await client.get("/lots", params={"search": part})).json()["items"]
        assert [each["lot"] for each in found] == fitting, part
    assert_problem(await client.get("/lots?search=%0A"), 422, "invalid-request")  # parts what is searched
    refused = await opened(client, lot="4500012345/10")
    assert_problem(refused, 422, "invalid-request")
    assert "external_id" in refused.json()["detail"]


async def test_a_product_is_judged_by_its_declared_grading_as_well(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    declared = {"11.2": [60, 15], "16": [100, 1]}
    await client.put("/products/basalt-8-16", json={**PRODUCT, "declared_grading": declared})
    assert (await client.get("/products/basalt-8-16")).json()["declared_grading"] == declared
    await opened(client)
    for number in range(1, 31):
        await add(store, session, number, stone(9.0 + number / 20))
    figures = (await client.get("/lots/L1/gradation")).json()
    limits = {each["sieve_mm"]: each["decision"]["limits"] for each in figures["curve"] if each["decision"]}
    spans = {sieve_mm: (found["min_percent"], found["max_percent"]) for sieve_mm, found in limits.items()}
    assert (spans[11.2], spans[16], spans[8]) == ((45, 75), (99, 100), (0, 20))
    at_d = next(each["decision"] for each in figures["curve"] if each["sieve_mm"] == 16)
    assert not at_d["asks_declaration"]  # it is there
    other = (await client.get("/lots/L1/gradation?specification=astm-7")).json()
    assert 11.2 not in [each["sieve_mm"] for each in other["curve"] if each["decision"]]


@pytest.mark.usefixtures("product")
async def test_a_lot_is_seen_through_any_sieves_and_specification(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await opened(client)
    rng = np.random.default_rng(3)
    for sequence, size_mm in enumerate(rng.uniform(8.0, 16.0, 120), start=1):
        await add(store, session, sequence, stone(float(size_mm)))
    own = (await client.get("/lots/L1/gradation")).json()
    assert own["verdict"] in ("conforms", "undecided", "does_not_conform")
    assert own["countdown"]
    below = next(step for step in own["curve"] if step["sieve_mm"] == 2.0)
    assert below["passing_percent"]["state"] == "not_measured"
    assert below["passing_percent"]["value"] is None
    sixteen = next(step for step in own["curve"] if step["sieve_mm"] == 16.0)
    assert sixteen["passing_percent"]["value"] == pytest.approx(100)
    other = (
        await client.get("/lots/L1/gradation", params={"sieve_set": "astm-c136", "specification": "astm-8"})
    ).json()
    assert other["sieve_set"] == "astm-c136"
    assert other["specification"] == "astm-8"
    assert {step["sieve_mm"] for step in other["curve"]} >= {9.5, 12.5, 19.0}
    free = (await client.get("/lots/L1/gradation?sieve_set=5,7.1,13.37,90&specification=astm-8")).json()
    assert free["sieve_set"] == "own sieves"
    sieves = {step["sieve_mm"]: step["passing_percent"]["state"] for step in free["curve"]}
    assert sieves.keys() >= {5.0, 7.1, 13.37, 90.0}
    assert (sieves[13.37] == "not_measured", sieves[90.0]) == (False, "not_measured")
    report = await client.get("/lots/L1/report.csv?sieve_set=5,7.1,13.37&specification=astm-8")
    assert "13.37" in report.text
    assert (await client.get("/lots/L1/curve.svg?sieve_set=5,7.1,13.37")).status_code == 200
    for wrong, why in (
        ("no such", "there is no 'no such'"),
        ("5,8,7.1", "must rise"),
        ("5,,8", "'': "),
        ("5,x", "'x': "),
        ("0,4", "'0': Input should be greater than 0"),
        ("4,1001", "'1001': Input should be less than or equal to 1000"),
        ("4,nan", "'nan': "),
        (",".join(map(str, range(1, 102))), "100 items"),
    ):
        refused = await client.get("/lots/L1/gradation", params={"sieve_set": wrong})
        assert_problem(refused, 422, "invalid-request")
        assert refused.json()["detail"].startswith("sieve_set: ")
        assert why in refused.json()["detail"]
    assert_problem(await client.get("/lots/L9/gradation"), 404, "unknown-lot")


async def test_windows_and_shifts_need_no_lot(client: httpx.AsyncClient) -> None:
    for path in ("/windows/current?minutes=5", "/windows/shift", "/windows/shift?ago=2"):
        figures = (await client.get(path)).json()
        assert (figures["lot"], figures["triggers"], figures["verdict"]) == (None, 0, None)
    assert_problem(await client.get("/windows/current?product=chalk"), 404, "unknown-product")


@pytest.mark.usefixtures("product")
async def test_a_balls_drops_are_in_no_lot(client: httpx.AsyncClient, store: Store, session: int) -> None:
    await opened(client)
    await store.record_triggers(session, {"00000001": trigger(1, BundleKind.BALL)})
    await store.finish(session, "00000001", stone(15.0))
    assert (await client.get("/lots/L1")).json()["n_stones"] == 0


async def test_the_audit_names_the_key(store: Store, control: FakeControl) -> None:
    key = ApiKey(
        name="mes",
        sha256="9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",  # of "test"
        scopes=(Scope.READ, Scope.OPERATE, Scope.CONFIGURE),
    )
    async with client_of(app_of(store, control, ApiSettings(keys=(key,)))) as client:
        client.headers["Authorization"] = "Bearer test"
        await client.put("/products/basalt-8-16", json=PRODUCT)
        (entry,) = (await client.get("/audit")).json()["items"]
    assert (entry["who"], entry["action"], entry["before"]) == ("key mes", "product", None)
    assert entry["after"]["title"] == PRODUCT["title"]


async def sieved_lots(
    client: httpx.AsyncClient,
    store: Store,
    session: int,
    n_lots: int,
    n_stones: int = 100,
    factor: float = 0.97,
    first: int = 1,
) -> httpx.Response:
    """Make closed lots whose stones sieves find smaller by a factor; return the answer to the first sieving."""
    rng = np.random.default_rng(4)
    answers = []
    for number in range(first, first + n_lots):
        sizes_mm = rng.uniform(6.0, 18.0, n_stones)
        await opened(client, f"L{number}")
        for sequence, size_mm in enumerate(sizes_mm, start=1000 * number):
            await add(store, session, sequence, stone(float(size_mm)))
        masses, sieved_mm = sizes_mm**3, factor * sizes_mm
        retained_g = {
            f"{sieve:g}": float(masses[(sieved_mm > sieve) & (sieved_mm <= above)].sum())
            for sieve, above in ((16, 99), (12.5, 16), (10, 12.5), (8, 10))
        }
        body = {"retained_g": retained_g, "pan_g": float(masses[sieved_mm <= 8].sum()), "by": "lab"}
        answers.append(await client.post(f"/lots/L{number}/sieving", json=body))
        await client.post(f"/lots/L{number}/close", json={})
    return answers[0]


@pytest.mark.usefixtures("product")
async def test_a_study_with_obstacles_is_no_figure(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    path = "/products/basalt-8-16/correlations"
    await sieved_lots(client, store, session, 1, n_stones=60)
    alone = (await client.post(path, json={})).json()
    few, lots, held_out = alone["obstacles"]
    assert "lot L1 has 60 measured stones" in few
    assert "1 lots, fewer than 5" in lots
    assert "no held-out error" in held_out
    refused = await client.post(f"{path}/1/accept")
    assert_problem(refused, 409, "correlation-conflict")
    assert "lot L1 has 60" in refused.json()["detail"]
    assert (await client.get("/lots/L1/gradation")).json()["correlated"] is None
    await sieved_lots(client, store, session, 5, factor=1.0, first=2)
    raw_is_as_good = (await client.post(path, json={})).json()
    assert raw_is_as_good["n_lots"] == 5, "a lot of few stones does not count where others have enough"
    (not_better,) = raw_is_as_good["obstacles"]
    assert "not less than the raw curves" in not_better
    await client.post("/lots/L2/void", json={"reason": "wrong belt"})
    assert (await client.post(path, json={})).json()["n_lots"] == 4
    twice = {"table": "Sieve mm;Passing %\n16;62\n12,5;27\n8;5", "reason": "another portion"}
    await client.post("/lots/L3/sieving", json=twice)
    assert (await client.post(path, json={})).json()["n_lots"] == 4, "portions of a lot are no further lots"
    for act, body in (("accept", None), ("withdraw", {"reason": "x"})):
        assert_problem(await client.post(f"{path}/9/{act}", json=body), 404, "unknown-correlation")
        assert_problem(
            await client.post(f"/products/no/correlations/1/{act}", json=body), 404, "unknown-product"
        )


@pytest.mark.usefixtures("product")
@pytest.mark.full
async def test_the_newest_accepted_study_is_in_use_until_it_is_withdrawn(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    path = "/products/basalt-8-16/correlations"
    await sieved_lots(client, store, session, 5)

    async def in_use() -> int | None:
        listed = (await client.get(path)).json()["items"]
        used = [each["version"] for each in listed if each["is_in_use"]]
        correlated = (await client.get("/lots/L1/gradation")).json()["correlated"]
        assert used == ([] if correlated is None else [correlated["version"]])
        return used[0] if used else None

    for _ in range(3):
        await client.post(path, json={})
    assert await in_use() is None
    for version, used in ((2, 2), (1, 2), (3, 3)):
        assert (await client.post(f"{path}/{version}/accept")).status_code == 200
        assert await in_use() == used
    gone = (await client.post(f"{path}/3/withdraw", json={"reason": "new screens"})).json()
    assert (gone["state"], gone["reason"], gone["is_in_use"]) == ("withdrawn", "new screens", False)
    assert gone["accepted_at"] is not None and gone["withdrawn_at"] is not None
    assert await in_use() == 2
    assert_problem(await client.post(f"{path}/3/accept"), 409, "correlation-conflict")
    for version in (1, 2):
        await client.post(f"{path}/{version}/withdraw", json={"reason": "new screens"})
    assert await in_use() is None


@pytest.mark.usefixtures("product")
async def test_studies_of_earlier_versions_stay_in_use(client: httpx.AsyncClient, store: Store) -> None:
    mapping = {"instrument_mm": [1.0], "sieve_mm": [0.95], "relative_se": [None]}
    figures = dict.fromkeys(("raw_rmse", "raw_bias", "rmse"), 1.0)
    held_out = dict.fromkeys(("held_out_rmse", "held_out_bias"))
    document = {"form": "factor", "mapping": mapping, "n_lots": 1, "n_points": 3, **figures, **held_out}

    def keep(connection: sqlite3.Connection) -> None:
        connection.execute(
            "INSERT INTO correlations (product, version, at, document) VALUES ('basalt-8-16', 1, ?, ?)",
            ("2026-01-01T00:00:00Z", json.dumps(document)),
        )

    await store.write(keep)
    (study,) = (await client.get("/products/basalt-8-16/correlations")).json()["items"]
    assert (study["state"], study["is_in_use"], study["obstacles"]) == ("accepted", True, [])
    await opened(client)
    assert (await client.get("/lots/L1/gradation")).json()["correlated"]["factor"] == pytest.approx(0.95)


@pytest.mark.usefixtures("product")
@pytest.mark.full
async def test_the_laboratorys_curve_and_the_correlated_one_stand_beside_the_raw_one(
    client: httpx.AsyncClient, store: Store, session: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluated: list[Lot] = []

    def evaluate(lot: Lot, *given: Any, **more: Any) -> Gradation:
        evaluated.append(lot)
        return evaluate_once(lot, *given, **more)

    evaluate_once = evaluation.evaluate
    monkeypatch.setattr(evaluation, "evaluate", evaluate)
    assert_problem(await client.post("/products/basalt-8-16/correlations", json={}), 409, "nothing-to-study")
    sieving = await sieved_lots(client, store, session, 5)
    assert sieving.status_code == 201
    assert (await client.get("/lots/L1/sieving")).json()["items"] == [sieving.json()]
    draft = (await client.post("/products/basalt-8-16/correlations", json={"form": "factor"})).json()
    assert draft["factor"] == pytest.approx(0.97, abs=0.01)
    assert (draft["state"], draft["is_in_use"], draft["obstacles"]) == ("draft", False, [])
    assert (await client.get("/lots/L1/gradation")).json()["correlated"] is None
    study = (await client.post("/products/basalt-8-16/correlations/1/accept")).json()
    assert (study["state"], study["is_in_use"], study["accepted_by"]) == ("accepted", True, "this machine")
    assert (await client.get("/products/basalt-8-16/correlations")).json()["items"] == [study]
    evaluated.clear()
    figures = (await client.get("/lots/L1/gradation")).json()
    assert len(evaluated) == 1, "an answer evaluates a lot once"
    at_ten = next(step for step in figures["correlated"]["curve"] if step["sieve_mm"] == 10.0)
    raw = next(step for step in figures["curve"] if step["sieve_mm"] == 10.0)
    found = sieving.json()["passing_percent"]["10"]
    assert abs(at_ten["passing_percent"]["value"] - found) < abs(raw["passing_percent"]["value"] - found)
    body = {"retained_g": {"16": 1.0}}
    for wrong in ({}, {**body, "table": "16;1"}, {"table": "16;-1"}, {"retained_g": {"16": -1}}):
        assert_problem(await client.post("/lots/L1/sieving", json=wrong), 422, "invalid-request")
    assert_problem(await client.post("/lots/L9/sieving", json=body), 404, "unknown-lot")


async def lot_of_uniform_stones(client: httpx.AsyncClient, store: Store, session: int, n_stones: int) -> None:
    """Open lot L1 with stones from 6 to 18 mm."""
    await opened(client)
    for sequence, size_mm in enumerate(np.linspace(6.0, 18.0, n_stones), start=1):
        await add(store, session, sequence, stone(float(size_mm)))


PLAUSIBLE = "Sieve mm;Passing %\n16;62\n12,5;27\n8;5"
SWAPPED = "Sieve mm;Passing %\n16;62\n12,5;60\n8;5"
"""A slip at 12.5 mm."""


@pytest.mark.usefixtures("product")
async def test_a_sieving_is_read_back_beside_the_instrument_before_it_is_stored(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await lot_of_uniform_stones(client, store, session, 100)
    dry = {"dry_run": True}
    read = await client.post("/lots/L1/sieving", json={"table": PLAUSIBLE, **dry})
    assert read.status_code == 200
    reading = read.json()
    assert reading["understood"] == "column 1: aperture in mm; column 2: passing in %; decimal comma"
    assert (reading["mass_g"], reading["implausible"]) == (None, None)
    curve = (await client.get("/lots/L1/gradation")).json()["curve"]
    for step in reading["sieves"]:
        own = next(each for each in curve if each["sieve_mm"] == step["sieve_mm"])["passing_percent"]
        assert step["instrument_percent"] == own
        assert step["difference"] == pytest.approx(own["value"] - step["passing_percent"])
    body = {"retained_g": {"16": 380.0, "12.5": 350.0, "8": 220.0, "2": 40.0}, "pan_g": 10.0, **dry}
    weighed = (await client.post("/lots/L1/sieving", json=body)).json()
    assert [step["retained_g"] for step in weighed["sieves"]] == [40.0, 220.0, 350.0, 380.0]
    assert weighed["sieves"][0]["instrument_percent"]["state"] == "not_measured"
    assert (weighed["sieves"][0]["difference"], weighed["mass_g"]) == (None, 1000.0)
    odd = (await client.post("/lots/L1/sieving", json={"table": SWAPPED, **dry})).json()
    assert "12.5 mm" in odd["implausible"]
    assert (await client.get("/lots/L1/sieving")).json() == {"items": []}
    assert [each["action"] for each in (await client.get("/audit?subject=L1")).json()["items"]] == [
        "lot opened"
    ]


@pytest.mark.usefixtures("product")
async def test_a_sieving_most_of_which_lies_on_its_coarsest_sieve_needs_a_reason(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    """Also of a lot with too few stones to contradict it: such a table has another order or unit."""
    await lot_of_uniform_stones(client, store, session, 3)
    asked = {"table": "Sieve mm;g\n16;930\n8;40\n4;30"}
    refused = await client.post("/lots/L1/sieving", json=asked)
    assert_problem(refused, 409, "implausible-sieving")
    assert "the coarsest sieve, 16 mm, keeps 93 % of the mass" in refused.json()["detail"]
    assert (
        await client.post("/lots/L1/sieving", json={**asked, "reason": "oversize only"})
    ).status_code == 201


@pytest.mark.usefixtures("product")
async def test_a_sieving_that_contradicts_the_instrument_needs_a_reason(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await lot_of_uniform_stones(client, store, session, 100)
    assert (await client.post("/lots/L1/sieving", json={"table": PLAUSIBLE})).status_code == 201
    refused = await client.post("/lots/L1/sieving", json={"table": SWAPPED})
    assert_problem(refused, 409, "implausible-sieving")
    assert "at 12.5 mm 60.0 % pass by the sieving, 2" in refused.json()["detail"]
    assert " 16 mm" not in refused.json()["detail"]
    kept = await client.post("/lots/L1/sieving", json={"table": SWAPPED, "reason": "sieved twice"})
    assert kept.json()["reason"] == "sieved twice"
    entries = (await client.get("/audit?subject=L1")).json()["items"]
    assert [each["after"].get("reason") for each in entries if each["action"] == "sieving"] == [
        None,
        "sieved twice",
    ]


@pytest.mark.usefixtures("product")
async def test_few_stones_contradict_no_sieving(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await lot_of_uniform_stones(client, store, session, 49)
    assert (await client.post("/lots/L1/sieving", json={"table": SWAPPED})).status_code == 201


@pytest.mark.usefixtures("product")
async def test_fractions_must_add_up_to_the_dry_mass(client: httpx.AsyncClient) -> None:
    await opened(client)
    body = {"retained_g": {"16": 600.0, "8": 395.0}, "pan_g": 1.0}
    for dry_mass_g, status in ((996.0, 201), (1005.9, 201), (986.2, 201), (1007.0, 422), (985.0, 422)):
        answer = await client.post("/lots/L1/sieving", json={**body, "dry_mass_g": dry_mass_g})
        assert answer.status_code == status, dry_mass_g
    assert "985 g" in answer.text and "996 g" in answer.text
    percents = await client.post("/lots/L1/sieving", json={"table": PLAUSIBLE, "dry_mass_g": 1000.0})
    assert_problem(percents, 422, "invalid-request")


@pytest.mark.usefixtures("product")
async def test_a_wrong_sieving_is_voided_or_replaced_and_counts_no_more(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await lot_of_uniform_stones(client, store, session, 100)
    slip = {"table": SWAPPED, "reason": "not looked at", "by": "Ann"}
    first = (await client.post("/lots/L1/sieving", json=slip)).json()["sieving"]
    right = {"table": PLAUSIBLE, "replaces": first}
    assert_problem(await client.post("/lots/L1/sieving", json=right), 422, "invalid-request")
    second = (await client.post("/lots/L1/sieving", json={**right, "reason": "a slip"})).json()
    assert (second["voided_at"], second["void_reason"], second["replaced_by"]) == (None, None, None)
    old, new = (await client.get("/lots/L1/sieving")).json()["items"]
    assert (old["void_reason"], old["replaced_by"], new) == ("a slip", second["sieving"], second)
    assert old["voided_at"] >= old["at"]
    assert_problem(
        await client.post("/lots/L1/sieving", json={**right, "reason": "again"}), 409, "sieving-void"
    )
    unknown = {**right, "replaces": 99, "reason": "again"}
    assert_problem(await client.post("/lots/L1/sieving", json=unknown), 404, "unknown-sieving")
    assert len((await client.get("/lots/L1/sieving")).json()["items"]) == 2
    report = (await client.get("/lots/L1/report.csv")).text
    assert "laboratory,passing_percent,12.5,27" in report
    assert "laboratory,passing_percent,12.5,60" not in report
    void = f"/lots/L1/sieving/{second['sieving']}/void"
    done = await client.post(void, json={"reason": "the balance was off"})
    assert (done.status_code, done.json()["void_reason"]) == (200, "the balance was off")
    assert (await client.post(void, json={"reason": "again"})).json() == done.json()
    assert "laboratory,passing_percent" not in (await client.get("/lots/L1/report.csv")).text
    study = await client.post("/products/basalt-8-16/correlations", json={})
    assert_problem(study, 409, "nothing-to-study")
    assert_problem(
        await client.post("/lots/L1/sieving/99/void", json={"reason": "x"}), 404, "unknown-sieving"
    )
    await client.post("/lots/L1/close", json={})
    await opened(client, "L2")
    other = f"/lots/L2/sieving/{first}/void"
    assert_problem(await client.post(other, json={"reason": "x"}), 404, "unknown-sieving")
    entries = (await client.get("/audit?subject=L1")).json()["items"]
    changes = [each for each in entries if each["action"] == "sieving voided"]
    assert [each["after"]["sieving"] for each in changes] == [first, second["sieving"]]
    assert changes[0]["before"]["voided_at"] is None


@pytest.mark.usefixtures("product")
async def test_the_history_of_many_lots_is_stored_as_a_whole_or_not_at_all(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await lot_of_uniform_stones(client, store, session, 100)
    await client.post("/lots/L1/close", json={})
    await opened(client, "L2")
    rows = PLAUSIBLE.splitlines()[1:]
    table = "\n".join(["Los;Sieb mm;Durchgang %", *(f"{lot};{row}" for lot in ("L1", "L2") for row in rows)])
    for lot, line in (("L9", 5), ("L1.", 5)):
        refused = await client.post("/sievings", json={"table": table.replace("L2", lot)})
        assert_problem(refused, 422, "invalid-request")
        assert f"line {line}" in refused.json()["detail"]
    slip = table.replace("L1;12,5;27", "L1;12,5;60")
    assert_problem(await client.post("/sievings", json={"table": slip}), 409, "implausible-sieving")
    assert_problem(await client.post("/sievings", json={"table": PLAUSIBLE}), 422, "invalid-request")
    dry = await client.post("/sievings", json={"table": slip, "dry_run": True})
    assert dry.status_code == 200
    assert [(each["lot"], each["implausible"] is None) for each in dry.json()["items"]] == [
        ("L1", False),
        ("L2", True),
    ]
    for lot in ("L1", "L2"):
        assert (await client.get(f"/lots/{lot}/sieving")).json()["items"] == []
    stored = await client.post("/sievings", json={"table": table, "by": "Ann"})
    assert stored.status_code == 201
    items = stored.json()["items"]
    assert [(each.pop("lot"), each["by"]) for each in items] == [
        ("L1", "Ann"),
        ("L2", "Ann"),
    ]
    for lot, item in zip(("L1", "L2"), items, strict=True):
        assert (await client.get(f"/lots/{lot}/sieving")).json()["items"] == [item]


@pytest.mark.usefixtures("product")
async def test_percents_of_a_table_are_stored_without_masses(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await opened(client)
    await add(store, session, 1, stone(10.0))
    table = {"table": "Siebweite mm;Durchgang %\n16;100\n8;45,5\n4;12"}
    stored = (await client.post("/lots/L1/sieving", json=table)).json()
    assert (stored["retained_g"], stored["pan_g"], stored["mass_g"]) == ({}, None, None)
    assert stored["passing_percent"] == {"4": 12.0, "8": 45.5, "16": 100.0}
    assert (await client.get("/lots/L1/sieving")).json()["items"] == [stored]
    for suffix in ("html", "pdf", "csv", "xlsx"):
        report = await client.get(f"/lots/L1/report.{suffix}")
        assert report.status_code == 200
    assert "45.5" in (await client.get("/lots/L1/report.csv")).text
    refused = await client.post("/lots/L1/sieving", json={"table": "Sieb;g\n16;0\n8;1.234"})
    assert_problem(refused, 422, "invalid-request")
    assert "line 3" in refused.text


@pytest.mark.usefixtures("product")
async def test_repeated_runs_of_a_sample_tell_its_repeatability(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    sizes_mm = {"L1": (10.0, 14.0), "L2": (10.2, 14.2), "L3": (10.6, 14.8), "L4": (10.9, 15.1)}
    for run, (lot, sizes) in enumerate(sizes_mm.items()):
        await opened(client, lot, sample_id="S 1", sampler="Ann" if run < 2 else "Bert")
        for number, size_mm in enumerate(sizes):
            await add(store, session, 10 * run + number, stone(size_mm))
        if run == 0:
            assert_problem(await client.get("/repeatability?sample_id=S 1"), 404, "unknown-sample")
        await client.post(f"/lots/{lot}/close", json={})
        if run == 0:
            assert_problem(await client.get("/repeatability?sample_id=S 1"), 409, "too-few-runs")
    found = (await client.get("/repeatability?sample_id=S 1&conditions=sampler")).json()
    assert [(run["lot"], run["group"]) for run in found["runs"]] == [
        ("L1", "Ann"),
        ("L2", "Ann"),
        ("L3", "Bert"),
        ("L4", "Bert"),
    ]
    d50 = found["figures"]["d50_mm"]
    values = [
        (await client.get(f"/lots/{lot}/gradation")).json()["quantiles"][2]["exact_mm"]["value"]
        for lot in sizes_mm
    ]
    within = np.sqrt((np.var(values[:2], ddof=1) + np.var(values[2:], ddof=1)) / 2)
    assert d50["repeatability_sd"] == pytest.approx(within)
    assert d50["reproducibility_sd"] > d50["between_sd"] > within
    assert d50["repeatability_limit"] == pytest.approx(2.8 * within)
    assert (await client.get("/repeatability?sample_id=S 1")).json()["figures"]["d50_mm"][
        "between_sd"
    ] is None


@pytest.mark.usefixtures("product")
async def test_a_result_names_its_lot(client: httpx.AsyncClient, store: Store, session: int) -> None:
    await add(store, session, 1, stone(10.0))
    await opened(client)
    await add(store, session, 2, stone(11.0))
    await client.post("/lots/L1/close", json={})
    assert [each["lot"] for each in (await client.get("/results")).json()["items"]] == [None, "L1"]
    assert [each["seq"] for each in (await client.get("/particles?lot=L1")).json()["items"]] == [2]
    await client.post("/lots/L1/assign", json={"since": trigger(1).utc, "until": trigger(2).utc})
    assert (await client.get("/particles/1")).json()["lot"] == "L1"


@pytest.mark.usefixtures("product")
async def test_the_report_comes_in_every_format_and_language(
    client: httpx.AsyncClient, store: Store, session: int, tmp_path: Path
) -> None:
    await opened(client, remark="=1+1 <script>alert(1)</script>")
    await add(store, session, 1, stone(12.0), particle_files(tmp_path / "files"))
    await add(store, session, 2, stone(15.0))
    begins = {"html": b"<!", "pdf": b"%PDF", "csv": "\ufeffsection;".encode(), "xlsx": b"PK"}
    for suffix, begin in begins.items():
        answer = await client.get(f"/lots/L1/report.{suffix}?language=de")
        assert answer.status_code == 200, answer.text
        assert answer.content.startswith(begin)
    page = (await client.get("/lots/L1/report", headers={"Accept": "text/html"})).text
    assert "<script>" not in page
    assert "image/png;base64" in page
    assert_problem(
        await client.get("/lots/L1/report", headers={"Accept": "text/plain"}), 406, "not-acceptable"
    )
    assert_problem(await client.get("/lots/L9/report.pdf"), 404, "unknown-lot")
    assert_problem(await client.get("/lots/L1/report.pdf?specification=none"), 422, "invalid-request")


@pytest.mark.usefixtures("product")
async def test_products_and_sievings_of_a_lot_have_a_bound(
    client: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(products, "MAX_PRODUCTS", 1)
    monkeypatch.setattr(laboratory, "MAX_SIEVINGS", 1)
    assert_problem(await client.put("/products/other", json=PRODUCT), 409, "too-many-products")
    changed = await client.put("/products/basalt-8-16", json={**PRODUCT, "title": "changed"})
    assert changed.json()["version"] == 2
    for lot in ("L1", "L2"):
        await opened(client, lot)
        for _ in range(2):
            answer = await client.post(f"/lots/{lot}/sieving", json={"retained_g": {"8": 1.0}})
        assert_problem(answer, 409, "too-many-sievings")
        assert len((await client.get(f"/lots/{lot}/sieving")).json()["items"]) == 1
        await client.post(f"/lots/{lot}/close", json={})
