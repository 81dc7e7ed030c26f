"""Routes of the acquisition and of the cameras."""

from service.acquisition.routes import acquisition, cameras

ROUTERS = (acquisition.router, cameras.acting, cameras.router)
