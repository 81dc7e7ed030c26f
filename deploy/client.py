"""Follow the results of stonefall without losing or doubling one: the reference client, in one file.

    python client.py http://127.0.0.1:8080 --db stones.sqlite [--key-file FILE] [--consumer NAME] [--seconds N]

It needs Python 3.11 and its standard library. Take it as it is, or import it and store the steps elsewhere:

    for step in follow(Client("http://127.0.0.1:8080"), position):
        ...  # store step.items, step.position and step.gap in one transaction: the next is asked for afterwards
"""

import argparse
import json
import math
import os
import sqlite3
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

PAGE = 1000
"""Results that are asked for at a time, the most that the daemon gives."""
ANSWER_S = 30.0
"""Longest wait for an answer, beyond the time that a long poll may take."""
FEEDS = {"results": ("id", "outcome"), "events": ("type",)}
"""The feeds that can be followed, and what each of their items has."""


class ClientError(Exception):
    """A request that failed. `is_passing`: it is worth repeating soon, as nothing is wrong with it."""

    is_passing = True
    kind = ""
    retry_after_s: float | None = None


class NoAnswerError(ClientError):
    """No answer, a torn one, or one that is not stonefall's: the network, a restart, another program."""


class ProblemError(ClientError):
    """The daemon refuses; `kind` is the last part of the problem's type, such as `cursor-expired`."""

    def __init__(self, status: int, problem: Mapping[str, Any], retry_after: str | None) -> None:
        self.kind = str(problem.get("type", "")).rpartition(":")[2]
        super().__init__(f"{status} {self.kind}: {problem.get('detail', 'no reason was given')}")
        self.status = status
        self.problem = problem
        self.retry_after_s = float(retry_after) if retry_after and retry_after.isdigit() else None
        self.is_passing = status in (429, 502, 503, 504) or self.kind == "request-in-progress"


@dataclass(frozen=True)
class Position:
    """Position of a client: the history of results that it follows, and its cursor there."""

    instance_id: str | None = None
    after: int = 0


@dataclass(frozen=True)
class Gap:
    """Results of a history that were removed before they were read."""

    instance_id: str
    first_seq: int
    last_seq: int


@dataclass(frozen=True)
class Step:
    """Outcome of one request: results, a new position, or the trouble that prevented them."""

    position: Position
    items: tuple[dict[str, Any], ...] = ()
    gap: Gap | None = None
    trouble: ClientError | None = None


@dataclass(frozen=True)
class Pauses:
    """Times to wait, s: after each failure in a row, after a refusal that needs an operator, between parkings."""

    outage: tuple[float, ...] = (1, 2, 4, 8, 10)
    refused: float = 30
    parking: float = 5


class Client:
    """Asks one daemon, over a connection that is kept. Every call raises `NoAnswerError` or `ProblemError`."""

    def __init__(self, url: str, key_file: Path | None = None) -> None:
        """The key file holds the token; it is read for each request, so that a key can be exchanged."""
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or parts.hostname is None:
            raise ValueError(f"{url}: must be an address such as http://127.0.0.1:8080")
        make = HTTPSConnection if parts.scheme == "https" else HTTPConnection
        self._connection = make(parts.hostname, parts.port)
        self._base = f"{parts.path.rstrip('/')}/api/v1"
        self._key_file = key_file
        self._key_sent = ""

    def close(self) -> None:
        self._connection.close()

    def get(self, path: str, timeout_s: float = ANSWER_S, **query: object) -> dict[str, Any]:
        return self.ask("GET", f"{path}?{urlencode(query)}", timeout_s=timeout_s)

    def post(
        self, path: str, body: Mapping[str, Any], key: str | None = None, patience_s: float = 60
    ) -> dict[str, Any]:
        """Send until there is an answer, all with one `Idempotency-Key`: it is carried out once.

        Give your own key, stored beside your order, if the order is to outlive this process; a new one for each order.
        """
        headers = {"Idempotency-Key": key or str(uuid.uuid4())}
        end_s = time.monotonic() + patience_s
        while True:
            try:
                return self.ask("POST", path, body, headers)
            except ClientError as err:
                pause_s = 1.0 if err.retry_after_s is None else err.retry_after_s
                if not err.is_passing or time.monotonic() + pause_s > end_s:
                    raise
                time.sleep(pause_s)

    def page(
        self, after: int, wait_s: float, fields: str | None, feed: str = "results"
    ) -> tuple[str, list[dict[str, Any]]]:
        """Return the history and its items after a cursor, as soon as there is one or `wait_s` are over."""
        query: dict[str, object] = {"after": after, "limit": PAGE, "wait_s": round(wait_s, 3)}
        if fields is not None:
            query["fields"] = fields
        page = self.get(f"/{feed}", timeout_s=wait_s + ANSWER_S, **query)
        try:
            instance_id, items, next_after = str(page["instance_id"]), list(page["items"]), page["next_after"]
            seqs = [after, *(int(item["seq"]) for item in items)]
            is_whole = all(item[name] for item in items for name in FEEDS[feed])
        except (KeyError, TypeError, ValueError) as err:
            raise NoAnswerError(f"the answer is no page of the feed: {err!r}") from err
        is_in_order = next_after == seqs[-1] and all(a < b for a, b in pairwise(seqs))
        if not is_whole or not is_in_order:
            raise NoAnswerError(f"the answer is no page of the feed after {after}")
        return instance_id, items

    def park(self, consumer: str, after: int) -> None:
        """Park the cursor of a named consumer: the daemon keeps for longer what comes after."""
        self.ask("PUT", f"/consumers/{quote(consumer)}/cursor", {"after": after})

    def ask(
        self,
        method: str,
        path: str,
        body: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        timeout_s: float = ANSWER_S,
    ) -> dict[str, Any]:
        sent = {"Accept": "application/json", **(headers or {})}
        if key := self.key():
            sent["Authorization"] = f"Bearer {key}"
        self._key_sent = key
        if body is not None:
            sent["Content-Type"] = "application/json"
        connection = self._connection
        try:
            connection.timeout = timeout_s
            if connection.sock is not None:
                connection.sock.settimeout(timeout_s)
            connection.request(method, self._base + path, None if body is None else json.dumps(body), sent)
            answer = connection.getresponse()
            content = answer.read()
        except (OSError, HTTPException) as err:
            connection.close()
            raise NoAnswerError(f"no answer: {err or type(err).__name__}") from err
        try:
            document = json.loads(content)
        except ValueError:
            document = None
        if not 200 <= answer.status < 300:
            problem = document if isinstance(document, dict) else {"detail": answer.reason}
            raise ProblemError(answer.status, problem, answer.getheader("Retry-After"))
        if not isinstance(document, dict):
            connection.close()
            raise NoAnswerError("the answer is incomplete, or not stonefall's")
        return document

    def key(self) -> str:
        """Return the token as the key file has it now, empty if there is none that can be read."""
        try:
            key = "" if self._key_file is None else self._key_file.read_text(encoding="ascii").strip()
        except (OSError, ValueError):
            return ""
        return key if key.isprintable() else ""  # more than a line: no header can have it

    def pause(self, seconds: float) -> None:
        """Wait, but not for longer than the key stays the one that was sent last."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0 and self.key() == self._key_sent:
            time.sleep(min(left_s, 1.0))


def follow(
    client: Client,
    position: Position,
    *,
    consumer: str | None = None,
    fields: str | None = "lean",
    wait_s: float = 20.0,
    seconds: float = math.inf,
    pauses: Pauses = Pauses(),
    feed: str = "results",
) -> Iterator[Step]:
    """Yield the results after a position, for `seconds`, through failures of the network, the daemon and its store.

    Or the items of another one of `FEEDS`: of the events, which have no `fields`, and no cursor that is parked.

    A step is to be durable before the next one is asked for. Then nothing is lost, whenever this process is killed.
    Results come at least once, and a stone that was measured again comes again under its `id`, with the next
    `revision` and a higher `seq`: so `id` must be a key where they are stored, and the newest takes its place.
    """
    end_s = time.monotonic() + seconds
    asked = position.after  # or beyond it, when what follows it has expired
    n_failed, parked, park_s = 0, -1, 0.0
    while (left_s := end_s - time.monotonic()) > 0:
        if consumer is not None and position.after != parked and time.monotonic() >= park_s:
            park_s = time.monotonic() + pauses.parking
            try:
                client.park(consumer, position.after)
                parked = position.after
            except ClientError as err:
                if not err.is_passing and not err.kind.startswith("cursor-"):  # those are seen below, too
                    park_s = time.monotonic() + pauses.refused
                    yield Step(position, trouble=err)
        try:
            instance_id, items = client.page(asked, min(wait_s, left_s), fields, feed)
        except ClientError as err:
            first_seq = err.problem.get("first_seq") if isinstance(err, ProblemError) else None
            if err.kind == "cursor-expired" and isinstance(first_seq, int) and first_seq - 1 > asked:
                asked = first_seq - 1  # 410: what is left begins there
                continue
            if err.kind == "cursor-ahead" and asked > 0:
                asked = 0  # 409: another store, whose instance_id the next answer tells
                continue
            yield Step(position, trouble=err)
            pause_s = (
                pauses.outage[min(n_failed, len(pauses.outage) - 1)] if err.is_passing else pauses.refused
            )
            pause_s = pause_s if err.retry_after_s is None else err.retry_after_s
            client.pause(max(min(pause_s, end_s - time.monotonic()), 0.0))
            n_failed += 1
            continue
        n_failed = 0
        if position.instance_id not in (None, instance_id):
            position, asked = Position(instance_id), 0  # a new store, or a backup: all of it is read again
            yield Step(position)
            continue
        gap = Gap(instance_id, position.after + 1, asked) if asked > position.after else None
        position = Position(instance_id, items[-1]["seq"] if items else asked)
        asked = position.after
        yield Step(position, tuple(items), gap)


class Database:
    """The example of a MES: stones, cursor and gaps in one SQLite file."""

    def __init__(self, path: Path) -> None:
        self._connection = sqlite3.connect(path, timeout=60)
        self._connection.executescript(
            """
            PRAGMA journal_mode = WAL;
            PRAGMA synchronous = FULL;
            -- instance_id: the history that had the stone last; those of an earlier one were lost with their store
            CREATE TABLE IF NOT EXISTS stones (
                id TEXT NOT NULL PRIMARY KEY, instance_id TEXT NOT NULL, seq INTEGER NOT NULL, outcome TEXT NOT NULL,
                record TEXT NOT NULL);
            CREATE TABLE IF NOT EXISTS gaps (instance_id TEXT NOT NULL, first_seq INTEGER NOT NULL, last_seq INTEGER);
            CREATE TABLE IF NOT EXISTS cursor (place INTEGER PRIMARY KEY CHECK (place = 0), instance_id TEXT, after);
            INSERT OR IGNORE INTO cursor VALUES (0, NULL, 0);
            """
        )

    def position(self) -> Position:
        return Position(*self._connection.execute("SELECT instance_id, after FROM cursor").fetchone())

    def store(self, step: Step) -> None:
        """Store all of a step or nothing; a stone that is there already is only brought up to date.

        So of a stone that was measured again the newest revision is left, and it is counted once.
        """
        stones = [
            (item["id"], step.position.instance_id, item["seq"], item["outcome"], json.dumps(item))
            for item in step.items
        ]
        with self._connection:  # one transaction
            self._connection.executemany(
                "INSERT INTO stones VALUES (?, ?, ?, ?, ?) ON CONFLICT (id) DO UPDATE SET"
                " instance_id = excluded.instance_id, seq = excluded.seq, outcome = excluded.outcome,"
                " record = excluded.record"
                " WHERE excluded.instance_id IS NOT stones.instance_id OR excluded.seq >= stones.seq",
                stones,
            )
            if step.gap is not None:
                gap = (step.gap.instance_id, step.gap.first_seq, step.gap.last_seq)
                self._connection.execute("INSERT INTO gaps VALUES (?, ?, ?)", gap)
            cursor = (step.position.instance_id, step.position.after)
            self._connection.execute("UPDATE cursor SET instance_id = ?, after = ?", cursor)

    def summary(self) -> str:
        """Return in words what there is."""
        n_stones, n_current = self._connection.execute(
            "SELECT count(*), total(instance_id IS (SELECT instance_id FROM cursor)) FROM stones"
        ).fetchone()
        (n_gaps,) = self._connection.execute("SELECT count(*) FROM gaps").fetchone()
        older = f", {n_stones - int(n_current)} of earlier histories" if n_stones > n_current else ""
        return f"{n_stones} results{older}, cursor at {self.position().after}, {n_gaps} gaps"

    def close(self) -> None:
        self._connection.close()


def deliver(client: Client, handle: Callable[[Step], None], cursor_file: Path, **options: Any) -> None:
    """Call a function with each step, and keep the position in a file: for receivers without transactions.

    After a kill in between the last step comes again: `id` and `revision` tell what was handled before.
    """
    position = kept_position(cursor_file)
    for step in follow(client, position, **options):
        handle(step)
        if step.position != position:
            position = step.position
            keep_position(cursor_file, position)


def kept_position(cursor_file: Path) -> Position:
    """Return the position that is kept in a file, the beginning if there is none."""
    return Position(**json.loads(cursor_file.read_text())) if cursor_file.exists() else Position()


def keep_position(cursor_file: Path, position: Position) -> None:
    """Put a position in the place of the one that is kept; a kill or a power cut leaves either of them."""
    unfinished = cursor_file.with_suffix(".new")
    with unfinished.open("w") as file:
        json.dump(asdict(position), file)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(cursor_file)


class Reporter:
    """Reports to a person: each trouble, its end, gaps, another store."""

    def __init__(self, position: Position, say: Callable[[str], object]) -> None:
        self._say, self._position, self._trouble = say, position, ""

    def note(self, step: Step) -> None:
        if step.trouble is not None:
            if not step.trouble.is_passing or not self._trouble:  # a refusal again and again
                self._say(f"{step.trouble}; the cursor stays at {step.position.after}")
            self._trouble = str(step.trouble)
            return
        if self._trouble:
            self._say("answered again")
        self._trouble = ""
        if self._position.instance_id not in (None, step.position.instance_id):
            self._say(f"another store or a restored one, {step.position.instance_id}: from its beginning")
        if (gap := step.gap) is not None:
            self._say(f"GAP: results {gap.first_seq} to {gap.last_seq} were removed before they were read")
        self._position = step.position


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("url", help="such as http://127.0.0.1:8080")
    parser.add_argument("--db", type=Path, required=True, help="SQLite file; made if there is none")
    parser.add_argument(
        "--key-file", type=Path, help="file with the token of a key; may be exchanged meanwhile"
    )
    parser.add_argument("--consumer", help="name under which the cursor is parked; needs the scope operate")
    parser.add_argument(
        "--fields", default="lean", help="of each result: lean, or names separated by commas, or all"
    )
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="end after so long; otherwise with Ctrl-C"
    )
    arguments = parser.parse_args()
    fields = None if arguments.fields == "all" else arguments.fields
    database = Database(arguments.db)
    reporter = Reporter(database.position(), lambda text: print(text, file=sys.stderr, flush=True))
    client = Client(arguments.url, arguments.key_file)
    try:
        for step in follow(
            client,
            database.position(),
            consumer=arguments.consumer,
            fields=fields,
            seconds=arguments.seconds,
        ):
            if step.trouble is None:
                database.store(step)
            reporter.note(step)
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        client.close()
        print(database.summary())
        database.close()


if __name__ == "__main__":
    main()
