"""Thinning keeps what an eye would miss, and breaks."""

import numpy as np
import pytest

from gcs_sysid.report.page_figures import thinned


@pytest.mark.parametrize("n", [1001, 4000, 12_345])
def test_every_peak_stays(n):
    rng = np.random.default_rng(1)
    t, values = np.arange(n) * 0.004, rng.normal(size=(n, 3))
    values[rng.integers(n, size=20), 1] = 50.0
    values[rng.integers(n, size=20), 2] = -50.0
    thin_t, thin = thinned(t, values, 1000)
    assert len(thin_t) == len(thin) <= 1002
    assert (np.diff(thin_t) >= 0.0).all()
    np.testing.assert_array_equal(np.nanmin(thin, axis=0), values.min(axis=0))
    np.testing.assert_array_equal(np.nanmax(thin, axis=0), values.max(axis=0))
    assert (thin == 50.0).any(axis=0).tolist() == [False, True, False]


def test_a_gap_stays_a_break():
    values = np.ones((4000, 1))
    values[1700:2100] = np.nan
    t, thin = thinned(np.arange(4000.0), values, 1000)
    inside = (t >= 1700) & (t < 2090)
    assert np.isnan(thin[inside]).all()
    assert np.isfinite(thin[(t < 1690) | (t > 2110)]).all()
