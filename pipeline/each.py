"""How the views of a bundle are worked on: one after the other, or several at a time."""

from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


class Each(Protocol):
    """`map`, or a thread pool's."""

    def __call__(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterable[Result]:
        """What the function makes of each item, in their order."""
        ...
