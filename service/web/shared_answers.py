"""Equal requests at about the same time share one answer: a result wakes hundreds of long polls that ask the same."""

import asyncio
from collections.abc import Callable, Coroutine, Hashable
from functools import partial
from typing import Any, TypeVar

T = TypeVar("T")


class SharedAnswers:
    """The answers that are being made, or were made a moment ago, by their question."""

    def __init__(self) -> None:
        self._answers: dict[Hashable, asyncio.Task[Any]] = {}

    def get(
        self, question: Hashable, make: Callable[[], Coroutine[Any, Any, T]], *, keep_s: float
    ) -> asyncio.Future[T]:
        """Return the result of `make`; the same question until `keep_s` after that shares it."""
        answer = self._answers.get(question)
        if answer is None or not _is_kept(answer, keep_s):
            answer = self._answers[question] = asyncio.create_task(make())
            answer.add_done_callback(partial(self._plan_removal, question, keep_s))
        return asyncio.shield(answer)  # others may wait for it

    def _plan_removal(self, question: Hashable, keep_s: float, answer: asyncio.Task[Any]) -> None:
        delay_s = keep_s if _is_kept(answer, keep_s) else 0
        asyncio.get_running_loop().call_later(delay_s, self._remove, question, answer)

    def _remove(self, question: Hashable, answer: asyncio.Task[Any]) -> None:
        if self._answers.get(question) is answer:
            del self._answers[question]


def _is_kept(answer: asyncio.Task[Any], keep_s: float) -> bool:
    """True while an answer is being made, and once it is made if it is kept and no error.

    One that is done and not kept is never given again: it is awaited without yielding.
    """
    return not answer.done() or (keep_s > 0 and not answer.cancelled() and answer.exception() is None)
