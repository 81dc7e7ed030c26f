"""Routes of what the store itself has: feeds of events, consumers, the balance, the audit; sign-in and pages."""

from service.web.routes import accounting, audit, consumers, events, pairings, session

ROUTERS = (session.router, pairings.router, events.router, consumers.router, accounting.router, audit.router)
