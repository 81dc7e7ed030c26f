"""MQTT: results, lots, state and alarms as plain JSON topics and as Sparkplug B."""
