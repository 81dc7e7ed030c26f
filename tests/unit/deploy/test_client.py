"""The reference client against a feed that refuses, tears its answers, loses results, and is replaced."""

import json
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from support.eventually import eventually
from support.fake_feed import FakeFeed, Other, Refusal, Torn, serving
from support.reference_client import PATH, client, start_client

PAUSES = client.Pauses(outage=(0.01,), refused=0.02, parking=0.0)
PATIENCE_S = 60.0


CONNECTED: list[Any] = []
"""Clients of a test, which are closed before its server."""


def connect(feed: FakeFeed, key_file: Path | None = None) -> Any:
    CONNECTED.append(client.Client(feed.url, key_file))
    return CONNECTED[-1]


@pytest.fixture
def feed() -> Iterator[FakeFeed]:
    with serving(FakeFeed(last_seq=5)) as feed:
        yield feed
        while CONNECTED:
            CONNECTED.pop().close()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Any]:
    database = client.Database(tmp_path / "stones.sqlite")
    yield database
    database.close()


def stored(path: Path, instance_id: str | None = None) -> list[tuple[str, int, dict[str, Any]]]:
    """Return id, number and record of each stone in a client's store, in order."""
    connection = sqlite3.connect(path)
    rows = connection.execute(
        "SELECT id, seq, record, instance_id FROM stones ORDER BY instance_id, seq"
    ).fetchall()
    connection.close()
    return [(row[0], row[1], json.loads(row[2])) for row in rows if instance_id in (None, row[3])]


def gaps(path: Path) -> list[tuple[Any, ...]]:
    connection = sqlite3.connect(path)
    rows = connection.execute("SELECT * FROM gaps").fetchall()
    connection.close()
    return rows


def expected(feed: FakeFeed, after: int = 0) -> list[tuple[str, int, dict[str, Any]]]:
    return [(item["id"], item["seq"], item) for item in feed.items(after)]


def follow_until(
    feed: FakeFeed,
    database: Any,
    is_enough: Callable[[Any], bool],
    key_file: Path | None = None,
    **options: Any,
) -> list[Any]:
    """Follow and store until a step is enough; return all steps."""
    steps = []
    source = connect(feed, key_file)
    for step in client.follow(
        source, database.position(), wait_s=0, pauses=PAUSES, seconds=PATIENCE_S, **options
    ):
        steps.append(step)
        if step.trouble is None:
            database.store(step)
        if is_enough(step):
            return steps
    raise AssertionError(f"never enough: {steps[-3:]}")


def has_all(feed: FakeFeed) -> Callable[[Any], bool]:
    return lambda step: step.position == client.Position(feed.instance_id, feed.last_seq)


@pytest.mark.parametrize(
    "answer",
    [
        *(Torn(share) for share in (0, 0.3, 0.999)),
        Other(b""),
        Other(b'{"instance_id": "aaaaaaaa", "items": [{"seq": 1'),
        Other(b"<html>The plant's proxy</html>"),
        Other(b"[]"),
        Other(b'{"instance_id": "aaaaaaaa", "next_after": 9, "items": []}'),
        Other(b'{"instance_id": "aaaaaaaa", "next_after": 2, "items": [{"seq": 2, "outcome": "lost"}]}'),
        Other(
            b'{"instance_id": "aaaaaaaa", "next_after": 1, "items":'
            b' [{"seq": 1, "id": "a", "outcome": "lost"}, {"seq": 1, "id": "b", "outcome": "lost"}]}'
        ),
        Refusal(502, ""),
        Refusal(503, "not-ready"),
        Refusal(503, "busy", {"Retry-After": "0"}),
        Refusal(429, "too-many-attempts", {"Retry-After": "0"}),
        Refusal(500, "internal-error"),
        Refusal(403, "forbidden"),
        Refusal(404, ""),
    ],
    ids=str,
)
def test_what_is_no_page_is_asked_for_again(
    answer: Any, feed: FakeFeed, database: Any, tmp_path: Path
) -> None:
    feed.next_answers.append(answer)
    steps = follow_until(feed, database, has_all(feed))
    assert [step.trouble is None for step in steps] == [False, True]
    feed.last_seq = 7
    feed.next_answers.extend([answer] * 3)
    steps = follow_until(feed, database, has_all(feed))
    assert [step.trouble is None for step in steps] == [False, False, False, True]
    assert stored(tmp_path / "stones.sqlite") == expected(feed)


def test_a_backlog_comes_in_big_pages(feed: FakeFeed, database: Any, tmp_path: Path) -> None:
    feed.last_seq = 2 * client.PAGE + 3
    steps = follow_until(feed, database, has_all(feed))
    assert [len(step.items) for step in steps] == [client.PAGE, client.PAGE, 3]
    assert stored(tmp_path / "stones.sqlite") == expected(feed)
    assert all("fields=lean" in path for _, path, _ in feed.asked)


def test_it_waits_as_long_as_it_is_told(feed: FakeFeed, database: Any) -> None:
    feed.next_answers.append(Refusal(503, "busy", {"Retry-After": "1"}))
    follow_until(feed, database, has_all(feed))
    source = connect(feed)
    paused: list[float] = []
    source.pause = paused.append
    feed.next_answers += [
        Refusal(503, "busy", {"Retry-After": "17"}),
        *[Torn(0)] * 3,
        Refusal(401, "unauthorized"),
        Refusal(503, "store-unavailable"),
    ]
    pauses = client.Pauses(outage=(1, 2), refused=30)
    for step in client.follow(source, database.position(), pauses=pauses):
        if step.trouble is None:
            break
    assert paused == [17, 2, 2, 2, 30, 2]


def test_another_store_is_read_from_its_beginning(feed: FakeFeed, database: Any, tmp_path: Path) -> None:
    path = tmp_path / "stones.sqlite"
    follow_until(feed, database, has_all(feed))
    old = expected(feed)
    for feed.instance_id, feed.last_seq in (
        ("bbbbbbbb", 3),
        ("cccccccc", 8),
    ):  # 409, then an answer without one
        steps = follow_until(feed, database, has_all(feed))
        assert not any(step.trouble or step.gap for step in steps)
        assert stored(path, feed.instance_id) == expected(feed)
    assert stored(path, "aaaaaaaa") == old
    assert gaps(path) == []


def test_a_restored_backup_doubles_nothing(feed: FakeFeed, database: Any, tmp_path: Path) -> None:
    path = tmp_path / "stones.sqlite"
    follow_until(feed, database, has_all(feed))
    before = feed.items(0)

    def items(after: int, limit: int = 0) -> list[dict[str, Any]]:
        """Return three that the backup has, of the old name, and two that came since."""
        feed.last_seq = 7
        new = [feed.item(seq) for seq in (6, 7)]
        return [item for item in before[:3] + new if item["seq"] > after]

    feed.instance_id = "bbbbbbbb"
    feed.items = items  # type: ignore[method-assign]
    feed.last_seq = 7
    follow_until(feed, database, has_all(feed))
    assert [(id_, seq) for id_, seq, _ in stored(path, "bbbbbbbb")] == [
        *((f"aaaaaaaa-{seq:08d}", seq) for seq in (1, 2, 3)),
        *((f"bbbbbbbb-{seq:08d}", seq) for seq in (6, 7)),
    ]
    assert [seq for _, seq, _ in stored(path, "aaaaaaaa")] == [4, 5]  # lost with the store, kept here
    assert len(stored(path)) == 7


def test_expired_results_are_a_gap_that_is_told(feed: FakeFeed, database: Any, tmp_path: Path) -> None:
    path = tmp_path / "stones.sqlite"
    follow_until(feed, database, has_all(feed))
    feed.first_seq, feed.last_seq = 9, 12
    follow_until(feed, database, has_all(feed))
    assert gaps(path) == [("aaaaaaaa", 6, 8)]
    assert [seq for _, seq, _ in stored(path)] == [1, 2, 3, 4, 5, 9, 10, 11, 12]
    # all of it went
    feed.first_seq, feed.last_seq = 21, 20
    follow_until(feed, database, has_all(feed))
    assert gaps(path)[1:] == [("aaaaaaaa", 13, 20)]
    # another store, which has forgotten its beginning
    feed.instance_id, feed.first_seq, feed.last_seq = "bbbbbbbb", 24, 30
    follow_until(feed, database, has_all(feed))
    assert gaps(path)[2:] == [("bbbbbbbb", 1, 23)]
    assert stored(path, "bbbbbbbb") == expected(feed, after=23)


def test_a_gap_is_not_told_twice_and_its_results_not_lost_when_the_answer_after_it_is(
    feed: FakeFeed, database: Any, tmp_path: Path
) -> None:
    feed.first_seq = 3
    feed.next_answers += [Torn(0), Torn(0.5), Torn(0.5)]
    steps = follow_until(feed, database, has_all(feed))
    assert [step.gap for step in steps if step.gap] == [client.Gap("aaaaaaaa", 1, 2)]
    assert gaps(tmp_path / "stones.sqlite") == [("aaaaaaaa", 1, 2)]
    assert stored(tmp_path / "stones.sqlite") == expected(feed, after=2)


def test_a_wrong_key_is_told_again_and_again_until_there_is_another(
    feed: FakeFeed, database: Any, tmp_path: Path
) -> None:
    feed.key, key_file = "right", tmp_path / "key"
    said: list[str] = []
    reporter = client.Reporter(client.Position(), said.append)
    steps = client.follow(connect(feed, key_file), client.Position(), wait_s=0, pauses=PAUSES)
    for key in (None, "wrong", "two\nlines"):
        if key is not None:
            key_file.write_text(f"{key}\n")
        reporter.note(next(steps))
    key_file.write_text("right\n")
    reporter.note(next(steps))
    assert said == [*["401 unauthorized: no key; the cursor stays at 0"] * 3, "answered again"]


@pytest.mark.parametrize("looked_at", [["new"], ["old", "new"]], ids=["before the pause", "in the pause"])
def test_a_key_that_is_new_since_the_answer_ends_a_long_pause(feed: FakeFeed, looked_at: list[str]) -> None:
    feed.key = "new"
    asking = connect(feed)
    keys = iter(["old", *looked_at])
    asking.key = lambda: next(keys)
    with pytest.raises(client.ProblemError):
        asking.get("/results")
    asking.pause(3600)


def test_a_step_that_was_not_stored_comes_again(feed: FakeFeed, database: Any, tmp_path: Path) -> None:
    source = connect(feed)
    (step,) = islice(client.follow(source, database.position(), wait_s=0), 1)
    broken = client.Step(step.position, (*step.items, {"id": None, "seq": 6, "outcome": "measured"}))
    with pytest.raises(sqlite3.IntegrityError):
        database.store(broken)
    assert database.position() == client.Position()
    assert stored(tmp_path / "stones.sqlite") == []
    follow_until(feed, database, has_all(feed))
    assert stored(tmp_path / "stones.sqlite") == expected(feed)


def test_a_consumer_parks_what_it_has_stored(feed: FakeFeed, database: Any) -> None:
    follow_until(feed, database, lambda _: feed.parked.get("mes") == 5, consumer="mes")
    parkings = [body["after"] for body in feed.bodies]
    assert parkings == [0, 5]


def test_a_consumer_without_the_scope_is_told_and_follows_on(
    feed: FakeFeed, database: Any, tmp_path: Path
) -> None:
    feed.next_answers.append(Refusal(403, "forbidden"))
    steps = follow_until(feed, database, has_all(feed), consumer="mes")
    assert [step.trouble and step.trouble.status for step in steps] == [403, None]
    assert stored(tmp_path / "stones.sqlite") == expected(feed)


def test_a_post_is_repeated_with_one_key_and_refused_once(feed: FakeFeed) -> None:
    asking = connect(feed)
    feed.next_answers += [
        Torn(0.5),
        Refusal(503, "busy", {"Retry-After": "0"}),
        Refusal(409, "request-in-progress", {"Retry-After": "0"}),
    ]
    asking.post("/lots", {"lot": "L-1"})
    keys = {headers["Idempotency-Key"] for _, _, headers in feed.asked}
    assert (len(feed.asked), len(keys)) == (4, 1)
    asking.post("/lots", {"lot": "L-2"})
    asking.post("/lots", {"lot": "L-3"}, key="mine")
    assert feed.asked[-1][2]["Idempotency-Key"] == "mine"
    assert feed.asked[-2][2]["Idempotency-Key"] not in keys
    feed.next_answers += [Refusal(409, "lot-conflict")]
    with pytest.raises(client.ProblemError) as refused:
        asking.post("/lots", {"lot": "L-4"})
    assert (refused.value.status, refused.value.kind) == (409, "lot-conflict")


def test_of_a_stone_that_was_measured_again_the_newest_is_left(
    feed: FakeFeed, database: Any, tmp_path: Path
) -> None:
    path = tmp_path / "stones.sqlite"

    def items(after: int, limit: int = 0) -> list[dict[str, Any]]:
        """Return five stones, and as 6 and 8 revisions of the second, as 7 one of the fourth."""
        all_ = [feed.item(seq) for seq in range(1, feed.last_seq + 1)]
        for seq, first, revision in ((6, 2, 2), (7, 4, 2), (8, 2, 3)):
            if seq <= feed.last_seq:
                changed = {
                    "id": all_[first - 1]["id"],
                    "revision": revision,
                    "revises": seq - 2 * (revision - 1),
                }
                all_[seq - 1] |= changed | ({"outcome": "rejected"} if seq == 7 else {})
        return [item for item in all_ if item["seq"] > after]

    feed.items = items  # type: ignore[method-assign]
    for feed.last_seq in (5, 6, 8):
        follow_until(feed, database, has_all(feed))
    assert [(id_[-1], seq) for id_, seq, _ in stored(path)] == [
        ("1", 1),
        ("3", 3),
        ("5", 5),
        ("4", 7),
        ("2", 8),
    ]
    assert outcomes(path) == {
        "1": "measured",
        "2": "measured",
        "3": "measured",
        "4": "rejected",
        "5": "measured",
    }
    assert database.summary() == "5 results, cursor at 8, 0 gaps"

    old = client.Step(
        client.Position("aaaaaaaa", 8), (items(1)[0],)
    )  # comes again, as after a kill of a receiver
    database.store(old)
    assert stored(path)[-1][1] == 8
    feed.instance_id = "bbbbbbbb"  # a backup of before the revisions: what it says counts
    feed.last_seq = 5
    restored = [item | {"id": item["id"].replace("bbbbbbbb", "aaaaaaaa")} for item in items(0)]
    feed.items = lambda after, limit=0: restored[after:]  # type: ignore[method-assign]
    follow_until(feed, database, has_all(feed))
    assert [seq for _, seq, _ in stored(path)] == [1, 2, 3, 4, 5]
    assert set(outcomes(path).values()) == {"measured"}


def outcomes(path: Path) -> dict[str, str]:
    """Return the outcome of each stone by the last digit of its id."""
    connection = sqlite3.connect(path)
    rows = connection.execute("SELECT id, outcome FROM stones").fetchall()
    connection.close()
    return {id_[-1]: outcome for id_, outcome in rows}


def test_a_receiver_without_transactions_goes_on_after_what_it_has_handled(
    feed: FakeFeed, tmp_path: Path
) -> None:
    handled: list[int] = []

    def handle(step: Any) -> None:
        handled.extend(item["seq"] for item in step.items)
        if step.items and step.items[0]["seq"] == 6 and handled.count(6) == 1:
            raise RuntimeError("killed")
        if handled[-1:] == [feed.last_seq] and not step.items:
            raise KeyboardInterrupt

    asking, cursor = connect(feed), tmp_path / "cursor.json"
    with pytest.raises(KeyboardInterrupt):
        client.deliver(asking, handle, cursor, wait_s=0)
    feed.last_seq = 8
    with pytest.raises(RuntimeError):
        client.deliver(asking, handle, cursor, wait_s=0)
    with pytest.raises(KeyboardInterrupt):
        client.deliver(asking, handle, cursor, wait_s=0)
    assert handled == [1, 2, 3, 4, 5, 6, 7, 8, 6, 7, 8]


def test_the_command_follows_until_its_time_is_over_and_says_what_it_has(
    feed: FakeFeed, tmp_path: Path
) -> None:
    path = tmp_path / "stones.sqlite"
    command = [sys.executable, PATH, feed.url, "--db", path, "--seconds", "0.5", "--fields", "all"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=PATIENCE_S)
    assert (done.stdout, done.stderr) == ("5 results, cursor at 5, 0 gaps\n", "")
    assert stored(path) == expected(feed)
    assert not any("fields" in asked for _, asked, _ in feed.asked)


def test_the_command_ends_with_ctrl_c_and_goes_on_later(feed: FakeFeed, tmp_path: Path) -> None:
    path = tmp_path / "stones.sqlite"
    for feed.last_seq in (5, 9):
        process = start_client(feed.url, path)
        eventually(lambda: path.exists() and is_stored(path, feed.last_seq), PATIENCE_S)
        process.send_signal(2)
        assert process.wait(PATIENCE_S) == 130
    assert path.with_suffix(".log").read_text().splitlines() == [
        "5 results, cursor at 5, 0 gaps",
        "9 results, cursor at 9, 0 gaps",
    ]
    feed.last_seq = 0  # nothing is asked for from the beginning again
    assert stored(path)[0][1] == 1


def is_stored(path: Path, n: int) -> bool:
    try:
        return len(stored(path)) == n
    except sqlite3.OperationalError:  # no table yet
        return False


@pytest.mark.parametrize("url", ["127.0.0.1:8080", "ftp://127.0.0.1", "http://", ""])
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="must be an address"):
        client.Client(url)
