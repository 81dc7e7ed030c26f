"""Routes of health and alarms."""

from service.health.routes import alarms, health

ROUTERS = (
    health.router,
    alarms.router,
)
