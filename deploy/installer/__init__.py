"""Installation of a release on a Debian 12 host, by the standard library alone; `deploy/install` runs it."""
