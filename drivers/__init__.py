"""Cameras, light gates, recordings and their simulation: all I/O with devices and disks, no computation."""
