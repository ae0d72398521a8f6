"""Thinning keeps what an eye would miss, and breaks."""

import base64

import numpy as np
import pytest

from gcs_sysid.report.page_figures import packed, thinned


def test_short_series_are_left_alone():
    t, values = np.arange(10.0), np.ones((10, 2))
    for out, given in zip(thinned(t, values, 10), (t, values), strict=True):
        np.testing.assert_array_equal(out, given)


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


def test_order_within_a_bucket_is_kept():
    values = np.tile([0.0, 5.0, 0.0, -5.0], 500)[:, None]
    _, thin = thinned(np.arange(2000.0), values, 1000)
    assert thin[:2, 0].tolist() == [5.0, -5.0]


def test_a_gap_stays_a_break():
    values = np.ones((4000, 1))
    values[1700:2100] = np.nan
    t, thin = thinned(np.arange(4000.0), values, 1000)
    inside = (t >= 1700) & (t < 2090)
    assert np.isnan(thin[inside]).all()
    assert np.isfinite(thin[(t < 1690) | (t > 2110)]).all()


def test_packed_numbers_come_back():
    values = np.array([1.5, np.nan, -2e-7])
    back = np.frombuffer(base64.b64decode(packed(values)), "<f4")
    np.testing.assert_allclose(back, values, rtol=1e-7)
