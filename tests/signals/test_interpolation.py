"""Which gaps between samples are bridged."""

import pytest

from gcs_sysid.signals.interpolation import SAME, usual_gap


@pytest.mark.parametrize(
    ("interval", "gap"),
    [
        (0.004, 0.04),  # 250 Hz: a shorter time is no gap
        (0.01, 0.052),  # 100 Hz: four lost samples
        (0.02, 0.064),  # 50 Hz: two, not four
        (0.05, 0.13),  # 20 Hz: one
    ],
)
def test_what_is_bridged_depends_on_the_rate(interval, gap):
    assert usual_gap(interval) == pytest.approx(gap + SAME, abs=1e-9)
