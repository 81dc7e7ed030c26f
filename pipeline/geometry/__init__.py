"""Convex hulls and spheres in compiled loops, of points in mm."""
