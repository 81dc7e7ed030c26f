"""What tests share because it is costly, and what one that fails may leave broken: it is made anew for the next."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Generic, Self, TypeVar

import pytest

HAS_FAILED = pytest.StashKey[bool]()
"""In the stash of a test whose set-up or call has failed; `tests/conftest.py` puts it there."""

Shared = TypeVar("Shared")


class Renewed(Generic[Shared]):
    """A context manager that lends one thing to a test after the other, and replaces it after one that fails."""

    def __init__(self, make: Callable[[], AbstractContextManager[Shared]]) -> None:
        self._make = make
        self._used = ExitStack()
        self._shared: Shared

    def __enter__(self) -> Self:
        self._shared = self._used.enter_context(self._make())
        return self

    @contextmanager
    def lent_to(self, test: pytest.Item) -> Iterator[Shared]:
        """Lend it to a test; checks at the end of the test's fixture count as the test's."""
        is_whole = False
        try:
            yield self._shared
            is_whole = not test.stash.get(HAS_FAILED, False)
        finally:
            if not is_whole:
                self._used.close()
                self.__enter__()

    def __exit__(self, *_: object) -> None:
        self._used.close()
