"""The REST interface assembled from the routes of all rooms: application, OpenAPI document, metrics."""
