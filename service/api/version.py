"""The version of the interface, by semver: raised whenever `deploy/openapi.json` changes."""

API_VERSION = "1.3.1"
BASE = "/api/v1"
