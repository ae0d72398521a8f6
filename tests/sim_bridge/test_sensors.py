"""Noise: size, color, stationarity and seeds."""

import math

import numpy as np
import pytest

from sim_bridge.sensors import (
    CORNER,
    SENSORS,
    Bias,
    Channel,
    HighPass,
    LowPass,
    White,
    make_channels,
)

RATE = 20.0
DT = 1.0 / RATE


def channel(*components, width=3, dt=DT, seed=0):  # type: ignore[no-untyped-def]
    return Channel(components, width, dt, np.random.SeedSequence(seed))


def autocorrelation(x: np.ndarray, lag: int) -> float:
    return float(np.mean(x[lag:] * x[:-lag]) / np.mean(x * x))


@pytest.mark.slow
@pytest.mark.parametrize("rate", [20.0, 250.0])
@pytest.mark.parametrize("kind", [LowPass, HighPass])
def test_colored_noise_has_the_stationary_sigma(kind, rate: float) -> None:  # type: ignore[no-untyped-def]
    block = channel(kind(0.02), width=6000, dt=1.0 / rate).block(40)
    assert block[0].std() == pytest.approx(0.02, rel=0.03)  # from the first sample on
    assert block[-1].std() == pytest.approx(0.02, rel=0.03)
    assert abs(block.mean()) < 0.002


def test_low_pass_noise_has_the_corner() -> None:
    x = channel(LowPass(1.0), width=1).block(200_000)[:, 0]
    a = math.exp(-CORNER * DT)
    for lag in (1, 2, 4):
        assert autocorrelation(x, lag) == pytest.approx(a**lag, abs=0.02)


def test_high_pass_noise_has_no_slow_part_and_is_white_above_the_corner() -> None:
    dt = 0.004
    x = channel(HighPass(1.0), width=1, dt=dt).block(1 << 18)[:, 0]
    power = np.abs(np.fft.rfft(x)) ** 2
    omega = 2 * np.pi * np.fft.rfftfreq(len(x), dt)
    high = power[omega > 10 * CORNER].mean()
    for low, up in ((0.5, 1.0), (1.5, 2.5), (4.0, 6.0)):
        band = (omega > low) & (omega < up)
        expected = (omega[band] ** 2 / (omega[band] ** 2 + CORNER**2)).mean()
        assert power[band].mean() / high == pytest.approx(expected, rel=0.3)


def test_white_noise_of_a_density() -> None:
    x = channel(White(density=0.01), dt=0.004).block(50_000)
    assert x.std() == pytest.approx(0.01 * math.sqrt(250.0 / 2.0), rel=0.02)
    assert abs(autocorrelation(x[:, 0], 1)) < 0.02


def test_bias_starts_at_its_size_and_walks() -> None:
    x = channel(Bias(0.01, walk=1e-3), width=5000, dt=0.01).block(100)
    np.testing.assert_allclose(abs(x[0]), 0.01, atol=6e-4)
    assert 0.4 < (x[0] > 0).mean() < 0.6
    assert (x[-1] - x[0]).std() == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize("model", ["paper", "mems", "white"])
def test_the_cut_into_blocks_changes_no_value(model: str) -> None:
    def fresh() -> dict[str, Channel]:
        return make_channels(model, 0.02, dict.fromkeys(SENSORS, DT), 4, np.random.SeedSequence(9))

    whole, single = fresh(), fresh()
    for sensor in SENSORS:
        block = whole[sensor].block(1300)
        np.testing.assert_array_equal([single[sensor].next() for _ in range(1300)], block)
