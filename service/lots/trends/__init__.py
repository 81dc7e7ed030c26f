"""Figures over the hours, the crusher's diary, and what has changed since an entry of it."""
