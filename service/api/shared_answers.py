"""Equal requests at about the same time share one answer: a result wakes hundreds of long polls that ask the same."""

import asyncio
from collections.abc import Callable, Coroutine, Hashable
from typing import Any, TypeVar

T = TypeVar("T")


class SharedAnswers:
    """The answers that are being made, or were made a moment ago, by their question."""

    def __init__(self) -> None:
        self._answers: dict[Hashable, asyncio.Task[Any]] = {}

    async def get(
        self, question: Hashable, make: Callable[[], Coroutine[Any, Any, T]], *, keep_s: float
    ) -> T:
        """Return the result of `make`; the same question until `keep_s` after that shares it."""
        answer = self._answers.get(question)
        if answer is None:
            answer = self._answers[question] = asyncio.create_task(self._made(question, make, keep_s))
        return await asyncio.shield(answer)  # others may wait for it

    async def _made(self, question: Hashable, make: Callable[[], Coroutine[Any, Any, T]], keep_s: float) -> T:
        """Make the answer and remove it, or plan that, within its task: a done one is awaited without yielding."""
        try:
            answer = await make()
        except BaseException:
            del self._answers[question]
            raise
        if keep_s == 0:
            del self._answers[question]
        else:
            asyncio.get_running_loop().call_later(keep_s, self._answers.pop, question)
        return answer
