"""The way in of control systems that do not speak REST: OPC UA, MQTT and contacts, as a client of the feed."""
