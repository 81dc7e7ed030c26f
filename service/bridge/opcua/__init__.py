"""OPC UA: results, lots, state and alarms as the nodes, events and methods of a server."""
