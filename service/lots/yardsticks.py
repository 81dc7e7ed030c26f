"""Yardstick of a lot: sieves, specification and range of sizes, by its product or by request."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan

from pydantic import TypeAdapter, ValidationError

from pipeline.gradation.curve import PERCENTS
from pipeline.gradation.sieves import OF_THE_RIG, MeasuredRange, SieveSet
from pipeline.gradation.specification import Range, Specification, specification_of, with_declaration
from service.base.errors import InvalidRequestError
from service.lots.products import MAX_QUANTILES, Apertures, OwnSpecification, ProductDefinition
from service.lots.standards import read_standards

DEFAULT_SET = "stonefall"
"""Sieves of stones without a product."""
APERTURES = TypeAdapter[tuple[float, ...]](Apertures)
MEDIAN_PERCENT = 50.0
"""The size that is given of every product."""


class UnknownYardstickError(InvalidRequestError):
    """No table has this name, or the product lacks what it needs; names the field and what there is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """Choices of a request in the place of the product's."""

    sieve_set: str | None = None
    """Name of a set, or apertures in mm: `4,5.6,8`."""
    specification: str | None = None
    measured: MeasuredRange = OF_THE_RIG
    percents: tuple[float, ...] | None = None  # of the sizes D_p


@dataclass(frozen=True, slots=True, kw_only=True)
class Yardstick:
    """Sieves, specification, range of sizes and percents of the sizes D_p of a lot."""

    sieves: SieveSet
    specification: Specification | None
    measured: MeasuredRange
    percents: Sequence[float]

    @property
    def apertures_mm(self) -> Sequence[float]:
        """All sieves that are looked at, rising."""
        limits = () if self.specification is None else self.specification.passing
        return sorted({*self.sieves.apertures_mm, *limits})


def yardstick_of(definition: ProductDefinition | None, request: Request) -> Yardstick:
    """Return the yardstick of a product; raise `UnknownYardstickError` for an unknown sieve set or specification."""
    sieves = _sieves(request.sieve_set or (definition.sieve_set if definition else DEFAULT_SET))
    return Yardstick(
        sieves=sieves,
        specification=_specification(definition, request.specification, sieves),
        measured=request.measured,
        percents=request.percents or _percents(definition),
    )


def percents_in(text: str) -> tuple[float, ...]:
    """Return the percents that a list like `5,16,84,95` names, rising; raise `UnknownYardstickError` for others."""
    try:
        if not text.isascii() or "_" in text:  # which Python takes for digits and between them
            raise ValueError
        percents = {float(each) for each in text.split(",")}
    except ValueError:
        percents = {nan}
    if not all(0 < each < 100 for each in percents) or len(percents) > MAX_QUANTILES:
        raise UnknownYardstickError(
            f"quantiles: {text!r} is no list of up to {MAX_QUANTILES} percents above 0 and below 100,"
            " such as 5,16,84,95"
        )
    return tuple(sorted(percents))


def specification_names() -> list[str]:
    """Return the names of categories and sizes."""
    return [*read_standards().categories, *read_standards().sizes]


def _sieves(wanted: str | tuple[float, ...]) -> SieveSet:
    known = read_standards().sieve_sets
    if isinstance(wanted, str) and wanted in known:
        return known[wanted]
    if isinstance(wanted, str) and not wanted[:1].isdigit():
        raise _unknown("sieve_set", wanted, [*known, "apertures in mm such as 4,5.6,8"])
    try:
        apertures_mm = APERTURES.validate_python(wanted.split(",") if isinstance(wanted, str) else wanted)
        return SieveSet(name="own sieves", source="the site's own", apertures_mm=apertures_mm)
    except ValidationError as err:
        (error, *_) = err.errors()
        where = f"{error['input']!r}: " if error["loc"] else ""
        raise UnknownYardstickError(f"sieve_set: apertures in mm: {where}{error['msg']}") from err
    except ValueError as err:
        raise UnknownYardstickError(f"sieve_set: {err}") from err


def _specification(
    definition: ProductDefinition | None, name: str | None, sieves: SieveSet
) -> Specification | None:
    wanted = name or (definition.specification if definition else None)
    flakiness = _index("flakiness_category", definition, read_standards().flakiness)
    shape = _index("shape_category", definition, read_standards().shape)
    declared = {} if name else _declared(definition)  # of the product, not of another specification
    if isinstance(wanted, OwnSpecification):
        passing = {float(aperture): _limits(pair) for aperture, pair in wanted.passing.items()}
        found = Specification(name=wanted.name, source="the site's own", passing=passing)
        flakiness = _limits(wanted.flakiness) if wanted.flakiness else flakiness
        shape = _limits(wanted.shape) if wanted.shape else shape
    elif wanted is None:
        if flakiness is None and shape is None and not declared:
            return None
        title = "declared grading" if declared else "indices alone"
        found = Specification(name=title, source="EN 12620", is_general=not declared, passing={})
    elif wanted in read_standards().sizes:
        found = read_standards().sizes[wanted]
    else:
        found = _of_category(wanted, definition, sieves)
    try:
        return replace(with_declaration(found, declared), flakiness=flakiness, shape=shape)
    except ValueError as err:
        raise UnknownYardstickError(f"declared_grading: {err}") from err


def _percents(definition: ProductDefinition | None) -> Sequence[float]:
    own = definition and definition.quantiles
    return sorted({*own, MEDIAN_PERCENT}) if own else PERCENTS


def _declared(definition: ProductDefinition | None) -> dict[float, Range]:
    """Return the limits of a product's declared typical grading, by aperture in mm."""
    given = (definition and definition.declared_grading) or {}
    return {
        float(aperture): Range(max(typical - tolerance, 0.0), min(typical + tolerance, 100.0))
        for aperture, (typical, tolerance) in given.items()
    }


def _of_category(wanted: str, definition: ProductDefinition | None, sieves: SieveSet) -> Specification:
    category = read_standards().categories.get(wanted)
    if category is None:
        raise _unknown("specification", wanted, specification_names())
    if definition is None or definition.lower_mm is None or definition.upper_mm is None:
        raise UnknownYardstickError(
            f"specification: {wanted} needs a product with lower_mm (d) and upper_mm (D)"
        )
    try:
        return specification_of(category, definition.lower_mm, definition.upper_mm, sieves.apertures_mm)
    except ValueError as err:
        raise UnknownYardstickError(f"lower_mm, upper_mm: {err}") from err


def _index(field: str, definition: ProductDefinition | None, known: Mapping[str, Range]) -> Range | None:
    name = None if definition is None else getattr(definition, field)
    if name is None:
        return None
    if name not in known:
        raise _unknown(field, name, known)
    return known[name]


def _limits(pair: Sequence[float]) -> Range:
    try:
        return Range(*map(float, pair))
    except ValueError as err:
        raise UnknownYardstickError(f"specification: {err}") from err


def _unknown(field: str, name: str, known: Iterable[str]) -> UnknownYardstickError:
    return UnknownYardstickError(f"{field}: there is no {name!r}; there are {', '.join(known)}")
