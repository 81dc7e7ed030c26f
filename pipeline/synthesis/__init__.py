"""Rendered bundles with exact truth: bodies, lenses, light, faults."""
