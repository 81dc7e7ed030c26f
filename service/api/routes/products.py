"""Products, with what they must be; the sieve sets and specifications that are known by name."""

import sqlite3
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Response
from fastapi import Request as HttpRequest
from pydantic import BaseModel, ConfigDict, Field, RootModel

from service.api.auth import Who, require
from service.api.context import Context
from service.api.etags import NOT_MODIFIED, IfMatch, change_if_match, etag, unchanged
from service.api.feeds import MAX_SEQ
from service.api.problems import existing, problem_responses
from service.api.settings import Scope
from service.base.ids import ID, NEW_ID
from service.base.schema import TIME
from service.lots.products import (
    Product,
    definition_of,
    find_product,
    products,
    save_product,
)
from service.lots.yardsticks import (
    Request,
    specification_names,
    yardstick_of,
)
from service.lots.yardsticks import standards as known_standards

router = APIRouter(prefix="/products", tags=["lots"])

ProductName = Annotated[str, Path(pattern=ID, description="Id of the product")]
NewProductName = Annotated[str, Path(pattern=NEW_ID, description="Id of the product")]
Percent = Annotated[float, Field(ge=0, le=100)]
PercentRange = Annotated[
    list[Percent], Field(min_length=2, max_length=2, description="Least and greatest percent, both allowed")
]
Text = Annotated[str, Field(min_length=1, max_length=200)]
ApertureMm = Annotated[float, Field(gt=0, le=1000)]


class Apertures(RootModel[list[ApertureMm]]):
    """Sieves of the site's own by their apertures, mm."""

    root: list[ApertureMm] = Field(min_length=1, max_length=100)


class OwnSpecification(BaseModel):
    """Limits of the site's own."""

    model_config = ConfigDict(extra="forbid")

    name: Text = Field(description="Name of the specification, printed on reports")
    passing: dict[Annotated[str, Field(pattern=r"^[0-9]{1,3}(\.[0-9]{1,4})?$")], PercentRange] = Field(
        max_length=100, description="Percent passing by mass, by aperture in mm"
    )
    flakiness: PercentRange | None = Field(default=None, description="Flakiness index, EN 933-3")
    shape: PercentRange | None = Field(default=None, description="Shape index, EN 933-4")


class ProductRequest(BaseModel):
    """What a product is; what is absent is not known."""

    model_config = ConfigDict(extra="forbid")

    title: Text = Field(description="Name of the product for people, such as `8/16 basalt`")
    density_kg_m3: float = Field(gt=0, le=20_000, description="Of the particles, EN 1097-6, kg/m³")
    lower_mm: ApertureMm | None = Field(default=None, description="d of a product d/D, mm")
    upper_mm: ApertureMm | None = Field(default=None, description="D of it, mm")
    sieve_set: Text | Apertures = Field(
        default_factory=lambda: (
            "en-basic-2"
        ),  # not in the document: generators write it as a name, not a text
        description="Name of a set, see `/products/standards`; or apertures, mm. `en-basic-2` when absent",
    )
    specification: Text | OwnSpecification | None = Field(
        default=None,
        description="Name of a category or size, see `/products/standards`; or limits of your own",
    )
    flakiness_category: Text | None = Field(default=None, description="Such as `FI20`")
    shape_category: Text | None = Field(default=None, description="Such as `SI20`")


class ProductVersion(ProductRequest):
    """One version of a product."""

    model_config = ConfigDict(extra="allow")

    product: str = Field(description="Id of the product, ISA-95 material definition")
    version: int = Field(description="Number of this version, from 1; each change is another one")
    created_at: str = Field(description="When this version was made, RFC 3339 UTC", json_schema_extra=TIME)


class ProductsDocument(BaseModel):
    """The newest version of all products, by name."""

    items: list[ProductVersion] = Field(description="Newest versions, by name")


class SieveSetDocument(BaseModel):
    """A set of sieves."""

    name: str = Field(description="Name to be used as `sieve_set`")
    source: str = Field(description="Standard that it is from")
    apertures_mm: list[float] = Field(description="Apertures, mm, rising")


class Standards(BaseModel):
    """What can be named in a product."""

    sieve_sets: list[SieveSetDocument] = Field(description="Sets of sieves")
    specifications: list[str] = Field(
        description="Names to be used as `specification`, `flakiness_category` or `shape_category`"
    )


@router.get(
    "",
    response_model=ProductsDocument,
    dependencies=[Depends(require(Scope.READ))],
)
async def list_products(context: Context) -> dict[str, Any]:
    """List the products: the newest version of each."""
    return {"items": [_document(asdict(each)) for each in await context.store.read(products)]}


@router.get(
    "/standards",
    response_model=Standards,
    dependencies=[Depends(require(Scope.READ))],
)
async def standards() -> dict[str, Any]:
    """List the sieve sets and specifications that have a name."""
    return {
        "sieve_sets": [asdict(each) for each in known_standards().sieve_sets.values()],
        "specifications": specification_names(),
    }


@router.put(
    "/{product}",
    response_model=ProductVersion,
    dependencies=[Depends(require(Scope.CONFIGURE))],
    responses=problem_responses(409, 412),
)
async def put_product(
    context: Context,
    product: NewProductName,
    wanted: ProductRequest,
    asking: Who,
    response: Response,
    if_match: IfMatch = None,
) -> dict[str, Any]:
    """Define or change a product: a change is a new version, and lots keep theirs."""
    definition = definition_of(wanted.model_dump())
    yardstick_of(definition, Request())  # raises where it cannot be judged
    context.store.require_writable()

    def version(connection: sqlite3.Connection) -> str | None:
        newest = find_product(connection, product)
        return None if newest is None else _tag(newest)

    saved = await context.store.write(
        change_if_match, if_match, version, save_product, product, definition, asking
    )
    response.headers["ETag"] = _tag(saved)
    return _document(asdict(saved))


@router.get(
    "/{product}",
    response_model=ProductVersion,
    dependencies=[Depends(require(Scope.READ))],
    responses={**NOT_MODIFIED, **problem_responses(404)},
)
async def product(
    context: Context,
    request: HttpRequest,
    response: Response,
    product: ProductName,
    version: Annotated[int | None, Query(ge=1, le=MAX_SEQ, description="The newest when absent")] = None,
) -> Any:
    """Get a product, its newest or another version; its `ETag` is for `If-Match` of a change."""
    found = existing(await context.store.read(find_product, product, version), "product", product)
    response.headers["ETag"] = _tag(found)
    return unchanged(request, _tag(found)) or _document(asdict(found))


def _tag(product: Product) -> str:
    return etag(product.product, product.version, product.created_at)


def _document(product: dict[str, Any]) -> dict[str, Any]:
    return {**product.pop("definition"), **product}
