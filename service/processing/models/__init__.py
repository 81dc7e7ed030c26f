"""Segmentation networks of this machine: listed, fetched, trained, checked before they are used."""
