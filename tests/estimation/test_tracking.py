"""A vehicle that changes in flight: segments, carried knowledge, events."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.change_hypotheses import Cause
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import MISSIONS
from sim_bridge.simulation import Change, mass_step
from tests.estimation.flown import DT, GEOMETRY, RATE, VEHICLE, measured, with_payload

AT, END = 12.0, 20.0
KAPPA = VEHICLE.k_T / VEHICLE.mass


def follow(samples, block=25):
    tracker = Tracker(GEOMETRY, DT, EstimatorTuning(), ChangeTuning(), keep=True)
    t = np.arange(len(samples.gyro)) * DT
    for k in range(0, len(t), block):
        tracker.update(t[k : k + block], samples.part(slice(k, k + block)))
    return tracker


def theta_of(vehicle):
    inertia = [vehicle.Ixx, vehicle.Iyy, vehicle.Izz, vehicle.Ixy, vehicle.Iyz, vehicle.Ixz]
    lengths = [vehicle.cg_x, vehicle.cg_y, vehicle.k_M / vehicle.k_T]
    return np.concatenate([np.array(inertia) / vehicle.k_T, lengths])


CHANGES = {
    "none": (),
    "mass": (mass_step(AT, 1.2),),
    "payload": (Change(AT, "payload", with_payload),),
}


class Flights(dict):
    """Each flown when it is first asked for."""

    def __missing__(self, name):
        flight = fly_ensemble(VEHICLE, MISSIONS["all-axes"], RATE, END, changes=CHANGES[name])
        self[name] = measured(flight)
        return self[name]


class Tracked(dict):
    """Each followed when it is first asked for."""

    def __init__(self, flights):
        self.flights = flights

    def __missing__(self, name):
        self[name] = follow(self.flights[name])
        return self[name]


@pytest.fixture(scope="module")
def flights():
    return Flights()


@pytest.fixture(scope="module")
def tracked(flights):
    return Tracked(flights)


@pytest.mark.slow
def test_nothing_happens_where_nothing_changes(tracked):
    tracker = tracked["none"]
    assert tracker.events == []
    assert tracker.segments == []
    assert tracker.fit().translation.kappa == pytest.approx(KAPPA, rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["payload", pytest.param("mass", marks=pytest.mark.thorough)])
def test_a_change_ends_a_segment(tracked, name):
    tracker = tracked[name]
    (event,), (segment,) = tracker.events, tracker.segments
    assert AT <= event.detected <= AT + 1.0
    assert event.onset == pytest.approx(AT, abs=2 * DT)
    assert segment.end == event.onset
    assert event.segment == 0
    assert event.cause.kind == ("mass_change" if name == "mass" else "payload")
    after = with_payload(VEHICLE) if name == "payload" else replace(VEHICLE, mass=1.8)
    # Neither fit has seen the other's flight.
    for fit, vehicle in ((segment.fit, VEHICLE), (tracker.fit(), after)):
        kappa = vehicle.k_T / vehicle.mass
        assert fit.translation.kappa == pytest.approx(kappa, rel=0.004)
        theta = theta_of(vehicle)
        assert fit.rotation.theta[:9] == pytest.approx(theta, rel=0.06)
        assert fit.rotation.theta[:2] == pytest.approx(theta[:2], rel=0.01)


@pytest.mark.slow
def test_what_the_rotors_own_is_known_at_once_after_a_change(flights):
    whole = flights["mass"]
    early = round((AT + 1.2) / DT)
    tracker = follow(whole.part(slice(0, early)))
    before, now = tracker.segments[0].fit, tracker.fit()
    assert now.seconds < 1.5
    assert now.translation.source == "accelerometer"
    assert now.translation.kappa == pytest.approx(KAPPA / 1.2, rel=0.005)
    assert now.translation.kappa_std < 0.01 * now.translation.kappa
    # What is the rotors' own carries over.
    ratio = rb.MOMENT_RATIO
    assert now.rotation.std[ratio] < 1.01 * before.rotation.std[ratio]
    assert abs(now.rotation.theta[ratio] - before.rotation.theta[ratio]) < (
        3.0 * before.rotation.std[ratio]
    )


@pytest.mark.slow
def test_a_failing_rotor_stops_the_estimate(flights):
    samples = replace(flights["none"], speeds=flights["none"].speeds.copy())
    samples.speeds[round(AT / DT) :, 1] /= np.sqrt(0.85)
    tracker = follow(samples)
    (event,) = tracker.events
    assert event.cause.kind == "rotor_failure"
    assert event.cause.rotor == 1
    assert tracker.stopped
    assert tracker.segments == []
    # What the failed rotor did is not in the estimate.
    assert tracker.fit().rotation.theta[:2] == pytest.approx(theta_of(VEHICLE)[:2], rel=0.01)


@pytest.mark.slow
def test_kept_samples_are_those_of_the_segment_in_force(tracked):
    kept = sum(len(part.gyro) for part in tracked["payload"].kept)
    assert kept == pytest.approx((END - AT) / DT, abs=30)


def test_a_change_takes_the_third_of_a_second_before_it_along(truth, flight):
    """The onset is an estimate, and what led up to it is not the vehicle as it was."""
    rng = np.random.default_rng(1)
    gyro = flight.gyro + 0.005 * rng.standard_normal(flight.gyro.shape)
    force = flight.force + 0.05 * rng.standard_normal(flight.force.shape)
    dt, at, now = 0.005, 15.0, 16.0
    samples = replace(flight, gyro=gyro, rates=gyro, force=force).part(slice(0, round(now / dt)))
    # Batches, of which whole ones are forgotten, as short as two rows.
    tuning = EstimatorTuning(smoother="window", batch_time=0.05)
    tracker = Tracker(truth.geometry, dt, tuning, ChangeTuning())
    tracker.update(np.arange(len(samples.gyro)) * dt, samples)
    cause = Cause("mass_change", None, 0.0, 0.0, 1.2, (0.0, 0.0), 0.9)
    decided = SimpleNamespace(onset=at, cause=cause, settled=at)
    alarm = SimpleNamespace(detected=at + 0.1, channel="thrust")
    tracker._change(alarm, decided, now)
    (segment,) = tracker.segments
    assert segment.end == at
    # Rows are 25 ms apart, and the first ends 0.31 s from the start: window, and room for delays.
    newest = 0.31 + segment.fit.seconds - 0.025
    assert at - 0.3 - 0.1 < newest <= at - 0.3
    # Landing at once shows that it was contact.
    tracker.update(np.array([now]), samples.part(slice(0, 1)), np.array([False]))
    (event,) = tracker.events
    assert (event.cause.disturbance, event.decided, tracker.segments) == ("contact", None, [])
    assert tracker.start == 0.0
