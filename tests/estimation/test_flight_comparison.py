"""Whether two flights were flown by one vehicle."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.actuator_dynamics import CURVE
from gcs_sysid.estimation.flight_comparison import is_another
from gcs_sysid.estimation.online import Fit
from gcs_sysid.estimation.priors import N_UNKNOWNS
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.translation import TranslationFit
from gcs_sysid.model import rigid_body as rb

THETA = rb.theta_of(
    {
        "Ixx": 3.6e-3,
        "Iyy": 2.9e-3,
        "Izz": 5.6e-3,
        "Ixy": 1e-4,
        "Iyz": 2.6e-4,
        "Ixz": -1.5e-4,
        "moment_ratio": 0.0134,
        "rotational_damping": 2.7e-3,
    }
)


def on_commands(kappa, curve_std):
    """A fit on commands, whose T_max / m rests on a thrust curve known to `curve_std`."""
    full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    full[: rb.N_THETA, : rb.N_THETA] = np.diag((0.003 * np.abs(THETA) + 1e-6) ** 2)
    full[rb.N_THETA + CURVE, rb.N_THETA + CURVE] = curve_std**2
    rotation = RotationFit(
        THETA, full[: rb.N_THETA, : rb.N_THETA], np.eye(3), np.full(3, 0.99), 1000, True,
        full_covariance=full,
    )  # fmt: skip
    thrust = TranslationFit(kappa, 0.006, 0.2, 0.001, "momentum")
    return Fit(rotation, replace(thrust, curve_slope=3.0), 20.0)


@pytest.mark.parametrize(("curve_std", "another"), [(0.0, True), (0.5, False)])
def test_an_uncertain_thrust_curve_is_in_the_comparison(curve_std, another):
    # The figures of an unchanged PX4 vehicle: 4.313 +- .006 against 5.946 +- .042 N/kg.
    before, now = on_commands(4.313, curve_std), on_commands(5.946, curve_std)
    assert is_another(before, now, 0.28) is another
