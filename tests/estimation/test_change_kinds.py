"""What a change was: three standard deviations name it."""

import pytest

from gcs_sysid.estimation.changes.change_kinds import describe


@pytest.mark.parametrize(("sigmas", "kind"), [(2.9, "change"), (3.1, "mass_change")])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_fits_that_differ_by_three_deviations_name_the_kind(sigmas, kind, direction):
    # 0.03 and 0.04 kg are 0.05 together; a tenth of the mass is more than its hundredth.
    after = 1.5 + direction * sigmas * 0.05
    event = describe({"mass": (1.5, 0.03)}, {"mass": (after, 0.04)})
    assert event["kind"] == kind
    assert event["parameters"]["mass"]["ci95"] == pytest.approx(
        [after - 1.5 - 1.95996 * 0.05, after - 1.5 + 1.95996 * 0.05], abs=1e-5
    )


@pytest.mark.parametrize(("share", "kind"), [(0.009, "change"), (0.011, "mass_change")])
def test_less_than_a_hundredth_is_no_change_however_sure(share, kind):
    event = describe({"mass": (1.5, 1e-6)}, {"mass": (1.5 * (1.0 + share), 1e-6)})
    assert event["kind"] == kind
