"""What people look at: pages, scripts, styles and words, static files that `service.api.routes.screens` serves."""
