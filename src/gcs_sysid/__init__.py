"""Identify a multirotor's physical parameters from MAVLink telemetry."""

__version__ = "0.1.0"
