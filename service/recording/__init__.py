"""Bundles kept as files: recordings on request, and the frames of the newest stones."""
