"""Lots of stones, and the standards that they are judged by."""
