"""Routes of calibrations and verifications."""

from service.calibration.routes import calibrations, verifications

ROUTERS = (
    calibrations.router,
    verifications.router,
)
