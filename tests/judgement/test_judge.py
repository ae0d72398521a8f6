"""From fits to statuses and verdict: what is claimed of known numbers."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.checks.model_tests import RigidBodyTest
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.online.fit import Fit, FitMoments
from gcs_sysid.estimation.parameters.physical_parameters import physical_parameters
from gcs_sysid.judgement import judge as room
from gcs_sysid.judgement.evidence import ClockDoubt, Evidence
from gcs_sysid.judgement.judge import Producer, Stage, judge, judged, object_to
from gcs_sysid.judgement.prediction import RULES
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import ScaleReference, load_airframe
from gcs_sysid.model.estimate import Estimate, Objection
from gcs_sysid.model.parameters import CORE_OF
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result import Result
from gcs_sysid.signals.imu_checks import GyroAgainstAttitude

PAPER = load_airframe("paper")
MASS, K_T = 1.5, 2.05e-4
TRUE = {
    "mass": MASS, "Ixx": 0.0165, "Iyy": 0.0167, "Izz": 0.0294,
    "Ixy": 0.00135, "Iyz": 0.00254, "Ixz": -0.00166, "cg_x": 0.1, "cg_y": 0.05,
    "k_T": K_T, "k_M": 6.14e-6, "moment_ratio": 6.14e-6 / K_T,
    "rotational_damping": 0.004, "rotor_inertia": 6e-5, "linear_drag": 0.25,
}  # fmt: skip
THETA = rb.theta_of(TRUE, K_T)
KAPPA, DELTA = K_T / MASS, TRUE["linear_drag"] / MASS
TRANSLATION = TranslationFit(KAPPA, 0.002 * KAPPA, DELTA, 0.01 * DELTA, "momentum")
ANCHOR = ScaleReference("mass", MASS)


def flight(share=0.003, *, moving=1.0, r_squared=(0.99, 0.99, 0.99), anchor=ANCHOR, **known):
    """Evidence of a flight that goes on, by a fit that knows theta to this share."""
    covariance = np.diag((share * THETA) ** 2)
    fit = RotationFit(THETA, covariance, np.eye(3), np.array(r_squared), 1000, True)
    window = 1e3 * moving**2 * np.eye(rb.N_SIGNALS + 3)
    whole = Fit(fit, TRANSLATION, 30.0, running=True, moments=FitMoments(window, window, 1000))
    whole = replace(whole, **{n: known.pop(n) for n in ("rigid_body_test",) if n in known})
    estimates = physical_parameters(anchor, fit, TRANSLATION, PAPER.arm)
    return Evidence(estimates, whole, PAPER, **known)


def claimed(*args, **known):
    return judged(flight(*args, **known))


def replaced(evidence, **estimates):
    return replace(evidence, estimates={**evidence.estimates, **estimates})


def test_what_is_small_against_a_moment_that_is_not_known_is_not_known():
    sure = flight()
    wide = replace(sure.estimates["Ixx"], std=1.0)
    small = replace(sure.estimates["Ixy"], value=0.0, std=1e-6)
    assert judged(replaced(sure, Ixy=small))["Ixy"].status == "zero"
    assert judged(replaced(sure, Ixy=small, Ixx=wide))["Ixy"].status == "unobservable"


def test_a_flight_that_shows_all_is_identified():
    found = judge(flight())
    assert (found.verdict, found.reasons, found.objections) == ("identified", (), ())
    assert found.estimates["mass"].status == "given"
    assert not any(e.objections for e in found.estimates.values())


@pytest.mark.parametrize(
    ("share", "status"),
    [(0.049, "identified"), (0.051, "weak"), (0.49, "weak"), (0.51, "unobservable")],
)
def test_status_follows_the_relative_std(share, status):
    values = claimed(share, anchor=ScaleReference("k_T", K_T))
    for name in ("Ixx", "Iyy", "Izz", "k_M", "moment_ratio"):
        assert values[name].status == status
        assert values[name].value == pytest.approx(TRUE[name])


@pytest.mark.parametrize(
    ("r_squared", "lowered"),
    [
        ((0.99, 0.99, 0.99), {}),
        ((0.7, 0.99, 0.99), {"Ixx": "weak", "Ixy": "weak", "Ixz": "weak"}),
        ((0.99, 0.99, 0.7), {"Izz": "weak", "k_M": "weak", "Iyz": "weak", "Ixz": "weak"}),
        ((0.99, 0.99, 0.3), {"Izz": "unobservable", "k_M": "unobservable"}),
    ],
)
def test_status_falls_where_the_model_explains_too_little(r_squared, lowered):
    values = claimed(r_squared=r_squared)
    for name, status in lowered.items():
        assert values[name].status == status
        (objection, *_) = values[name].objections
        assert (objection.by, "explain" in objection.reason) == ("explained", True)
    # The CG and the scale rest on mean torque and thrust.
    assert {values[n].status for n in ("cg_x", "cg_y", "k_T")} == {"identified"}
    if r_squared[0] > 0.8:
        assert values["Ixx"].status == "identified"


def test_an_objection_never_raises_a_status():
    assert claimed(1.0, r_squared=(0.7, 0.7, 0.7))["Izz"].status == "unobservable"


@pytest.mark.parametrize(("share", "contradicted"), [(1.0, False), (0.0, True)])
def test_what_gyroscopic_torque_contradicts_is_not_observable(share, contradicted):
    test = RigidBodyTest(np.full(3, share), np.full(3, 0.01))
    found, usual = judge(flight(rigid_body_test=test)), claimed()
    values = found.estimates
    assert any("rigid body" in reason for reason in found.reasons) is contradicted
    status = "unobservable" if contradicted else "identified"
    for name in ("Izz", "k_M", "moment_ratio", "Ixy", "Iyz", "Ixz"):
        assert values[name].status == status, name
    for name in ("Ixx", "Iyy"):
        assert values[name].status == "identified"
        more = RULES.not_rigid * TRUE[name] if contradicted else 0.0
        assert values[name].std == pytest.approx(np.hypot(usual[name].std, more))
    assert values["cg_x"] == usual["cg_x"]


def test_numbers_that_are_none_are_not_shown():
    evidence = replaced(flight(), Ixx=Estimate(np.nan, 1.0))
    found = judge(evidence)
    assert (found.estimates["Ixx"].value, found.estimates["Ixx"].status) == (None, "unobservable")
    assert found.verdict == "partial"
    assert "Ixx" in found.reasons[0]


def with_spreads(spreads, **options):
    """A flight that knows these parameters to such a share of their values."""
    evidence = flight(**options)
    known = {n: replace(evidence.estimates[n], std=s * abs(TRUE[n])) for n, s in spreads.items()}
    known = {n: e for n, e in known.items() if n != "mass"}
    return judge(replaced(evidence, **known))


@pytest.mark.parametrize(
    ("spreads", "word", "said"),
    [
        ({}, "identified", []),
        ({"Ixx": 0.2}, "partial", ["weak: Ixx"]),
        ({"Ixx": 0.9}, "partial", ["not observable from this flight: Ixx"]),
        ({"Izz": 0.2, "k_M": 0.2}, "partial", ["weak: Izz, k_M", "one scale"]),
        ({"Izz": 0.2, "k_M": 0.9}, "partial", ["k_M", "weak: Izz", "one scale"]),
        (
            dict.fromkeys(CORE_OF[RotorInput.SPEED], 9.0),
            "refused",
            ["not observable from this flight: Ixx, Iyy", "one scale"],
        ),
    ],
)
def test_verdict_and_its_reasons(spreads, word, said):
    found = with_spreads(spreads)
    assert found.verdict == word
    assert len(found.reasons) == len(said)
    for text, reason in zip(said, found.reasons, strict=True):
        assert text in reason


@pytest.mark.parametrize(("ratio", "negative"), [(-0.29, False), (-0.31, True)])
def test_a_rotor_torque_surely_negative_is_a_wrong_spin(ratio, negative):
    """By more than three standard deviations."""
    found = judge(replaced(flight(), moment_ratio=Estimate(ratio, 0.1)))
    assert any("check spin" in reason for reason in found.reasons) is negative


def test_a_hover_is_not_told_to_separate_what_it_did_not_move():
    found = with_spreads(dict.fromkeys(CORE_OF[RotorInput.SPEED], 9.0), moving=0.0)
    assert found.verdict == "refused"
    assert not any("one scale" in reason for reason in found.reasons)


def test_a_refused_result_claims_nothing():
    found = with_spreads(dict.fromkeys(CORE_OF[RotorInput.SPEED], 9.0)).estimates
    assert found["linear_drag"].status == "weak"
    assert found["mass"].status == "given"


@pytest.mark.parametrize(
    ("share", "status"), [(0.045, "identified"), (0.05, "weak"), (0.9, "weak")]
)
def test_givens_widen_and_limit_but_the_flight_still_tells(share, status):
    stds = {"mass": 0.3, "Ixx": share * TRUE["Ixx"]}
    usual, found = claimed(), judge(flight(given=stds))
    Ixx, mass = found.estimates["Ixx"], found.estimates["mass"]
    assert Ixx.std == pytest.approx(np.hypot(usual["Ixx"].std, stds["Ixx"]))
    assert Ixx.std_given == pytest.approx(stds["Ixx"])
    assert Ixx.std_data == pytest.approx(usual["Ixx"].std)
    assert Ixx.status == status
    assert (mass.status, mass.std) == ("given", 0.3)
    assert any("given values limit Ixx" in r for r in found.reasons) is (status == "weak")


def test_a_doubted_clock_widens_before_a_status_is_given():
    found = judge(flight(clock=ClockDoubt(0.06)))
    assert found.verdict == "partial"
    assert "6.00 % fast" in found.reasons[0]
    assert found.estimates["Ixx"].status == "weak"  # 0.3 % by the flight, 6 % by its clock
    assert found.estimates["Ixx"].std_given == 0.0
    assert found.estimates["cg_x"].status == "identified"


def test_what_is_too_small_to_be_true_is_known_in_part():
    found = judge(replace(flight(), airframe=PAPER.with_arm(10.0)))
    assert found.verdict == "partial"
    assert {e.status for e in found.estimates.values()} == {"given", "weak"}


def test_one_function_and_one_row_make_an_objection(monkeypatch):
    def full_moon(evidence):
        yield Objection("the moon was full", frozenset({"Iyy"}), cap="weak", verdict="partial")

    row = Producer("moon", full_moon, Stage.BELIEF)
    monkeypatch.setattr(room, "PRODUCERS", (row, *room.PRODUCERS))
    found = judge(flight())
    assert (found.verdict, found.reasons) == ("partial", ("the moon was full",))
    assert found.estimates["Iyy"].status == "weak"
    assert found.estimates["Iyy"].as_json()["objections"] == [
        {"reason": "the moon was full", "cap": "weak", "by": "moon"}
    ]
    assert found.objections[0].as_json() == {
        "reason": "the moon was full", "cap": "partial", "by": "moon"
    }  # fmt: skip


def test_what_becomes_known_later_is_added():
    result = Result("identified", (), "", {}, None, RotorInput.SPEED, {})
    silent, note = Objection("slow link", by="link"), Objection("lost", verdict="identified")
    assert object_to(result, [silent]) == result
    assert object_to(result, [note]).reasons == ("lost",)
    lower = object_to(result, [Objection("cut", verdict="partial", by="x"), silent])
    assert (lower.verdict, lower.reasons) == ("partial", ("cut", "slow link"))


def test_a_gyro_that_contradicts_the_attitude_limits_what_rests_on_it():
    sound = GyroAgainstAttitude(np.eye(3), np.full((3, 3), 0.001), np.zeros(3), np.full(3, 0.1))
    assert judge(flight(gyro=sound)) == judge(flight())
    found = judge(flight(gyro=replace(sound, gain=0.5 * np.eye(3))))
    assert found.verdict == "partial"
    assert any("reads 0.50 of what the attitude turns" in reason for reason in found.reasons)
    assert found.estimates["Ixx"].status == "weak"
    assert found.estimates["k_T"].status == "identified"
    # Gyroscopic torques on roll and pitch have the yaw rate: by them Ixy shows.
    found = judge(flight(gyro=replace(sound, gain=np.diag([1.0, 1.0, -1.0]))))
    assert (found.estimates["Ixy"].status, found.estimates["Ixx"].status) == ("weak", "identified")
    # One that turns where nothing does tilts the attitude, and thrust with it.
    biased = replace(sound, bias=np.array([0.01, 0.5, -0.02]))
    found = judge(flight(gyro=biased))
    assert any("pitch axis reads +0.50 rad/s beside what" in reason for reason in found.reasons)
    assert {found.estimates[name].status for name in ("Iyy", "k_T")} == {"weak"}
    assert found.estimates["Ixx"].status == "identified"
