"""Equal questions at about the same time share one answer, and no later one gets it."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from service.web.shared_answers import SharedAnswers


async def test_who_asks_when_an_answer_is_just_made_gets_the_next() -> None:
    """A task that is done is awaited without yielding: who asks until something changes would spin."""
    answers = SharedAnswers()
    later: list[asyncio.Task[int]] = []
    n_made = 0

    async def make() -> int:
        nonlocal n_made
        n_made += 1
        if n_made == 1:  # runs before anything that hears of the end of this task
            later.append(asyncio.create_task(ask()))
        return n_made

    async def ask() -> int:
        return await answers.get("question", make, keep_s=0)

    assert await ask() == 1
    assert await later[0] == 2


async def test_an_error_is_shared_and_not_kept() -> None:
    answers = SharedAnswers()

    async def make() -> int:
        await asyncio.sleep(0)
        raise ValueError("no answer")

    first, second = await asyncio.gather(*(_asked(answers, make) for _ in range(2)))
    assert first is second
    assert await _asked(answers, make) is not first


async def _asked(answers: SharedAnswers, make: Callable[[], Coroutine[Any, Any, int]]) -> ValueError:
    with pytest.raises(ValueError, match="no answer") as raised:
        await answers.get("question", make, keep_s=60)
    return raised.value
