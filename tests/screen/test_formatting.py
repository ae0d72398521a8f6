import math

import pytest

from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.words import clock, clock_tenths, duration
from gcs_sysid.screen import formatting as fmt

from . import fake


def test_an_absurd_unobservable_value_does_not_set_the_power():
    result = fake.result()
    result.parameters["rotor_inertia"] = Estimate(4.0e5, 1e9, "kg m^2", "unobservable")
    assert fmt.choose_exponents(result, {}, {})["kg m^2"] == -3


@pytest.mark.parametrize(
    ("value", "std", "exponent", "texts"),
    [
        (0.016553, 0.0000413, -3, ("  16.553", "  0.081 ")),
        (0.0301, 0.00123, -3, ("  30.1  ", "  2.4   ")),
        (5.7e-6, 5.6e-6, -6, ("   6    ", " 11    ")),
        (-0.00167, 0.0000235, -3, ("  -1.670", "  0.046 ")),
        (None, None, -3, ("   ?    ", "  ?    ")),
        (1.0, math.inf, 0, ("   1.000", "  ?    ")),
        (1.0, math.nan, 0, ("   1.000", "  ?    ")),
        (3.0e9, 4.0e9, 0, ("   3e+09", "  8e+09")),
    ],
)
def test_digits_follow_the_interval(value, std, exponent, texts):
    estimate = Estimate(value, std, "kg m^2", "weak")
    written = fmt.value_and_half(estimate, exponent)
    assert [text.strip() for text in written] == [text.strip() for text in texts]
    assert [len(text) for text in written] == [fmt.NUMBER_WIDTH, fmt.NUMBER_WIDTH - 1]


def test_times():
    assert clock(62.9) == "01:02"
    assert clock_tenths(59.96) == "01:00.0"
    assert duration(125.4) == "2 min 5 s"
    assert duration(4.9) == "4 s"
