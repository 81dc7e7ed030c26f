"""Routes of results: the feed, one by one, their files, and those that are pinned."""

from service.particles.routes import particle_files, particles, results, streams

ROUTERS = (results.router, particles.router, particle_files.router, particles.pins, streams.router)
