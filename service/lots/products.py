"""Products: what is produced, and what it must be. A change makes another version; lots keep theirs."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from drivers.files.times import utc_now
from service.base.errors import TooManyError
from service.store import audit
from service.store.schema import transaction

MAX_PRODUCTS = 1000
"""Most products: they are one list, without pages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnLimits:
    """A specification of the site's own: percent passing by aperture, flakiness and shape index, each from .. to."""

    name: str
    passing: Mapping[str, tuple[float, float]]  # by aperture in mm, as JSON has keys
    flakiness: tuple[float, float] | None = None
    shape: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductDefinition:
    """What a product is; ISA-95 calls it a material definition."""

    title: str
    density_kg_m3: float  # of the particles, EN 1097-6
    lower_mm: float | None = None  # d of d/D
    upper_mm: float | None = None  # D of d/D
    sieve_set: str | tuple[float, ...] = "en-basic-2"  # name of a set, or apertures in mm
    specification: str | OwnLimits | None = None  # name of a category or size, or the site's own
    flakiness_category: str | None = None  # FI20
    shape_category: str | None = None  # SI20


@dataclass(frozen=True, slots=True, kw_only=True)
class Product:
    """One version of a product."""

    product: str
    version: int
    created_at: str
    definition: ProductDefinition


def save_product(
    connection: sqlite3.Connection, product: str, definition: ProductDefinition, who: str
) -> Product:
    """Make a new version of a product, if it is another one than the newest; return the newest.

    Raises
    ------
    TooManyError
        There are `MAX_PRODUCTS` others already.
    """
    with transaction(connection):
        newest = _newest(connection, product)
        if newest is not None and newest.definition == definition:
            return newest
        (n,) = connection.execute("SELECT count(DISTINCT product) FROM products").fetchone()
        if newest is None and n >= MAX_PRODUCTS:
            raise TooManyError("products", f"there are {MAX_PRODUCTS} products: change one of them")
        version = 1 if newest is None else newest.version + 1
        saved = Product(product=product, version=version, created_at=utc_now(), definition=definition)
        connection.execute(
            "INSERT INTO products (product, version, definition, created_at) VALUES (?, ?, ?, ?)",
            (product, version, json.dumps(asdict(definition)), saved.created_at),
        )
        before = None if newest is None else asdict(newest.definition)
        audit.note(connection, who, "product", product, before=before, after=asdict(definition))
    return saved


def find_product(connection: sqlite3.Connection, product: str, version: int | None = None) -> Product | None:
    """Return a version of a product, the newest unless it is named; None if there is none."""
    if version is None:
        return _newest(connection, product)
    rows = connection.execute(
        "SELECT product, version, created_at, definition FROM products WHERE product = ? AND version = ?",
        (product, version),
    )
    return _product(rows.fetchone())


def products(connection: sqlite3.Connection) -> list[Product]:
    """Return the newest version of all products, by name."""
    rows = connection.execute(
        "SELECT product, max(version), created_at, definition FROM products GROUP BY product ORDER BY product"
    )
    return [found for row in rows if (found := _product(row)) is not None]


def _newest(connection: sqlite3.Connection, product: str) -> Product | None:
    rows = connection.execute(
        "SELECT product, version, created_at, definition FROM products WHERE product = ?"
        " ORDER BY version DESC LIMIT 1",
        (product,),
    )
    return _product(rows.fetchone())


def _product(row: tuple[str, int, str, str] | None) -> Product | None:
    if row is None:
        return None
    product, version, created_at, text = row
    return Product(
        product=product, version=version, created_at=created_at, definition=definition_of(json.loads(text))
    )


def definition_of(document: Mapping[str, Any]) -> ProductDefinition:
    """Return the definition in a document that has been stored."""
    given = {item.name: document[item.name] for item in fields(ProductDefinition) if item.name in document}
    if isinstance(given.get("sieve_set"), list):
        given["sieve_set"] = tuple(given["sieve_set"])
    own = given.get("specification")
    if isinstance(own, Mapping):
        limits = {name: tuple(value) for name, value in own["passing"].items()}
        pairs = {name: own[name] and tuple(own[name]) for name in ("flakiness", "shape")}
        given["specification"] = OwnLimits(name=own["name"], passing=limits, **pairs)
    return ProductDefinition(**given)
