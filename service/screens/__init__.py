"""The pages for people: scripts, styles and words, static files that `service.web.routes.screens` serves."""
