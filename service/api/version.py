"""The version of the interface, by semver: raised whenever `deploy/openapi.json` changes."""

API_VERSION = "1.3.0"
BASE = "/api/v1"
