"""Routes of recordings."""

from service.recording.routes import recordings

ROUTERS = (recordings.router,)
