"""Routes of what is known of all parts together: overview, metrics, configuration, diagnostics."""

from service.daemon.rest.routes import configuration, diagnostics, metrics, overview

ROUTERS = (overview.router, metrics.router, configuration.router, diagnostics.router)
