"""A feed for one outlet: its cursor is stored when what it leads to was delivered, and not before."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.fake_feed import FakeFeed, Refusal, serving

from service.bridge.client import BridgeClient
from service.bridge.feeds import BridgeError, feed
from service.bridge.reference_client import Pauses, Position

OPTIONS: dict[str, Any] = {"pauses": Pauses(outage=(0.01,), refused=0.02, parking=0.0), "wait_s": 0}


@pytest.fixture
def daemon() -> Iterator[FakeFeed]:
    with serving(FakeFeed(last_seq=5)) as daemon:
        yield daemon


def stored(file: Path) -> Position | None:
    return Position(**json.loads(file.read_text())) if file.exists() else None


async def test_a_step_is_stored_when_the_next_is_asked_for(daemon: FakeFeed, tmp_path: Path) -> None:
    file = tmp_path / "outlet" / "results.cursor"
    steps = feed(BridgeClient(daemon.url), file, consumer="bridge-mqtt", **OPTIONS)
    step = await anext(steps)
    assert [item["seq"] for item in step.items] == [1, 2, 3, 4, 5]
    assert stored(file) is None  # it is not delivered yet
    assert daemon.parked == {"bridge-mqtt": 0}
    daemon.last_seq = 6
    step = await anext(steps)
    assert [item["seq"] for item in step.items] == [6]
    assert stored(file) == Position("aaaaaaaa", 5)
    await steps.aclose()
    assert stored(file) == Position("aaaaaaaa", 5)  # whether the second was delivered is not known
    steps = feed(BridgeClient(daemon.url), file, **OPTIONS)
    assert [item["seq"] for item in (await anext(steps)).items] == [6]
    await steps.aclose()


async def test_an_error_while_it_is_delivered_brings_the_step_again(daemon: FakeFeed, tmp_path: Path) -> None:
    file = tmp_path / "results.cursor"
    delivered: list[int] = []

    async def deliver(n_good: int) -> None:
        async for step in feed(BridgeClient(daemon.url), file, **OPTIONS):
            if len(delivered) == n_good:
                raise ConnectionError("the broker is away")
            delivered.extend(item["seq"] for item in step.items)
            daemon.last_seq += 5

    with pytest.raises(ConnectionError):
        await deliver(10)
    assert stored(file) == Position("aaaaaaaa", 10)
    with pytest.raises(ConnectionError):
        await deliver(15)
    assert delivered == list(range(1, 16))


async def test_troubles_of_the_daemon_are_logged_and_waited_for(
    daemon: FakeFeed, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    daemon.next_answers.extend([Refusal(503, "busy", {"Retry-After": "0"}), Refusal(401, "unauthorized")])
    steps = feed(BridgeClient(daemon.url), tmp_path / "results.cursor", **OPTIONS)
    assert (await anext(steps)).position == Position("aaaaaaaa", 5)
    await steps.aclose()
    assert "401 unauthorized" in caplog.text


async def test_gaps_and_another_store_are_steps(daemon: FakeFeed, tmp_path: Path) -> None:
    file = tmp_path / "results.cursor"
    daemon.first_seq = 3
    file.write_text(json.dumps({"instance_id": "aaaaaaaa", "after": 0}))
    steps = feed(BridgeClient(daemon.url), file, **OPTIONS)
    step = await anext(steps)
    assert step.gap is not None and (step.gap.first_seq, step.gap.last_seq) == (1, 2)
    daemon.instance_id, daemon.first_seq, daemon.last_seq = "bbbbbbbb", 1, 2
    step = await anext(steps)
    assert (step.position, step.items) == (Position("bbbbbbbb", 0), ())
    step = await anext(steps)
    assert [item["id"] for item in step.items] == ["bbbbbbbb-00000001", "bbbbbbbb-00000002"]
    await steps.aclose()


async def test_events_are_followed_by_the_same_rules(daemon: FakeFeed, tmp_path: Path) -> None:
    item = {"seq": 1, "type": "lot.opened", "subject": "L-7", "data": {}, "at": ""}
    page = {"instance_id": "aaaaaaaa", "first_seq": 1, "last_seq": 1, "next_after": 1, "items": [item]}
    daemon.documents["/events"] = page
    steps = feed(BridgeClient(daemon.url), tmp_path / "events.cursor", feed="events", fields=None, **OPTIONS)
    assert (await anext(steps)).items == (item,)
    await steps.aclose()
    assert "fields" not in daemon.asked[-1][1]


@pytest.mark.parametrize("content", ["", "[]", '{"instance_id": 1', '{"place": 3}'])
async def test_a_file_that_is_no_cursor_is_named(content: str, daemon: FakeFeed, tmp_path: Path) -> None:
    file = tmp_path / "results.cursor"
    file.write_text(content)
    with pytest.raises(BridgeError, match=r"results.cursor is no cursor .* all results come again"):
        await anext(feed(BridgeClient(daemon.url), file, **OPTIONS))


async def test_a_folder_that_cannot_be_written_is_named(daemon: FakeFeed, tmp_path: Path) -> None:
    (tmp_path / "results.new").mkdir()  # where the cursor is written first
    steps = feed(BridgeClient(daemon.url), tmp_path / "results.cursor", **OPTIONS)
    await anext(steps)
    with pytest.raises(BridgeError, match=r"results\.cursor: Is a directory"):
        await anext(steps)
