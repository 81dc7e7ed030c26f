"""The version of the interface, by semver: raised whenever `deploy/openapi.json` changes."""

API_VERSION = "1.4.0"
BASE = "/api/v1"
