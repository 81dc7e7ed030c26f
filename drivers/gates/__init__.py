"""Light gates: a microcontroller on a serial line, a modem line, a GPIO line; edges become triggers."""
