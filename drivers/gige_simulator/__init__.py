"""GigE Vision cameras and their rig in software: real packets on loopback, no hardware."""
