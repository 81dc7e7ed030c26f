"""The TOML file: its settings with their defaults, and the checks of what physics and network forbid."""
