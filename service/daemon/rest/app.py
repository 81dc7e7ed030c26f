"""The REST application, assembled from its routes."""

from functools import cache, partial
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.responses import HTMLResponse

import service.acquisition.routes
import service.calibration.routes
import service.daemon.rest.routes
import service.delivery.routes
import service.health.routes
import service.lots.routes
import service.particles.routes
import service.recording.routes
import service.remeasuring.routes
import service.reports.routes
import service.web.routes
from service.daemon.overview.overviews import Overviews
from service.daemon.rest.description import DESCRIPTION, SERVERS, TAGS, complete
from service.lots.plant import PlantSettings
from service.store import Store
from service.web.auth import has_right_key
from service.web.body_limit import with_body_limit
from service.web.context import ApiContext
from service.web.control import Control
from service.web.docs import docs_page
from service.web.foreign_pages import ForeignPages
from service.web.gzipped import gzipping
from service.web.heads import answering_heads
from service.web.idempotency import keeping_answers
from service.web.key_ring import KeyRing
from service.web.pace import paced
from service.web.parameters import only_known_words
from service.web.pieces import in_pieces
from service.web.problems import install_handlers
from service.web.reader_process import Reading
from service.web.request_ids import with_request_ids
from service.web.request_times import timed
from service.web.routes import screens
from service.web.sessions import Sessions
from service.web.settings import ApiSettings
from service.web.targets import answering_below, answering_joined, answering_whole_addresses
from service.web.version import API_VERSION, BASE

ROOMS = (
    service.acquisition.routes,
    service.recording.routes,
    service.calibration.routes,
    service.reports.routes,
    service.lots.routes,
    service.remeasuring.routes,
    service.particles.routes,
    service.health.routes,
    service.web.routes,
    service.delivery.routes,
    service.daemon.rest.routes,
)
"""Every room with routes, in the order of the OpenAPI document."""


def create_app(
    store: Store,
    control: Control,
    settings: ApiSettings,
    reading: Reading,
    drawing: Reading,
    keys: KeyRing,
) -> FastAPI:
    """Build the application that serves `store` and steers `control`.

    What takes long is made by `reading`, or by `drawing` if it is a picture or a mesh of a stone.
    """
    app = build_routes(settings.path_prefix)
    app.state.context = ApiContext(
        store=store,
        control=control,
        settings=settings,
        reading=reading,
        keys=keys,
        sessions=Sessions(store),
        site=lambda: control.part(PlantSettings).name,
        drawing=drawing,
    )
    app.state.overviews = Overviews(store, control)
    app.add_middleware(keeping_answers, store=store)  # the innermost: what the others refuse is not kept
    app.add_middleware(gzipping, reading=reading)
    app.add_middleware(ForeignPages, settings=settings)
    app.add_middleware(with_body_limit, max_body_bytes=settings.max_body_bytes)
    app.add_middleware(paced, is_known=partial(has_right_key, context=app.state.context))
    app.add_middleware(in_pieces)
    app.add_middleware(timed, times=app.state.context.times)
    app.add_middleware(answering_heads)
    app.add_middleware(with_request_ids)  # every answer has one
    app.add_middleware(answering_joined)
    if settings.path_prefix:
        app.add_middleware(answering_below, prefix=settings.path_prefix)
    app.add_middleware(answering_whole_addresses)  # the outermost: all others see a path
    return app


def build_routes(path_prefix: str = "") -> FastAPI:
    """Build the application without store and daemon: enough to generate the OpenAPI document.

    `path_prefix` is where a proxy has it, which the document names as its server.
    """
    app = FastAPI(
        title="stonefall",
        version=API_VERSION,
        summary="The shape of every stone that leaves the crusher",
        description=DESCRIPTION,
        servers=[{"url": path_prefix, "description": "The instrument behind its proxy"}]
        if path_prefix
        else SERVERS,
        openapi_tags=[{"name": tag, "description": text} for tag, text in TAGS.items()],
        openapi_url=f"{BASE}/openapi.json",
        docs_url=None,  # FastAPI's own pages load scripts from a public network: dead in a plant
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,
        responses={"default": {}},  # any other problem; without it FastAPI describes a 422 of its own
    )
    for room in ROOMS:
        for router in room.ROUTERS:
            app.include_router(router, prefix=BASE, dependencies=[Depends(only_known_words)])

    app.include_router(screens.router)

    @app.get(f"{BASE}/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        return HTMLResponse(
            docs_page(app.openapi()),
            headers={"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'"},
        )

    install_handlers(app, screens.missing_page)
    generate = app.openapi

    @cache
    def openapi() -> dict[str, Any]:
        document = generate()
        complete(document)
        return document

    app.openapi = openapi  # type: ignore[method-assign]  # FastAPI's documented way to extend it
    return app
