"""Calls that may never return, of name servers and network folders: nothing waits for their threads."""

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import TypeVar, TypeVarTuple

T = TypeVar("T")
Arguments = TypeVarTuple("Arguments")


def start_abandonable(name: str, work: Callable[[*Arguments], T], *args: *Arguments) -> "asyncio.Future[T]":
    """Start `work(*args)` on a thread of its own, which the end of the process does not wait for."""
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work(*args))
        except Exception as err:  # noqa: BLE001 - raised where the future is awaited
            outcome.set_exception(err)

    outcome.set_running_or_notify_cancel()  # it cannot be cancelled any more
    Thread(target=run, name=name, daemon=True).start()
    return asyncio.wrap_future(outcome)
