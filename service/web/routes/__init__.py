"""Routes of what the store itself has: feeds of events, consumers, the balance, the audit; sign-in and pages."""

from service.web.routes import accounting, audit, consumers, events, session

ROUTERS = (session.router, events.router, consumers.router, accounting.router, audit.router)
