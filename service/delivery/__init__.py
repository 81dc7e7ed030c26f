"""What is brought to plants that do not pull: events by webhook, files of closed lots into a folder."""
