"""Routes of reports, drawings and trends."""

from service.reports.routes import lot_reports, signatures, trends

ROUTERS = (lot_reports.router, signatures.router, trends.router, trends.diary)
