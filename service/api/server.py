"""How uvicorn serves the application; the life of the process is the daemon's business."""

import uvicorn
from fastapi import FastAPI

from service.api.settings import ApiSettings


def server_config(app: FastAPI, settings: ApiSettings) -> uvicorn.Config:
    """Give a configuration without uvicorn's own logging, banner and start-up events."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        ws="none",
        timeout_keep_alive=30,
        timeout_graceful_shutdown=5,
    )
