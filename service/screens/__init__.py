"""The pages for people: scripts, styles and words, static files that `service.api.routes.screens` serves."""
