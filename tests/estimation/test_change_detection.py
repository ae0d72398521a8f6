"""Change detection on emulated flights with MEMS noise, against a reference that is known."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.change_hypotheses import describe
from gcs_sysid.estimation.changes.change_watch import ChangeWatch
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.simulation import Change, mass_step
from tests.estimation.flown import DT, GEOMETRY, RATE, VEHICLE, measured, with_payload
from tests.known_theta import theta_from

AT = 6.0
"""s, when the vehicle changes."""


CHANGES = {
    "mass": mass_step(AT, 1.2),
    "payload": Change(AT, "payload", with_payload),
    "cg": Change(AT, "cg_shift", lambda v: replace(v, cg_x=v.cg_x + 0.015)),
}


def fly(mission, seconds, changes=(), turbulence=None):
    return fly_ensemble(
        VEHICLE, MISSIONS[mission], RATE, seconds, turbulence=turbulence, changes=changes
    )


def reference(delay=0.0, r_squared=0.99, kappa_factor=1.0):
    v = VEHICLE
    inertia = np.array([v.Ixx, v.Iyy, v.Izz, v.Ixy, v.Iyz, v.Ixz]) / v.k_T
    theta = theta_from(*inertia, v.cg_x, v.cg_y, v.k_M / v.k_T, 0.0, 0.0)
    rotation = RotationFit(
        theta=theta,
        covariance=np.diag((0.002 * np.abs(theta) + 1e-9) ** 2),
        residual_covariance=np.eye(3),
        r_squared=np.full(3, r_squared),
        rows=1000,
        converged=True,
        coordinates=np.array([delay, 0.0, 1.0]),
    )
    kappa = kappa_factor * v.k_T / v.mass
    return Fit(rotation, TranslationFit(kappa, 0.001 * kappa, 0.1, 0.01, "momentum"), 10.0)


def watch(samples, fit=None, block=25, known=None, start=0.0):
    """The watch, all its alarms, and what was decided on some of them."""
    known = known or ChangeWatch(GEOMETRY, DT, ChangeTuning(), EstimatorTuning())
    known.arm(fit or reference(), 0.0, moments=True)
    t = start + np.arange(len(samples.gyro)) * DT
    alarms, decided, k = [], [], 0
    while k < len(t):
        part = slice(k, k + block)
        k += known.watch(t[part], samples.part(part))
        alarms += [alarm for alarm in known.alarms if alarm not in alarms]
        decided += known.decided(t[k - 1])
    return known, alarms, decided


@pytest.fixture(scope="module")
def quiet_flight():
    return fly("all-axes", 12.0)


@pytest.fixture(scope="module")
def changed():
    return {name: fly("all-axes", AT + 1.3, [change]) for name, change in CHANGES.items()}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_mass_step_is_called_within_a_second(changed, seed):
    _, (alarm,), ((decided, found),) = watch(measured(changed["mass"], seed))
    assert decided is alarm
    assert alarm.channel == "thrust"
    assert alarm.detected <= AT + 1.0
    assert abs(alarm.onset - AT) <= 2 * DT
    assert (found.verdict, found.cause.kind) == ("changed", "mass_change")
    assert found.cause.mass_ratio == pytest.approx(1.2, abs=0.015)


def test_payload_is_told_from_a_mass_alone(changed):
    _, _, ((_, found),) = watch(measured(changed["payload"]))
    assert (found.verdict, found.cause.kind) == ("changed", "payload")
    # At the inertia before, of which there is a tenth more now.
    shift = 0.1 / 6.0 / 1.1, 0.05 / 6.0 / 1.1
    assert found.cause.cg_shift == pytest.approx(shift, abs=0.002)


def test_a_moment_alone_may_be_the_winds(changed):
    """A CG that moves leaves what a gust leaves: it is seen, but no change is called."""
    _, (alarm, *_), decided = watch(measured(changed["cg"]))
    assert alarm.channel != "thrust"
    assert all(found.verdict != "changed" for _, found in decided)


@pytest.mark.slow
@pytest.mark.parametrize("rotor", [0, 3])
def test_weak_rotor_is_named_with_its_loss(quiet_flight, rotor):
    samples = measured(quiet_flight)
    # To make the same thrust with 15 % less of it, this rotor must have turned faster.
    samples.speeds[round(AT / DT) :, rotor] /= np.sqrt(0.85)
    _, _, ((_, found), *_) = watch(samples)
    assert (found.verdict, found.cause.kind) == ("changed", "rotor_failure")
    assert found.cause.rotor == rotor
    assert found.cause.loss == pytest.approx(0.15, abs=0.01)


def test_small_mass_step_is_seen_by_means(quiet_flight):
    samples = measured(quiet_flight)
    samples.force[round(AT / DT) :] /= 1.015
    _, (alarm, *_), _ = watch(samples)
    assert alarm.channel == "thrust"
    assert AT + 0.2 < alarm.detected < AT + 1.5
    assert abs(alarm.onset - AT) < 0.3


def test_no_alarm_without_a_change(quiet_flight):
    for seed in range(1, 6):
        assert watch(measured(quiet_flight, seed))[1] == []


@pytest.mark.slow
def test_no_alarm_in_gusts():
    for flight in (fly("hover", 10.0), fly("all-axes", 10.0, turbulence=0.02)):
        assert watch(measured(flight))[1] == []


def test_no_alarm_from_spikes_and_gaps(quiet_flight):
    samples = measured(quiet_flight)
    samples.gyro[1500] += 3.0
    samples.force[1700:1702] += 20.0
    samples.speeds[1900, 1] = 0.0
    samples.gyro[2000:2100] = np.nan
    samples.rates[2000:2100] = np.nan
    samples.speeds[2200:2230] = np.nan
    samples.force[2300:2500] = np.nan
    assert watch(samples)[1] == []


def test_rotor_delay_of_the_fit_is_made_up_for(quiet_flight, changed):
    late = 5
    for flight, count in ((quiet_flight, 0), (changed["mass"], 1)):
        samples = measured(flight)
        samples.speeds[late:] = samples.speeds[:-late].copy()
        _, alarms, _ = watch(samples, reference(delay=late * DT))
        assert len(alarms) == count


def test_a_renewed_reference_is_no_change(quiet_flight):
    samples = measured(quiet_flight)
    cut = 2000
    known, _, _ = watch(samples.part(slice(0, cut)))
    # 3 % in kappa is 0.3 m/s^2: six noise levels, if it were taken for a jump.
    fit = reference(kappa_factor=1.03)
    later = samples.part(slice(cut, None))
    assert watch(later, fit, known=known, start=cut * DT)[1] == []


def test_the_next_change_is_seen_too(quiet_flight):
    """After an alarm, residuals count from what they are then."""
    samples = measured(quiet_flight)
    first, second = round(5.0 / DT), round(8.0 / DT)
    samples.force[first:second] /= 1.2
    samples.force[second:] /= 1.4
    _, alarms, _ = watch(samples)
    one, two = (alarm for alarm in alarms if alarm.channel == "thrust")
    assert (one.onset, two.onset) == pytest.approx((5.0, 8.0), abs=2 * DT)


@pytest.mark.parametrize(("translation", "seen"), [(True, True), (False, False)])
def test_a_poor_fit_watches_nothing_but_its_thrust(changed, translation, seen):
    fit = reference(r_squared=0.5)
    samples = measured(changed["mass"])
    _, alarms, _ = watch(samples, fit if translation else replace(fit, translation=None))
    assert [alarm.channel for alarm in alarms] == ["thrust"] * seen


def test_memory_is_bounded(quiet_flight):
    samples = measured(quiet_flight)
    known = None
    for i in range(6):
        known, _, _ = watch(samples, block=1000, known=known, start=12.0 * i)
        known.early(reference())
    assert len(known.since(-1.0).gyro) * DT < 16.0


BEFORE = {
    "mass": (1.5, 0.001),
    "Ixx": (0.0165, 2e-5),
    "cg_x": (0.1, 1e-4),
    "k_T": (2.05e-4, 0.0),
    "Ixy": (None, None),
}


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({"mass": (1.8, 0.002)}, "mass_change"),
        ({"mass": (1.8, 0.002), "cg_x": (0.115, 2e-4)}, "payload"),
        ({"mass": (1.8, 0.002), "Ixx": (0.0182, 1e-4)}, "payload"),
        ({"cg_x": (0.115, 2e-4)}, "cg_shift"),
        ({"Ixx": (0.0182, 1e-4)}, "inertia_change"),
        ({"Ixx": (0.0182, 1e-3)}, "change"),
    ],
)
def test_fits_before_and_after_name_the_kind(changes, kind):
    event = describe(BEFORE, {**BEFORE, **changes})
    assert event["kind"] == kind
    assert "Ixy" not in event["parameters"]
    for name, (value, _) in changes.items():
        entry = event["parameters"][name]
        assert entry["difference"] == pytest.approx(value - BEFORE[name][0])
        assert entry["ci95"][0] < entry["difference"] < entry["ci95"][1]
