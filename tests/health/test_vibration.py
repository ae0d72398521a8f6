"""Vibration at a rotor's frequency: known tones, and the sums written out."""

import math

import numpy as np
import pytest

from gcs_sysid.health.drive_health import _squares_of
from gcs_sysid.health.hover_tuning import TUNING

RATE = 1000.0


def flight(tone: float, seconds: float = 20.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, specific force with a tone of this amplitude on two axes, and the rotor's phase."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    phase = 2.0 * math.pi * (80.0 * t + 0.5 * np.sin(0.7 * t))
    force = 0.05 * rng.standard_normal((len(t), 3))
    force[:, 0] += tone * np.cos(phase + 0.3)
    force[:, 2] += 0.5 * tone * np.sin(phase) - 9.8
    return t, force, phase


@pytest.mark.parametrize("tone", [0.0, 0.4])
def test_a_tone_has_its_amplitude_and_noise_has_none(tone: float) -> None:
    t, force, phase = flight(tone)
    squares = _squares_of(t, force, phase, np.arange(2.0, 18.0), RATE)
    assert len(squares) == 16
    assert np.mean(squares) == pytest.approx(1.25 * tone**2, rel=0.01, abs=2e-4)


def test_a_stretch_is_the_sum_of_its_products_with_the_carrier() -> None:
    t, force, phase = flight(0.4)
    (square,) = _squares_of(t, force, phase, np.array([9.0]), RATE)
    half = 0.5 * TUNING.phase_stretch
    here = slice(*np.searchsorted(t, (9.0 - half, 9.0 + half)))
    taper = np.hanning(len(t[here]))
    levels = []
    for beside in (0.0, *TUNING.floor_beside):
        turns = phase[here] + 2.0 * math.pi * beside * (t[here] - t[here][0])
        part = (force[here] - force[here].mean(axis=0)) * taper[:, None]
        levels.append((np.abs((part * np.exp(-1j * turns)[:, None]).sum(axis=0)) ** 2).sum())
    expected = 4.0 / taper.sum() ** 2 * (levels[0] - np.median(levels[1:]))
    assert square == pytest.approx(expected, rel=1e-11)
