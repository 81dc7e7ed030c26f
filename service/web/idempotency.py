"""A POST with an `Idempotency-Key` is carried out once; repeated, it gets the first answer again.

The rules are those of the IETF draft "The Idempotency-Key HTTP Header Field". A key belongs to who asks: `require`
begins the attempt when it knows that, so a client that may no longer write gets no old answer. An answer is durable
before it is sent. If the daemon dies between the change and that, no answer is known and the request is carried out
as a new one: a lot that is open already is returned as it is, a closed or void one stays so, a name that was taken
is a 409 which says so. What has no name, a sieving or a correlation, is there twice then, and both are in the
audit.
"""

import asyncio
import hashlib
import re
from collections.abc import Sequence

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.store import Store
from service.store.answers import Answer, find_answer, keep_answer, n_answers
from service.web.problems import Problem, invalid_request

HEADER = "Idempotency-Key"
KEY = re.compile(r"[\x21-\x7e]{1,128}")
REPLAYED = "Idempotent-Replayed"
KEPT_HEADERS = ("content-type", "location", "etag")
MAX_KEPT = 10_000
"""Answers of a day that are kept for one client; beyond, new keys are refused rather than old ones forgotten."""
WAIT_S = 2.0
"""Longest wait for the first request with this key, and for a disk that does not take its answer."""
NOT_KEPT = frozenset({401, 403, 429})
"""Answers that depend on more than the request; so do all from 500 on."""


class AnsweredBeforeError(Exception):
    """The same request was answered before."""

    def __init__(self, answer: Answer) -> None:
        super().__init__(answer.status)
        self.answer = answer


def keeping_answers(app: ASGIApp, store: Store) -> ASGIApp:
    """Keep the answers of `app` to POSTs with an idempotency key, and give them again."""
    under_way: dict[tuple[str, str], GuardedRequest] = {}

    async def kept_answers(scope: Scope, receive: Receive, send: Send) -> None:
        key = Headers(scope=scope).get(HEADER)
        if key is None or scope["method"] != "POST":
            await app(scope, receive, send)
            return
        attempt = GuardedRequest(store, under_way, key)
        scope.setdefault("state", {})["attempt"] = attempt
        messages: list[Message] = []

        async def hold(message: Message) -> None:
            messages.append(message)

        try:
            await app(scope, receive, hold)
            await attempt.keep(messages)
        except AnsweredBeforeError as error:
            attempt.end()
            before = error.answer
            response = Response(before.body, before.status, headers={**before.headers, REPLAYED: "true"})
            await response(scope, receive, send)
            return
        except BaseException:
            attempt.end()
            raise
        for message in messages:
            await send(message)

    return kept_answers


class GuardedRequest:
    """One request with an idempotency key; at most one of each key is carried out at a time."""

    def __init__(self, store: Store, under_way: dict[tuple[str, str], "GuardedRequest"], key: str) -> None:
        self._store = store
        self._under_way = under_way
        self._key = key
        self._place: tuple[str, str] | None = None  # in `under_way`
        self._digest = ""
        self._is_first = False
        self._ended = asyncio.Event()

    async def begin(self, who: str, request: Request) -> None:
        """Return if the request is to be carried out.

        Raises `AnsweredBeforeError` when it was carried out before, `Problem` when the key is not valid, was used for
        another request, or its first request is still under way.
        """
        if not KEY.fullmatch(self._key):
            raise invalid_request((f"header.{HEADER}", "must be 1 to 128 visible ASCII characters"))
        self._store.require_writable()
        self._digest = await _digest(request)
        place = (who, self._key)
        deadline_s = asyncio.get_running_loop().time() + WAIT_S
        while (first := self._under_way.get(place)) is not None:
            self._require_same(first._digest)
            try:
                async with asyncio.timeout_at(deadline_s):
                    await first._ended.wait()
            except TimeoutError:
                detail = f"the first request with the key {self._key!r} is still being carried out"
                raise Problem(409, "request-in-progress", detail, retry_after_s=1) from None
        self._place = place
        self._under_way[place] = self
        if (answer := await self._store.read(find_answer, who, self._key)) is not None:
            self._require_same(answer.request)
            raise AnsweredBeforeError(answer)
        if await self._store.read(n_answers, who) >= MAX_KEPT:
            detail = f"{MAX_KEPT} answers of the last 24 h are kept for {who}: send no key, or come again"
            raise Problem(429, "too-many-keys", detail, retry_after_s=3600)
        self._is_first = True

    async def keep(self, messages: Sequence[Message]) -> None:
        """Keep the answer in `messages`, unless it depends on more than the request, and end the attempt."""
        answer = _answer_in(messages, self._digest)
        if self._place is None or not self._is_first or answer.status in NOT_KEPT or answer.status >= 500:
            self.end()
            return
        keeping = asyncio.ensure_future(self._store.write(keep_answer, *self._place, answer))
        keeping.add_done_callback(self._kept)
        await asyncio.wait([keeping], timeout=WAIT_S)  # what was done is told, though the disk refuses this

    def end(self) -> None:
        """Let others with the same key go on."""
        if self._place is not None and self._under_way.get(self._place) is self:
            del self._under_way[self._place]
        self._ended.set()

    def _kept(self, keeping: "asyncio.Future[None]") -> None:
        if not keeping.cancelled():
            keeping.exception()  # the store has logged why
        self.end()

    def _require_same(self, digest: str) -> None:
        if digest != self._digest:
            detail = f"the key {self._key!r} was used for another request: a new request needs a new key"
            raise Problem(422, "idempotency-key-reused", detail)


async def begin_attempt(request: Request) -> None:
    """Begin the attempt of a request with an idempotency key, now that it is known who asks."""
    attempt: GuardedRequest | None = getattr(request.state, "attempt", None)
    if attempt is not None:
        await attempt.begin(request.state.who, request)


async def _digest(request: Request) -> str:
    """Return the SHA-256 of method, path, query and body."""
    line = f"{request.method} {request.scope['path']}?{request.url.query}\n"
    return hashlib.sha256(line.encode() + await request.body()).hexdigest()


def _answer_in(messages: Sequence[Message], digest: str) -> Answer:
    start = messages[0]
    headers = Headers(raw=start["headers"])
    return Answer(
        request=digest,
        status=start["status"],
        headers={name: headers[name] for name in KEPT_HEADERS if name in headers},
        body=b"".join(message.get("body", b"") for message in messages[1:]),
    )
