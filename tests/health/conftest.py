"""A calm flight, whose hover there is to assess."""

import pytest

HOVER = (
    *("--mission", "gentle", "--duration", "36", "--rate", "25"),
    *("--noise", "mems", "--seed", "3"),
)


@pytest.fixture(scope="module")
def flight(fly):
    return fly(*HOVER)
