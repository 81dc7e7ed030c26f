"""Products, with what they must be; the sieve sets and specifications that are known by name."""

import sqlite3
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Response
from fastapi import Request as HttpRequest
from pydantic import BaseModel, Field

from pipeline.gradation.sieves import SieveSet
from service.base.ids import ID, NEW_ID
from service.lots.evaluation import as_json
from service.lots.products import Product, ProductDefinition, find_product, products, save_product
from service.lots.shifts import LotsSettings
from service.lots.standards import read_standards
from service.lots.trends.control import product_control, save_settings
from service.lots.trends.control_documents import ControlSettings, ProductControl
from service.lots.yardsticks import Request, specification_names, yardstick_of
from service.web.auth import CONFIGURABLE, READABLE, Who
from service.web.context import Context
from service.web.etags import NOT_MODIFIED, IfMatch, change_if_match, etag, unchanged
from service.web.feeds import MAX_SEQ
from service.web.problems import existing, problem_responses

router = APIRouter(prefix="/products", tags=["lots"])

ProductName = Annotated[str, Path(pattern=ID, description="Id of the product")]
NewProductName = Annotated[str, Path(pattern=NEW_ID, description="Id of the product")]


class ProductsDocument(BaseModel):
    """The newest version of all products, by name."""

    items: list[Product] = Field(description="Newest versions, by name")


class StandardsAnswer(BaseModel):
    """What can be named in a product."""

    sieve_sets: list[SieveSet] = Field(description="Sets of sieves")
    specifications: list[str] = Field(
        description="Names to be used as `specification`, `flakiness_category` or `shape_category`"
    )


@router.get("", dependencies=READABLE)
async def list_products(context: Context) -> ProductsDocument:
    """List the products: the newest version of each."""
    return ProductsDocument(items=await context.store.read(products))


@router.get("/standards", dependencies=READABLE)
async def standards() -> StandardsAnswer:
    """List the sieve sets and specifications that have a name."""
    sets = list(read_standards().sieve_sets.values())
    return StandardsAnswer(sieve_sets=sets, specifications=specification_names())


@router.put("/{product}", dependencies=CONFIGURABLE, responses=problem_responses(409))
async def put_product(
    context: Context,
    product: NewProductName,
    wanted: ProductDefinition,
    asking: Who,
    response: Response,
    if_match: IfMatch = None,
) -> Product:
    """Define or change a product: a change is a new version, and lots keep theirs."""
    yardstick_of(wanted, Request())  # raises where it cannot be judged

    def version(connection: sqlite3.Connection) -> str | None:
        newest = find_product(connection, product)
        return None if newest is None else _tag(newest)

    saved = await context.write(change_if_match, if_match, version, save_product, product, wanted, asking)
    response.headers["ETag"] = _tag(saved)
    return saved


@router.get("/{product}", response_model=Product, dependencies=READABLE, responses=NOT_MODIFIED)
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
    return unchanged(request, _tag(found)) or found


@router.get("/{product}/control", response_model=ProductControl, dependencies=READABLE)
async def get_control(
    context: Context,
    product: ProductName,
    limit: Annotated[int, Query(ge=1, le=500, description="Lots of the answer, the newest, at most")] = 100,
) -> Response:
    """Get the control charts of a product: its completed lots against limits, with rules, EWMA and capability.

    Limits are three standard deviations of a lot of so many stones: the scatter from lot to lot, and the lot's own
    error of sampling. They come from the first 20 lots that count, or were set. Lots that were completed by earlier
    versions have no point. Beside each violation is what happened since the last lot before the pattern.
    """
    measured = context.part(LotsSettings).measured
    content = await context.read_beside(as_json, product_control, product, measured, limit)
    return Response(existing(content, "product", product), media_type="application/json")


@router.put("/{product}/control", dependencies=CONFIGURABLE, responses=problem_responses(404))
async def put_control(
    context: Context, product: ProductName, wanted: ControlSettings, asking: Who
) -> ControlSettings:
    """Set the limits of a product's control charts, all at once; an empty body takes those of its first lots again."""
    found = existing(await context.store.read(find_product, product), "product", product)
    return await context.write(save_settings, found, wanted, asking)


def _tag(product: Product) -> str:
    return etag(product.product, product.version, product.created_at)
