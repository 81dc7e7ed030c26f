"""Choose among the fields of a result: for a feed of under 1 kB a result, `fields=lean`."""

from collections.abc import Mapping, Sequence
from typing import Any

from service.results.fields import ALWAYS, LEAN, LEAN_FIELDS, Result, completed


class UnknownFieldsError(ValueError):
    """Fields were asked for that no result has."""

    def __init__(self, names: Sequence[str]) -> None:
        known = ", ".join(Result.model_fields)
        super().__init__(f"no result has {', '.join(map(repr, names))}; there are `{LEAN}`, {known}")


def chosen_fields(text: str) -> tuple[str, ...]:
    """Return the fields that a list like `lean,optics` names, in the order of a result; some are in every choice.

    An `UnknownFieldsError` names those that there are not.
    """
    names = {name.strip() for name in text.split(",")} - {""}
    if unknown := sorted(names - {LEAN, *Result.model_fields}):
        raise UnknownFieldsError(unknown)
    wanted = names.union(ALWAYS, LEAN_FIELDS if LEAN in names else ())
    return tuple(name for name in Result.model_fields if name in wanted)


def served(record: Mapping[str, Any], names: Sequence[str] | None) -> dict[str, Any]:
    """Return a record as it is served: with all fields, or with these alone."""
    whole = completed(record)
    return whole if names is None else {name: whole[name] for name in names}
