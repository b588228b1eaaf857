"""Telemetry: what a running robot does, as a stream to other processes, and their requests back."""

from pepper_driver.telemetry.client import TelemetryClient
from pepper_driver.telemetry.protocol import Kind, TelemetryError
from pepper_driver.telemetry.server import TelemetryServer

__all__ = ["Kind", "TelemetryClient", "TelemetryError", "TelemetryServer"]
