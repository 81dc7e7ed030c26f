"""Configurations of the daemon as tests write them."""

REPLAY = '[rig]\nrecording = "recording"\n[spool]\ndir = "spool"\n[store]\ndir = "state"\n'
"""What every file must say, with a recording beside it; further fields of `[store]` and sections go after it."""
KEY_SHA256 = 64 * "a"
KEY = f'[[api.keys]]\nname = "mes"\nsha256 = "{KEY_SHA256}"\nscopes = ["read"]\n'
