"""Slow telemetry makes intervals wide, and none of them false."""

import pytest

import gcs_sysid


@pytest.mark.slow
@pytest.mark.parametrize("seed", ["0", pytest.param("1", marks=pytest.mark.thorough)])
def test_what_slow_samples_miss_of_doublets_is_in_the_intervals(fly, seed):
    flight = fly(
        *("--airframe", "px4-quad-x", "--rate", "25", "--mission", "doublets"),
        *("--duration", "40", "--noise", "mems", "--seed", seed),
    )
    truth = flight.truth
    result = gcs_sysid.analyze(flight.tlog, "px4-quad-x", arm=0.25, mass=1.0)
    identified = {n: e for n, e in result.parameters.items() if e.status == "identified"}
    assert {"Ixx", "Iyy", "k_T", "cg_x", "cg_y"} <= identified.keys()
    off = {n: abs(e.value - truth[n]) / (1.96 * e.std) for n, e in identified.items()}
    assert max(off.values()) < 1.0, off
