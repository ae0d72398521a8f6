"""Numbers and words as terminal, screen, report and fleet page write them."""

import doctest
import math

import pytest

from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.results import words
from gcs_sysid.results.words import PAGE, PLAIN, percent_column, rounded, scaled_unit


def test_examples_run():
    assert doctest.testmod(words).failed == 0


@pytest.mark.parametrize(
    ("unit", "exponent", "text"),
    [
        ("kg m^2", 0, "kg m²"),
        ("kg m^2", -3, "10⁻³ kg m²"),
        ("N m s^2", -6, "10⁻⁶ N m s²"),
        ("m", -3, "mm"),
        ("s", -3, "ms"),
        ("m", 0, "m"),
        ("1", 0, ""),
        ("1", -3, "10⁻³"),
        ("N s/m", 0, "N s/m"),
    ],
)
def test_unit_with_its_power(unit, exponent, text):
    assert scaled_unit(unit, exponent) == text


@pytest.mark.parametrize(
    ("fraction", "signed", "text"),
    [
        (0.00487, False, "0.49 %"),
        (0.0999, False, "10 %"),
        (0.1234, False, "12 %"),
        (1.9, False, "190 %"),
        (12.0, False, ">999 %"),
        (math.inf, False, ">999 %"),
        (None, False, ""),
        (-0.0029, True, "-0.29 %"),
        (0.024, True, "+2.4 %"),
        (-50.0, True, "<-999 %"),
    ],
)
def test_percent_in_a_column(fraction, signed, text):
    assert percent_column(fraction, signed=signed) == text
    assert len(text) <= 7


def test_every_status_has_its_own_sign():
    for vocabulary in (words.STATUS, words.VERDICT, words.CHANGE):
        assert len({word.sign for word in vocabulary.values()}) == len(vocabulary)


def test_labels_fit_their_column():
    assert all(len(words.label(name)) <= 13 for name in REGISTRY)


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (0.0165529, 8.1e-5, "0.016553"),
        (0.0165, 8.1e-4, "0.01650"),
        (8.70257e-06, 5.2e-05, "9e-06"),
        (1e-7, 5.2e-05, "1e-07"),
        (2.05e-4, 1.2e-9, "0.000205000"),
        (-0.00167, 4.6e-5, "-0.001670"),
        (123.4, 8.1, "123.4"),
        (1.5, 0.0, "1.5"),
        (0.0, 1e-3, "0"),
        (None, 1.0, "-"),
        (math.nan, 1.0, "-"),
    ],
)
def test_a_value_is_rounded_to_its_interval(value, half, text):
    assert rounded(value, half) == text


def test_a_page_writes_true_minus_signs_and_unbroken_measures():
    assert PAGE.number(-0.00166, 3) == "\N{MINUS SIGN}1.66 × 10⁻³"
    assert PAGE.unit("N m s^2") == "N\N{NO-BREAK SPACE}m\N{NO-BREAK SPACE}s²"
    assert PAGE.value_and_half(0.0165529, 8.1e-5) == ("16.553", "0.081", " × 10⁻³", -3)
    assert PLAIN.number(-0.00166, 3) == "-0.00166"
    assert PLAIN.unit("N m s^2") == "N m s^2"


def test_an_event_names_what_surely_changed():
    mass = {"before": 1.5, "after": 1.65, "ci95": [0.13, 0.17]}
    drag = {"before": 0.1, "after": 0.11, "ci95": [-0.05, 0.07]}
    event = {"kind": "mass_change", "parameters": {"mass": mass, "linear_drag": drag}}
    assert words.event_text(event) == "mass change: mass 1.500 -> 1.650 kg"
    failed = {"kind": "rotor_failure", "rotor": 2, "loss": {"ci95": [0.18, 0.22]}}
    assert words.event_text(failed) == "rotor failure: rotor 3 lost 18 to 22 % of its thrust"


def test_an_undecided_disturbance_bounds_what_the_result_covers():
    said = words.disturbance_text({"cause": "force", "undecided": True})
    assert said.endswith("undecided at the end: the result covers only the flight up to it")
