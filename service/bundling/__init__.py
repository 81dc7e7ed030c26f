"""Frames joined to the trigger that they were exposed for, whatever is late, lost or double. Begin at `bundling`."""
