"""Products: what is produced, and what it must be. A change makes another version; lots keep theirs."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict, field, fields
from typing import Annotated, Any

from pydantic import AfterValidator, Field
from typing_extensions import TypeAliasType

from drivers.files.times import utc_now
from service.base.errors import TooManyError
from service.base.schema import Name, Time, request_body, served
from service.store import audit

MAX_PRODUCTS = 1000
"""Most products: they are one list, without pages."""
ApertureMm = Annotated[float, Field(gt=0, le=1000)]
ApertureName = Annotated[str, Field(pattern=r"^[0-9]{1,3}(\.[0-9]{1,4})?$")]
"""An aperture in mm, as JSON has keys."""
OWN_SIEVES = "Sieves of the site's own by their apertures, mm"
Apertures = TypeAliasType(
    "Apertures",
    Annotated[tuple[ApertureMm, ...], Field(min_length=1, max_length=100, description=OWN_SIEVES)],
)
Percent = Annotated[float, Field(ge=0, le=100)]
PercentRange = tuple[Percent, Percent]
"""Least and greatest percent, both allowed."""
MAX_QUANTILES = 20
QuantilePercent = Annotated[float, Field(gt=0, lt=100, strict=True)]


def _each_once(percents: tuple[float, ...]) -> tuple[float, ...]:
    """Return percents as they are; raise `ValueError` if one is there twice."""
    if len(set(percents)) < len(percents):
        raise ValueError("a percent is there twice")
    return percents


Quantiles = TypeAliasType(
    "Quantiles",
    Annotated[
        tuple[QuantilePercent, ...],
        Field(
            min_length=1,
            max_length=MAX_QUANTILES,
            description="Percent of the mass that is smaller, of each size D_p; each once",
        ),
        AfterValidator(_each_once),
    ],
)
Typical = tuple[Percent, Percent]
"""Percent that passes, and its tolerance to either side in percentage points."""
EN_BASIC = "en-basic-2"
"""Not in the schema, as generators write a default of this type as a name, not a text."""


@request_body
class OwnSpecification:
    """Limits of the site's own."""

    name: Name
    """Name of the specification, printed on reports."""
    passing: Annotated[Mapping[ApertureName, PercentRange], Field(max_length=100)]
    """Percent passing by mass, by aperture in mm."""
    flakiness: PercentRange | None = None
    """Flakiness index, EN 933-3."""
    shape: PercentRange | None = None
    """Shape index, EN 933-4."""


@request_body
class ProductDefinition:
    """What a product is; what is absent is not known."""

    title: Name
    """Name of the product for people, such as `8/16 basalt`."""
    density_kg_m3: Annotated[float, Field(gt=0, le=20_000)]
    """Density of the particles, EN 1097-6, kg/m³."""
    lower_mm: ApertureMm | None = None
    """d of a product d/D, mm."""
    upper_mm: ApertureMm | None = None
    """D of it, mm."""
    sieve_set: Name | Apertures = field(default_factory=lambda: EN_BASIC)
    """Name of a set, see `/products/standards`; or apertures, mm. `en-basic-2` when absent."""
    specification: Name | OwnSpecification | None = None
    """Name of a category or size, see `/products/standards`; or limits of your own."""
    flakiness_category: Name | None = None
    """Such as `FI20`."""
    shape_category: Name | None = None
    """Such as `SI20`."""
    declared_grading: Annotated[Mapping[ApertureName, Typical], Field(max_length=100)] | None = None
    """Typical grading that the supplier declares (EN 13043, EN 12620): percent passing and its tolerance in percentage
    points, by aperture in mm. Lots must lie within these as well."""
    quantiles: Quantiles | None = None
    """Percents of the sizes D_p that are given of its lots beside the median, such as 5, 16, 84, 95. D10, D30, D50, D60
    and D90 when absent."""


@served
class Product(ProductDefinition):
    """One version of a product."""

    product: str
    """Id of the product, ISA-95 material definition."""
    version: int
    """Number of this version, from 1; each change is another one."""
    created_at: Time
    """When this version was made, RFC 3339 UTC."""

    @property
    def definition(self) -> ProductDefinition:
        return ProductDefinition(**_members(self))


def _members(definition: ProductDefinition) -> dict[str, Any]:
    """Return the fields of a definition by name, each as it is."""
    return {each.name: getattr(definition, each.name) for each in fields(ProductDefinition)}


def save_product(
    connection: sqlite3.Connection, product: str, definition: ProductDefinition, who: str
) -> Product:
    """Make a new version of a product, if it is another one than the newest; return the newest.

    Raises `TooManyError` if there are `MAX_PRODUCTS` others already.
    """
    newest = find_product(connection, product)
    if newest is not None and newest.definition == definition:
        return newest
    (n,) = connection.execute("SELECT count(DISTINCT product) FROM products").fetchone()
    if newest is None and n >= MAX_PRODUCTS:
        raise TooManyError("products", f"there are {MAX_PRODUCTS} products: change one of them")
    version = 1 if newest is None else newest.version + 1
    saved = Product(**_members(definition), product=product, version=version, created_at=utc_now())
    connection.execute(
        "INSERT INTO products (product, version, definition, created_at) VALUES (?, ?, ?, ?)",
        (product, version, json.dumps(asdict(definition)), saved.created_at),
    )
    before = None if newest is None else asdict(newest.definition)
    audit.note(connection, who, "product", product, before=before, after=asdict(definition))
    return saved


def find_product(connection: sqlite3.Connection, product: str, version: int | None = None) -> Product | None:
    """Return a version of a product, the newest unless it is named; None if there is none."""
    condition = "product = ?1 AND version = coalesce(?2, version) ORDER BY version DESC LIMIT 1"
    return next(iter(_products(connection, condition, product, version)), None)


def products(connection: sqlite3.Connection) -> list[Product]:
    """Return the newest version of all products, by name."""
    newest = "SELECT product, max(version) FROM products GROUP BY product"
    return _products(connection, f"(product, version) IN ({newest}) ORDER BY product")


def _products(connection: sqlite3.Connection, condition: str, *values: object) -> list[Product]:
    rows = connection.execute(
        f"SELECT product, version, created_at, definition FROM products WHERE {condition}",  # noqa: S608 - of this module
        values,
    )
    return [
        Product(
            **_members(definition_of(json.loads(text))),
            product=product,
            version=version,
            created_at=created_at,
        )
        for product, version, created_at, text in rows
    ]


def definition_of(document: Mapping[str, Any]) -> ProductDefinition:
    """Return the definition in a document that has been stored."""
    given = {item.name: document[item.name] for item in fields(ProductDefinition) if item.name in document}
    if isinstance(given.get("sieve_set"), list):
        given["sieve_set"] = tuple(given["sieve_set"])
    if (declared := given.get("declared_grading")) is not None:
        given["declared_grading"] = {name: tuple(typical) for name, typical in declared.items()}
    if (quantiles := given.get("quantiles")) is not None:
        given["quantiles"] = tuple(quantiles)
    own = given.get("specification")
    if isinstance(own, Mapping):
        limits = {name: tuple(value) for name, value in own["passing"].items()}
        pairs = {name: own[name] and tuple(own[name]) for name in ("flakiness", "shape")}
        given["specification"] = OwnSpecification(name=own["name"], passing=limits, **pairs)
    return ProductDefinition(**given)
