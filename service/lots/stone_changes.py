"""The same stones as measured twice, one by one: how much each figure differs, and for which stones most."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from math import sqrt
from typing import Any

from pipeline.measuring.shape import ShapeMeasurement
from service.results.fields import Outcome

Records = Mapping[str, Mapping[str, Any]]
"""Records by the id of the stone."""


class Group(StrEnum):
    """Figures that have a limit in common."""

    VOLUME = "volume"
    SIEVE = "sieve"
    AXES = "axes"
    SHAPE = "shape"


FORM_FACTORS = tuple(
    each.name
    for each in fields(ShapeMeasurement)
    if each.type is float and not each.name.endswith(("_mm", "_mm2", "_mm3"))
)
"""Measures of the shape that are numbers without a unit."""
FIELDS = {
    "volume_mm3": Group.VOLUME,
    "sieve_size_mm": Group.SIEVE,
    **dict.fromkeys(("length_mm", "width_mm", "thickness_mm", "max_feret_mm", "min_feret_mm"), Group.AXES),
    **dict.fromkeys(FORM_FACTORS, Group.SHAPE),
}
"""Figures of a stone; the change of a volume counts relative to what it was."""
N_LARGEST = 5
"""Stones that are named for each figure, those that it changed most for."""


@dataclass(frozen=True, slots=True)
class StoneChange:
    """One figure of one stone, before and after."""

    id: str
    before: float
    after: float
    change: float  # in the unit of the field


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldChanges:
    """One figure of all stones that both have measured."""

    field: str
    group: Group
    unit: str
    n_stones: int
    n_changed: int
    mean: float
    rms: float
    largest: Sequence[StoneChange]  # by amount, falling


@dataclass(frozen=True, slots=True)
class WordChange:
    """An outcome or a quality of one stone that is another word now."""

    id: str
    field: str
    before: str | None
    after: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class StoneChanges:
    """Stones measured twice."""

    n_common: int
    only_before: Sequence[str]
    only_after: Sequence[str]
    words: Sequence[WordChange]
    fields: Sequence[FieldChanges]

    @property
    def n_changed(self) -> int:
        """Number of figures that differ in any bit, of all stones."""
        return len(self.words) + sum(each.n_changed for each in self.fields)


def stone_changes(before: Records, after: Records) -> StoneChanges:
    """Compare the stones that are in both sets of records."""
    common = [name for name in before if name in after]
    measured = [
        name for name in common if before[name]["outcome"] == after[name]["outcome"] == Outcome.MEASURED
    ]
    return StoneChanges(
        n_common=len(common),
        only_before=[name for name in before if name not in after],
        only_after=[name for name in after if name not in before],
        words=[
            WordChange(name, field, before[name][field], after[name][field])
            for field in ("outcome", "quality", "reason")
            for name in common
            if before[name][field] != after[name][field]
        ],
        fields=[_changes(field, group, measured, before, after) for field, group in FIELDS.items()],
    )


def beyond_limits(changes: StoneChanges, limits: Mapping[Group, float]) -> list[str]:
    """Return, in words, each figure whose largest change is beyond the limit of its group, in the field's unit."""
    return [
        f"{each.field} of {worst.id} differs by {worst.change:+.4g} {each.unit}".rstrip()
        + f", more than {limits[each.group]:g}"
        for each in changes.fields
        if each.group in limits
        for worst in each.largest[:1]
        if abs(worst.change) > limits[each.group]
    ]


def _changes(field: str, group: Group, names: Sequence[str], before: Records, after: Records) -> FieldChanges:
    """Return the changes of one figure, without stones that lack it on a side: an old version may measure less."""
    is_relative = group is Group.VOLUME
    found = [
        StoneChange(name, old, new, 100 * (new - old) / old if is_relative else new - old)
        for name in names
        if (old := before[name][field]) is not None and (new := after[name][field]) is not None
    ]
    n_stones = len(found)
    return FieldChanges(
        field=field,
        group=group,
        unit="%" if is_relative else "mm" if field.endswith("_mm") else "",
        n_stones=n_stones,
        n_changed=sum(each.before != each.after for each in found),
        mean=sum(each.change for each in found) / max(n_stones, 1),
        rms=sqrt(sum(each.change**2 for each in found) / max(n_stones, 1)),
        largest=sorted(found, key=lambda each: abs(each.change), reverse=True)[:N_LARGEST],
    )
