"""The protocol of `map`, by which the views of a bundle are worked on one after the other or several at a time."""

from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


class ViewMapper(Protocol):
    """A serial `map`, or that of a thread pool."""

    def __call__(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterable[Result]:
        """Return the result of `function` for each item, in the order of the items."""
        ...
