"""Delivery to plants that do not poll: events by webhook, files of closed lots into a folder."""
