"""Identify a multirotor's physical parameters from MAVLink telemetry, logs or arrays.

    import gcs_sysid
    result = gcs_sysid.analyze("flight.tlog", "my-quad.toml")
    result.parameters["Izz"].ci95

What is public is in `gcs_sysid.api`, loaded when it is first used: the command line starts
without NumPy.
"""
# ruff: noqa: F403, F405 - the names are those of `api.__all__`

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gcs_sysid.api import *

__version__ = "0.1.0"

__all__ = [
    "Airframe",
    "Estimate",
    "FlightModel",
    "IdentifiedEstimate",
    "InputError",
    "MotionState",
    "ParameterSamples",
    "Result",
    "Signals",
    "Trajectory",
    "TwinFlight",
    "analyze",
    "fly_twin",
    "identify",
    "load_airframe",
    "read_result",
]


if not TYPE_CHECKING:  # checkers know the names above, and no others

    def __getattr__(name: str) -> object:
        if name in __all__:
            return getattr(import_module("gcs_sysid.api"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
