"""The version of the REST interface, by semver: raised whenever `deploy/openapi.json` changes."""

API_VERSION = "1.28.0"
BASE = "/api/v1"
