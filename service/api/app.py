"""The REST application, assembled from its routes."""

from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, FastAPI
from fastapi.responses import HTMLResponse

from service.api.auth import has_right_key, require
from service.api.body_limit import BodyLimit
from service.api.context import ApiContext
from service.api.control import Control
from service.api.description import DESCRIPTION, SERVERS, TAGS, complete
from service.api.docs import docs_page
from service.api.foreign_pages import ForeignPages
from service.api.gzipped import GzippedJson
from service.api.idempotency import AnsweredBeforeError, IdempotentPosts, repeat_answer
from service.api.key_ring import KeyRing
from service.api.overviews import Overviews
from service.api.pace import PacedRequests
from service.api.pieces import Piecewise
from service.api.problems import install_handlers
from service.api.reader_process import Reading
from service.api.request_ids import RequestIds
from service.api.routes import (
    accounting,
    acquisition,
    alarms,
    audit,
    calibrations,
    cameras,
    configuration,
    consumers,
    curves,
    diagnostics,
    diary,
    events,
    health,
    laboratory,
    lot_figures,
    lots,
    metrics,
    overview,
    particle_files,
    particles,
    pins,
    products,
    recordings,
    results,
    revisions,
    screens,
    session,
    streams,
    trends,
    verifications,
    webhooks,
    windows,
)
from service.api.sessions import Sessions
from service.api.settings import ApiSettings, Scope
from service.api.version import API_VERSION, BASE
from service.store import Store


def create_app(
    store: Store, control: Control, settings: ApiSettings, reading: Reading, keys: KeyRing
) -> FastAPI:
    """Build the application that serves `store` and steers `control`; what takes long is made by `reading`."""
    app = build_routes()
    app.state.context = ApiContext(
        store=store,
        control=control,
        settings=settings,
        reading=reading,
        keys=keys,
        sessions=Sessions(store.dir),
        overviews=Overviews(store, control, reading),
    )
    app.add_middleware(IdempotentPosts, store=store)  # the innermost: what the others refuse is not kept
    app.add_middleware(GzippedJson, reading=reading)
    app.add_middleware(ForeignPages, settings=settings)
    app.add_middleware(BodyLimit, max_body_bytes=settings.max_body_bytes)
    app.add_middleware(PacedRequests, is_known=partial(has_right_key, context=app.state.context))
    app.add_middleware(Piecewise)
    app.add_middleware(RequestIds)  # the outermost: every answer has one
    return app


def build_routes() -> FastAPI:
    """Build the application without store and daemon: enough to generate the OpenAPI document."""
    app = FastAPI(
        title="stonefall",
        version=API_VERSION,
        summary="The shape of every stone that leaves the crusher",
        description=DESCRIPTION,
        servers=SERVERS,
        openapi_tags=[{"name": tag, "description": text} for tag, text in TAGS.items()],
        openapi_url=f"{BASE}/openapi.json",
        docs_url=None,  # FastAPI's own pages load scripts from a public network: dead in a plant
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,
        responses={"default": {}},  # any other problem; without it FastAPI describes a 422 of its own
    )
    # each route of these names its scope: live and ready need no key, others another scope than `read`
    for module in (
        health,
        acquisition,
        recordings,
        calibrations,
        verifications,
        consumers,
        pins,
        revisions,
        products,
        lots,
        lot_figures,
        curves,
        diary,
        laboratory,
        configuration,
        diagnostics,
        alarms,
        overview,
        session,
        streams,
        webhooks,
    ):
        app.include_router(module.router, prefix=BASE)
    app.include_router(cameras.acting, prefix=BASE)
    readable = APIRouter(dependencies=[Depends(require(Scope.READ))])
    for module in (
        results,
        particles,
        particle_files,
        cameras,
        accounting,
        windows,
        trends,
        audit,
        events,
        metrics,
    ):
        readable.include_router(module.router)
    app.include_router(readable, prefix=BASE)

    app.include_router(screens.router)

    @app.get(f"{BASE}/docs", include_in_schema=False)
    async def docs() -> HTMLResponse:
        return HTMLResponse(
            docs_page(app.openapi()),
            headers={"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'"},
        )

    install_handlers(app)
    app.add_exception_handler(AnsweredBeforeError, repeat_answer)
    _describe(app)
    return app


def _describe(app: FastAPI) -> None:
    """Complete the OpenAPI document of the routes."""
    generate = app.openapi
    completed: list[dict[str, Any]] = []

    def openapi() -> dict[str, Any]:
        if not completed:
            document = generate()
            complete(document)
            completed.append(document)
        return completed[0]

    app.openapi = openapi  # type: ignore[method-assign]  # FastAPI's documented way to extend it
