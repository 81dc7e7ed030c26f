"""Experiments that no plant needs: how fast and how true the measuring is, the paper repeated, networks trained."""
