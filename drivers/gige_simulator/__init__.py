"""The simulated rig: GigE Vision cameras, light gate and belt in software, with real packets on loopback."""
