"""Notes below the table of a result."""

from dataclasses import replace

import pytest

from gcs_sysid.cli.result_table import result_table
from tests.screen.fake import result


@pytest.mark.parametrize(
    ("spikes", "words"), [(1, "1 gyro spike was replaced"), (2, "2 gyro spikes were replaced")]
)
def test_gyro_spikes_are_counted_in_singular_and_plural(spikes, words):
    one = replace(result(), telemetry={"imu_outliers": {"spikes": spikes}})
    assert f"{words} by interpolation" in result_table(one)
