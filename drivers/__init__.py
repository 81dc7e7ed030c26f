"""Cameras, light gates and recordings: what speaks to devices and disks. Nothing here computes."""
