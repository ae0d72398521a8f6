"""Our recursive filters do what SciPy's do, and spare every command what those take to load."""

import numpy as np
import pytest
from scipy import signal

from gcs_sysid.estimation.rows.rotor_signals import butterworth
from gcs_sysid.signals.recursions import lfilter, recursion

FILTERS = {
    "first order": ([1.0], [1.0, -0.9]),
    "a step late": ([0.0, 0.1], [1.0, -0.9]),
    "second order": ([0.2, 0.3, 0.1], [1.0, -1.2, 0.5]),
    "short numerator": ([0.1], [1.0, -1.2, 0.5]),
    "third order": ([0.1, 0.0, 0.0, 0.2], [1.0, -0.5, 0.2, -0.1]),
}


@pytest.mark.parametrize("n", [1, 2, 3, 7, 500])
@pytest.mark.parametrize(("b", "a"), FILTERS.values(), ids=FILTERS.keys())
def test_values_and_states_are_those_of_scipy(b, a, n):
    rng = np.random.default_rng(1)
    x, zi = rng.standard_normal((n, 3, 2)), rng.standard_normal((len(a) - 1, 3, 2))
    for state in (zi, None):
        y, after = lfilter(b, a, x, state)
        rest = np.zeros_like(zi) if state is None else state
        wanted, wanted_after = signal.lfilter(b, a, x, axis=0, zi=rest)
        np.testing.assert_allclose(y, wanted, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(after, wanted_after, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("n", [0, 1, 2, 50])
def test_coefficients_may_change_from_sample_to_sample(n):
    rng = np.random.default_rng(3)
    kept, added = rng.uniform(-1.1, 1.1, (2, 2, 3, n))
    first = rng.standard_normal((2, 3, 1))
    wanted, y = np.empty((2, 3, n)), first[..., 0]
    for k in range(n):
        y = wanted[..., k] = kept[..., k] * y + added[..., k]
    np.testing.assert_allclose(recursion(kept, added, first), wanted, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("cutoff", [0.02, 0.1, 0.4])
def test_the_gyros_low_pass_is_butterworths(cutoff):
    np.testing.assert_allclose(butterworth(cutoff), signal.butter(2, 2.0 * cutoff), rtol=1e-12)
