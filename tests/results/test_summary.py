"""What a fit comes to while a flight goes on, and at its end."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.changes.tracking import TrackingEvent
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.noise.uncertainty import watched_factor
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.model.airframe import ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.summary import event_of, next_anchor, values_of
from tests.known_theta import THETA

SHARE = 0.04
ROTATION = RotationFit(
    THETA, np.diag((SHARE * THETA) ** 2), np.eye(3), np.full(3, 0.99), 1000, converged=True
)
FIT = Fit(ROTATION, TranslationFit(1.4e-4, 1e-6, 0.2, 0.001, "momentum"), 20.0)
MASS = ScaleReference("mass", 1.5)


def test_intervals_of_a_running_flight_hold_at_all_times():
    final = values_of(FIT, MASS, 0.35, {})
    running = values_of(replace(FIT, running=True), MASS, 0.35, {})
    assert running["mass"] == final["mass"]
    for name in ("Ixx", "Ixy", "cg_x", "k_T", "k_M", "moment_ratio", "linear_drag"):
        assert running[name].value == final[name].value
        wider = watched_factor(20.0 / 3.0) * final[name].std  # claimed from 3 s on
        assert running[name].std == pytest.approx(wider, rel=1e-3)


def test_nothing_but_the_anchor_at_first():
    early = values_of(replace(FIT, seconds=2.9, running=True), MASS, 0.35, {})
    assert (early["mass"].value, early["mass"].std) == (1.5, 0.0)
    assert early["Ixx"].value is None


@pytest.mark.parametrize(("thrust", "other"), [("k_T", "T_max"), ("T_max", "k_T")])
def test_the_scale_carries_over_a_change_with_speeds_and_with_commands(thrust, other):
    values = {
        "mass": Estimate(1.5, 0.0, status="given"),
        thrust: Estimate(8.2, 0.02, status="identified"),
    }
    after = next_anchor(MASS, values, 31.2)
    assert (after.kind, after.value, after.std) == (thrust, 8.2, 0.02)
    assert after.origin
    given = ScaleReference(thrust, 8.0)
    assert next_anchor(given, values, 31.2).value == 8.0
    unknown = {**values, thrust: Estimate(None, None, status="unobservable")}
    assert next_anchor(MASS, unknown, 31.2) is MASS
    assert other not in values


def test_what_no_flight_determines_has_not_changed():
    """After a payload was dropped in hover a fit of inertia is anything."""
    before = {
        "mass": Estimate(1.5, 0.01, status="given"),
        "Iyy": Estimate(0.026, 1e-4, status="identified"),
    }
    after = {
        "mass": Estimate(1.25, 0.01, status="identified"),
        "Iyy": Estimate(0.042, 1e-3, status="unobservable"),
    }
    event = event_of(TrackingEvent(43.0, 43.2, None, None, 0, decided=44.0), before, after)
    assert event["kind"] == "mass_change"
    assert set(event["parameters"]) == {"mass"}
    after["Iyy"] = replace(after["Iyy"], status="identified")
    event = event_of(TrackingEvent(43.0, 43.2, None, None, 0, decided=44.0), before, after)
    assert (event["kind"], set(event["parameters"])) == ("payload", {"mass", "Iyy"})
