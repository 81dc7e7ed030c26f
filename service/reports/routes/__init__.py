"""Routes of reports, drawings and trends."""

from service.reports.routes import curves, lot_reports, trends

ROUTERS = (lot_reports.router, curves.router, trends.router, trends.diary)
