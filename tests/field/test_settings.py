"""Logs of other people: the setting that limits them is named, and none that is set already."""

import pytest

from gcs_sysid.inspection.inspector import inspect_log

SETTINGS = {
    "groundlink-d2_log_1.bin": (["LOG_BLK_RATEMAX = 0", "SERVO_BLH_TRATE = 100"], "LOG_BITMASK"),
    "y6b-2014.bin": (["LOG_BITMASK = 1982 (now 958)", "bit 10 (RCOUT"], "bit 18"),
    "inf-now-090.bin": (["bit 18 (fast IMU) of LOG_BITMASK", "SERVO_BLH_TRATE"], "bit 10"),
    "nan.log": (["log rotor speeds (ESC telemetry)"], "LOG_BITMASK"),
}
"""What is to be set, and what is not to be named."""


@pytest.mark.parametrize("name", SETTINGS)
def test_the_setting_that_limits_a_log_is_named(name, shared_log):
    log = shared_log(f"field/other/{name}")
    wanted, never = SETTINGS[name]
    advice = " ".join(o.how for o in inspect_log(log).objections)
    assert all(words in advice for words in wanted)
    assert never not in advice
