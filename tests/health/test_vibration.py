"""Vibration at a rotor's frequency: known tones, and the sums written out."""

import math

import numpy as np
import pytest

from gcs_sysid.health.drive_health import _squares_of

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
