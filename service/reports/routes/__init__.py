"""Routes of reports, drawings and trends."""

from service.reports.routes import lot_reports, shifts, signatures, trends

ROUTERS = (lot_reports.router, shifts.router, signatures.router, trends.router, trends.diary)
