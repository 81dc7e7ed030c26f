"""Import onnxruntime, the one place that does: with its telemetry off.

As it is imported it asks for the addresses of Microsoft's servers and writes a device id into the user's cache. Its own
`disable_telemetry_events` comes too late for that; the variable must be set before.
"""

import os

os.environ["ORT_DISABLE_TELEMETRY"] = "1"

import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as runtime_errors

__all__ = ["onnxruntime", "runtime_errors"]
