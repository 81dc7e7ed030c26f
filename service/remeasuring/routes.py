"""Routes of measuring again: a stone is measured from its archived frames, and its result gets a revision."""

from fastapi import APIRouter
from pydantic import BaseModel, Field

from service.particles.routes.particles import ParticleKey, find_record
from service.remeasuring.remeasuring import Remeasuring
from service.results.fields import Result, completed
from service.web.auth import OPERABLE, Who
from service.web.context import Context

router = APIRouter(prefix="/particles", tags=["particles"])


class Remeasured(BaseModel):
    """Outcome of measuring a stone again."""

    is_new: bool = Field(
        description="False: the newest result is of today's algorithm already; nothing was done"
    )
    result: Result = Field(description="The newest result")


class Delivery(BaseModel):
    """What a cluster has measured, where it is not the daemon that measures."""

    order: str | None = Field(
        default=None, pattern="^[0-9]{1,12}$", description="Of `POST /particles/{id}/revisions/orders`"
    )


class Ordered(BaseModel):
    """Where the order for a stone lies."""

    is_needed: bool = Field(
        description="False: the newest result is of today's algorithm already; nothing was ordered"
    )
    order: str | None = Field(description="Name of the order, for its delivery")
    folder: str | None = Field(
        description="Path on the daemon's host; only the service's user can read and write there"
    )


@router.post("/{particle_id}/revisions", response_model=Remeasured, dependencies=OPERABLE)
async def remeasure_particle(
    context: Context, particle_id: ParticleKey, asking: Who, delivery: Delivery | None = None
) -> Remeasured:
    """Measure a stone again: from its archived frames, with the calibration of its result and today's algorithm.

    The answer comes when the revision is durable: a moment later or, while stones fall, some seconds. 404 `not-kept`:
    it has no frames any more. 409: `calibration-gone`, `no-background` (the empty rig was not exposed yet) or
    `not-measured`, with the reason; its result stays as it is. With an `order` nothing is measured: what
    `stonefall remeasure --executor` has had measured becomes the revision. `not-ordered`: that order is gone.
    """
    name = (await find_record(context, particle_id))["id"]
    context.store.require_writable()
    remeasuring = context.part(Remeasuring)
    if delivery is None or delivery.order is None:
        is_new = await remeasuring.measure(name, asking)
    else:
        is_new = await remeasuring.orders.deliver(name, delivery.order, asking)
    return Remeasured(is_new=is_new, result=Result(**completed(await find_record(context, name))))


@router.post("/{particle_id}/revisions/orders", response_model=Ordered, dependencies=OPERABLE)
async def order_revision(context: Context, particle_id: ParticleKey) -> Ordered:
    """Order a stone to be measured again elsewhere: for `stonefall remeasure --executor` on the daemon's host.

    The store is not changed. Hindrances are those of `POST /particles/{id}/revisions`.
    """
    name = (await find_record(context, particle_id))["id"]
    folder = await context.part(Remeasuring).orders.order(name)
    return Ordered(
        is_needed=folder is not None,
        order=None if folder is None else folder.name,
        folder=None if folder is None else str(folder),
    )


ROUTERS = (router,)
