"""What is said where there is less than an identification."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit, FitMoments
from gcs_sysid.judgement.evidence import Evidence, Received
from gcs_sysid.judgement.imu_faults import saturated_sensors
from gcs_sysid.judgement.judge import judge
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.signals.imu_checks import GyroAgainstAttitude, Saturated
from gcs_sysid.signals.records import Stream
from tests.known_theta import THETA

ALL = Received(frozenset({Stream.IMU, Stream.ATTITUDE, Stream.ROTOR_SPEED}), searched=True)
# Of the article's vehicle, which is plausible.
NUMBERS = {
    "mass": 1.5, "Ixx": 0.0165, "Iyy": 0.0167, "Izz": 0.0294, "Ixy": 0.0014, "Iyz": 0.0025,
    "Ixz": -0.0017, "cg_x": 0.1, "cg_y": 0.05, "k_T": 2.05e-4, "k_M": 6.14e-6,
}  # fmt: skip
SURE = {name: Estimate(value, 1e-4 * abs(value)) for name, value in NUMBERS.items()}
NOTHING = Evidence(SURE, Fit(None, None, 0.0), load_airframe("paper"), received=ALL)


def explaining(share, *, still=False):
    """Evidence of a flight of which the rotors explain this share of pitch."""
    n = rb.N_THETA
    rotation = RotationFit(THETA, 1e-12 * np.eye(n), np.eye(3), np.ones(3), 5000, True)
    rotation = replace(rotation, r_squared=np.array([0.9, share, 0.9]))
    window = 1e6 * (not still) * np.eye(rb.N_SIGNALS + 3)
    moments = FitMoments(window[None], window, 1000)
    fit = Fit(rotation, None, 30.0, running=True, moments=moments)
    return replace(NOTHING, fit=fit, turning=1.0)


def by(evidence, producer):
    return [o.words for o in judge(evidence).objections if o.by == producer]


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_rotors_are_blamed_only_where_something_was_flown(share):
    (reason,) = by(explaining(share), "data")
    assert reason.startswith(f"the rotors explain only {100.0 * share:.0f} % of the motion")
    assert by(explaining(share, still=True), "data") == []
    assert by(explaining(0.9), "data") == []


def test_rotors_are_not_blamed_for_an_imu_that_is_logged_in_its_boards_axes():
    half_turn, small = np.diag([1.0, -1.0, -1.0]), np.full((3, 3), 0.001)
    turned = GyroAgainstAttitude(half_turn, small, np.zeros(3), np.full(3, 0.1))
    found = judge(replace(NOTHING, fit=Fit(None, None, 40.0), gyro=turned))
    assert found.verdict == "refused"
    (reason,) = found.reasons
    assert "turned by roll 180 deg against the attitude's axes" in reason


def test_no_attitude_is_a_note():
    seen = frozenset({Stream.IMU, Stream.ROTOR_SPEED})
    flown = replace(explaining(0.9), received=replace(ALL, seen=seen))
    (reason,) = by(flown, "data")
    assert reason.startswith("no attitude")
    assert judge(flown).verdict == judge(explaining(0.9)).verdict


@pytest.mark.parametrize(
    ("received", "said"),
    [
        ({"seen": frozenset()}, "no usable telemetry"),
        ({"seen": frozenset(), "recorded": 12.0}, "the record lasts 12.0 s"),
        ({"seen": frozenset({Stream.ATTITUDE})}, "no IMU data"),
        ({"seen": frozenset({Stream.IMU})}, "no rotor speeds"),
        ({"has_rotors": False, "flown": 4.0}, "no rotor speeds and no commands in flight"),
        ({"has_rotors": False, "refused": {"RPM": "jumps"}}, "RPM jumps"),
        ({"outdated": True}, "came too late"),
        ({"seen": frozenset({Stream.IMU, Stream.ROTOR_SPEED})}, "never seen in the air"),
        ({"input_lost": "ESC stopped"}, "ESC stopped"),
        ({"flown": 4.0}, "only 0.0 s of 4 s in the air have all needed data"),
    ],
)
def test_the_first_thing_that_is_missing_is_the_only_reason(received, said):
    found = judge(replace(NOTHING, received=replace(ALL, **received)))
    assert found.verdict == "refused"
    (reason,) = found.reasons
    assert said in reason
    assert {e.status for e in found.estimates.values()} == {"weak"}


def test_without_a_vehicle_nothing_else_is_said():
    absent = replace(NOTHING, no_vehicle="no heartbeat", problems=("few messages",))
    assert judge(absent).reasons == ("no heartbeat",)


def test_rotors_elsewhere_than_the_vehicle_has_them_void_all_numbers():
    given = {**SURE, "mass": Estimate(1.5, 0.0)}
    found = judge(replace(explaining(0.9), estimates=given, layout=("wrong airframe: six rotors",)))
    assert found.verdict == "refused"
    assert found.reasons[0] == "wrong airframe: six rotors"
    assert found.estimates["mass"].value == 1.5
    del found.estimates["mass"]
    assert {(e.value, e.status) for e in found.estimates.values()} == {(None, "unobservable")}


@pytest.mark.parametrize(
    ("share", "verdict"), [(0.02, "identified"), (0.4, "identified"), (0.7, "partial")]
)
def test_imu_samples_that_are_not_used_are_named_where_they_are_many(share, verdict):
    loss = {"missing_percent": 100.0 * share, "longest": 2.2}
    named = {
        "missing": {"imu_loss": loss},
        "still": {"frozen": share},
        "later": {"disordered": share},
    }
    for words, unused in named.items():
        found = judge(replace(explaining(0.95), **unused))
        assert found.verdict == verdict
        assert [words in reason for reason in found.reasons] == [True] * (share > 0.1)


def test_an_imu_slower_than_rotor_data_may_be_identifies_nothing():
    assert judge(replace(explaining(0.95), interval=0.1)).verdict == "refused"


def test_what_link_or_log_say_is_a_reason_where_one_is_needed():
    assert judge(replace(explaining(0.95), problems=("few messages",))).reasons == ()
    assert judge(replace(NOTHING, problems=("few messages",))).reasons[-1] == "few messages"


def test_two_estimators_that_disagree_are_told_of_where_there_is_a_value():
    zero = SURE | {"rotor_inertia": Estimate(0.0, 1e-8)}
    apart = {"Ixx": 0.04, "rotor_inertia": 3.0}
    evidence = replace(explaining(0.9), estimates=zero, apart=apart)
    assert by(evidence, "estimator") == [
        "the online estimate differs by more than chance in Ixx: intervals hold both"
    ]
    assert by(explaining(0.9), "estimator") == []


def test_what_is_known_more_closely_than_a_sensors_flat_tops_is_weak():
    evidence = replace(NOTHING, saturated=(Saturated("gyro", 4.36, 0.03),))
    (objection,) = saturated_sensors(evidence)
    assert (objection.cap, objection.parameters) == ("weak", SURE.keys())
    assert "4.36 rad/s (250 deg/s) in 3 %" in objection.reason
    # A small product of inertia is off by a share of the moments, not of itself.
    wide = replace(NOTHING, estimates=SURE | {"Ixz": Estimate(-0.0017, 3e-4)})
    assert (
        "Ixz" not in next(saturated_sensors(replace(evidence, estimates=wide.estimates))).parameters
    )
    close = replace(evidence, estimates=SURE | {"Ixz": Estimate(-0.0017, 1e-4)})
    assert "Ixz" in next(saturated_sensors(close)).parameters
    wraps = replace(evidence, saturated=(Saturated("gyro", 4.36, 0.03, wraps=True),))
    (objection,) = saturated_sensors(replace(wraps, estimates=wide.estimates))
    assert objection.parameters == SURE.keys()
    assert "wraps around at 4.36" in objection.reason
