"""Installation of a release on a Debian host, by the standard library alone; `deploy/install` runs it."""
