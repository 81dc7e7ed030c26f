"""Routes of webhooks."""

from service.delivery.routes import webhooks

ROUTERS = (webhooks.router,)
