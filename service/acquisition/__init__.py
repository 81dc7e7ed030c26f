"""Triggers and frames of the rig: its devices armed and brought back, bundles passed on. Begin at `acquisition`."""
