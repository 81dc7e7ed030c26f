"""Routes of reports, drawings and trends."""

from service.reports.routes import lot_reports, trends

ROUTERS = (lot_reports.router, trends.router, trends.diary)
