"""A flight that many sessions are given, and its analysis."""

from collections.abc import Callable
from typing import Any

import pytest

from gcs_sysid.model.airframe import Airframe, load_airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log


@pytest.fixture(scope="session")
def flight(fly: Callable[..., Any]) -> Any:
    """A quarter of a minute: what happens to a session does not take longer."""
    noise = ("--noise", "paper", "--sigma", "0.002", "--rate", "20")
    return fly("--mission", "all-axes", *noise, "--duration", "16", "--seed", "1")


@pytest.fixture(scope="session")
def airframe() -> Airframe:
    return load_airframe("paper")


@pytest.fixture(scope="session")
def analyzed(flight: Any, airframe: Airframe) -> Result:
    return analyze_log(flight.tlog, airframe)
