"""Logs of other people: the setting that limits them is named, and none that is set already."""

import pytest

from gcs_sysid.inspection.inspector import inspect_log

SETTINGS = {
    "groundlink-d2_log_1.bin": (["LOG_BLK_RATEMAX = 0", "SERVO_BLH_TRATE = 100"], "LOG_BITMASK"),
    "y6b-2014.bin": (["LOG_BITMASK = 1983 (now 958)", "bit 10 (RCOUT"], "bit 18"),
    "inf-now-090.bin": (["bit 0 (fast attitude)", "bit 18 (fast IMU) of LOG_BITMASK"], "(now 17"),
    "nan.log": (["set bit 0 (fast attitude) of LOG_BITMASK"], "-22"),
}
"""What is to be set, and what is not to be named."""


@pytest.mark.parametrize("name", SETTINGS)
def test_the_setting_that_limits_a_log_is_named(name, shared_log):
    log = shared_log(f"field/other/{name}")
    wanted, never = SETTINGS[name]
    advice = " ".join(o.how for o in inspect_log(log).objections if "log more" in o.how)
    assert all(words in advice for words in wanted)
    assert never not in advice
