"""Contacts: a lamp, a relay or an old controller sees by bits whether rig and lot are as they should be."""
