"""Routes of measuring again."""

from service.remeasuring.routes import revisions

ROUTERS = (revisions.router,)
