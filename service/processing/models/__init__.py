"""Segmentation networks of this machine: listed, fetched, checked before they are used."""
