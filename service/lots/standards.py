"""Read the tables of the standards: sieves, least test portions, slots, categories and sizes.

They are the TOML files in `standards/`; a site may have a folder of its own in their place.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PositiveFloat, ValidationError

from pipeline.gradation.indices import FlakinessFraction
from pipeline.gradation.sieves import LeastPortions, SieveSet
from pipeline.gradation.specification import Category, CategoryLimit, Range, Specification
from service.base.errors import StandardsError

FOLDER = Path(__file__).parent / "standards"
SIEVES, SPECIFICATIONS = "sieves.toml", "specifications.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Standards:
    """All tables, each by its name."""

    sieve_sets: Mapping[str, SieveSet]
    least_portions: Mapping[str, LeastPortions]
    flakiness_fractions: Mapping[str, tuple[FlakinessFraction, ...]]
    categories: Mapping[str, Category]
    flakiness: Mapping[str, Range]
    shape: Mapping[str, Range]
    sizes: Mapping[str, Specification]


@cache
def read_standards(folder: Path = FOLDER) -> Standards:
    """Return the tables of a folder, read once; a `StandardsError` names the wrong file, and each wrong field."""
    sieves = _read(folder / SIEVES, _SievesFile)
    specifications = _read(folder / SPECIFICATIONS, _SpecificationsFile)
    try:
        return Standards(
            sieve_sets={name: SieveSet(name=name, **dict(table)) for name, table in sieves.sets.items()},
            least_portions={
                name: LeastPortions(source=table.source, kg_by_size_mm=table.kg)
                for name, table in sieves.least_portions.items()
            },
            flakiness_fractions={name: table.low_high_slot_mm for name, table in sieves.flakiness.items()},
            categories={
                name: Category(
                    name=name, source=table.source, passing=table.passing, is_general=table.is_general
                )
                for name, table in specifications.categories.items()
            },
            flakiness=specifications.flakiness.limits,
            shape=specifications.shape.limits,
            sizes={
                name: Specification(name=name, **dict(table)) for name, table in specifications.sizes.items()
            },
        )
    except ValueError as err:
        raise StandardsError(f"{folder}: {err}") from err


def _to_limits(percent: object) -> object:
    match percent:
        case [float() | int() as low, float() | int() as high]:
            return Range(float(low), float(high))
        case [float() | int() as low, float() | int() as high, float() | int() as declared]:
            return Range(float(low), float(high), float(declared))
    raise ValueError("must be [least, greatest] percent, or [least, greatest, greatest with a declaration]")


_Limits = Annotated[Range, BeforeValidator(_to_limits)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Table(_Strict):
    source: str = Field(min_length=1)


class _SieveTable(_Table):
    apertures_mm: tuple[PositiveFloat, ...]


class _PortionTable(_Table):
    kg: dict[PositiveFloat, PositiveFloat] = Field(min_length=1)


class _FlakinessTable(_Table):
    low_high_slot_mm: tuple[FlakinessFraction, ...]


class _SievesFile(_Strict):
    sets: dict[str, _SieveTable]
    least_portions: dict[str, _PortionTable]
    flakiness: dict[str, _FlakinessTable]


class _LimitsTable(_Table):
    is_general: bool = False


class _CategoryTable(_LimitsTable):
    D: dict[PositiveFloat, _Limits]  # by multiples of the upper size
    d: dict[PositiveFloat, _Limits]  # of the lower one

    @property
    def passing(self) -> tuple[CategoryLimit, ...]:
        return tuple(
            CategoryLimit(is_upper=is_upper, factor=factor, limits=limits)
            for is_upper, by_factor in ((True, self.D), (False, self.d))
            for factor, limits in by_factor.items()
        )


class _IndexTable(_Table):
    max_percent: dict[str, float]

    @property
    def limits(self) -> dict[str, Range]:
        return {name: Range(0.0, percent) for name, percent in self.max_percent.items()}


class _SizeTable(_LimitsTable):
    passing: dict[PositiveFloat, _Limits] = Field(min_length=1)


class _SpecificationsFile(_Strict):
    categories: dict[str, _CategoryTable]
    flakiness: _IndexTable
    shape: _IndexTable
    sizes: dict[str, _SizeTable]


File = TypeVar("File", bound=_Strict)


def _read(path: Path, kind: type[File]) -> File:
    try:
        return kind.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except ValidationError as err:
        wrong = "; ".join(
            f"{'.'.join(map(str, error['loc']))}: {error['msg'].removeprefix('Value error, ')}"
            for error in err.errors()
        )
        raise StandardsError(f"{path}: {wrong}") from None
    except (OSError, ValueError, RecursionError) as err:
        raise StandardsError(f"{path}: {err}") from err
