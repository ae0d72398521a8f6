"""Both sides of the window agree: it averages w' exactly as it differentiates w."""

import numpy as np
import pytest

from gcs_sysid.signals.smoothers import cosine_window

WINDOWS = [(2, 0.05), (3, 0.05), (4, 0.05), (8, 0.01), (20, 0.005), (25, 0.004)]


def times(half, dt):
    return np.arange(-half, half + 1) * dt


@pytest.mark.parametrize(("half", "dt"), WINDOWS)
def test_scale_and_sign(half, dt):
    window = cosine_window(half, dt)
    t = times(half, dt)
    assert window.length == len(t) == len(window.average)
    assert window.average.sum() == pytest.approx(1.0, rel=1e-13)
    assert window.derivative @ t == pytest.approx(1.0, rel=1e-13)
    np.testing.assert_allclose(window.average, window.average[::-1], rtol=1e-12)
    np.testing.assert_allclose(window.derivative, -window.derivative[::-1], rtol=1e-12)


@pytest.mark.parametrize(
    ("half", "dt", "hertz", "bar"),
    [
        # Orders of magnitude above what was measured: 3e-13 for fine steps; coarse ones differ by
        # 4e-5 at the flight modes' highest frequency and by 2e-3 at 4 Hz.
        (25, 0.004, 2.7, 1e-11),
        (20, 0.005, 4.0, 1e-9),
        (4, 0.05, 1.0, 1e-7),
        (4, 0.05, 2.7, 1e-4),
        (4, 0.05, 4.0, 4e-3),
    ],
)
def test_sides_agree_on_sines(half, dt, hertz, bar):
    window = cosine_window(half, dt)
    iw = 2j * np.pi * hertz
    sine = np.exp(iw * times(half, dt))
    ratio = (window.derivative @ sine) / (iw * (window.average @ sine))
    assert abs(ratio - 1.0) < bar


@pytest.mark.parametrize("delay", [-0.015, 0.0, 0.004, 0.0173, 0.05])
@pytest.mark.parametrize(("half", "dt"), [(4, 0.05), (25, 0.004), (20, 0.005)])
def test_a_delayed_window_puts_late_stamps_right(half, dt, delay):
    """On a signal that is stamped late it gives what the plain one gives on the true signal."""
    plain = cosine_window(half, dt)
    room = half + int(np.ceil(abs(delay) / dt))
    moved = plain.delayed(delay, dt, room)
    assert moved.half == room
    t, wide = times(half, dt), times(room, dt)
    scale = room * dt
    for degree in range(2 * min(half, 5)):
        true = (t / scale) ** degree
        stamped_late = ((wide - delay) / scale) ** degree
        assert moved.average @ stamped_late == pytest.approx(plain.average @ true, abs=1e-9)
        assert moved.derivative @ stamped_late * scale == pytest.approx(
            plain.derivative @ true * scale, abs=1e-8
        )
    # A sine of the flight modes: to what its tenth power is within the window.
    w = 2 * np.pi * 1.5
    assert moved.average @ np.sin(w * (wide - delay) + 1.0) == pytest.approx(
        plain.average @ np.sin(w * t + 1.0), abs=1e-4
    )
