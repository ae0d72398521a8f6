"""Notes below the table of a result."""

from dataclasses import replace

from gcs_sysid.results.result_view import result_table
from tests.screen.fake import result


def test_a_gyro_filter_that_was_found_is_told():
    found = replace(result(), telemetry={"rotor_input": {"gyro_filter_found": 24.6}})
    assert "late as by a filter of 25 Hz" in result_table(found)
    assert "gyro_filter in the airframe file" in result_table(found)
    none = replace(result(), telemetry={"rotor_input": {"gyro_filter_found": None}})
    assert "filter" not in result_table(none)
