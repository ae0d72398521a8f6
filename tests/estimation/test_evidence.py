"""What speaks against a fit: caps on statuses, and on nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit, FitMoments
from gcs_sysid.estimation.parameters.evidence import RULES, Evidence, evidence_of
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.rotor_input import RotorInput

ROTATION = RotationFit(
    np.ones(rb.N_THETA), np.eye(rb.N_THETA), np.eye(3), np.full(3, 0.99), 5000, converged=True
)
GOOD = Validation(
    r_squared=np.full(3, 0.95),
    theil=np.full(3, 0.1),
    fitted_share=0.6,
    whiteness=np.ones(3),
    whiteness_p=np.full(3, 0.4),
    theta=ROTATION.theta,
    coordinates=np.array([0.0, 0.0, 1.0]),
)
AXES = ("roll", "pitch", "yaw")
CLAIMS = {name: p for name, p in REGISTRY.items() if p.axes}
MEAN = {name for name, p in CLAIMS.items() if p.mean_torque}


def found(validation, *, running=False, rotor_input=RotorInput.SPEED, dt=0.004, filtered=False):
    fit = Fit(ROTATION, None, 30.0, validation, running=running)
    return evidence_of(fit, rotor_input, dt, filtered=filtered)


def on(axis, usual, value):
    out = np.full(3, usual)
    out[axis] = value
    return out


def capped(evidence):
    """Names of the parameters that are `identified` no longer."""
    sure = Estimate(1.0, 1e-6, status="identified")
    return {name for name, p in CLAIMS.items() if evidence.cap(sure, p).status != "identified"}


def test_nothing_speaks_against_a_flight_that_is_predicted():
    assert found(GOOD) == Evidence()
    assert capped(found(GOOD)) == set()


def test_yaw_against_itself_is_a_swap_where_there_are_six_rotors_or_more():
    def of(rotors, r_squared):
        fit = Fit(replace(ROTATION, r_squared=np.array(r_squared)), None, 30.0, GOOD)
        return evidence_of(fit, RotorInput.SPEED, 0.004, rotors=rotors)

    swapped = of(8, [0.99, 0.99, 0.24])
    assert "24 % of yaw" in swapped.reasons[0]
    assert capped(swapped) == set(CLAIMS)
    assert of(4, [0.99, 0.99, 0.24]) == Evidence()  # two of four are seen in roll and pitch
    assert of(8, [0.9, 0.9, 0.24]) == Evidence()  # wind
    assert of(8, [0.99, 0.99, 0.9]) == Evidence()


def test_where_rotors_explain_nothing_of_what_was_flown_the_cg_is_in_doubt():
    poor = replace(GOOD, r_squared=np.array([0.9, 0.9, 0.0]))

    def of(rotors, r_squared):
        fit = Fit(replace(ROTATION, r_squared=np.array(r_squared)), None, 30.0, poor)
        return capped(evidence_of(fit, RotorInput.SPEED, 0.004, rotors=rotors))

    assert of(6, [0.9, 0.9, 0.02]) > MEAN
    assert not of(6, [0.9, 0.9, 0.3]) & MEAN  # wind
    assert not of(4, [0.9, 0.9, 0.02]) & MEAN
    assert of(4, [0.9, 0.02, 0.9]) > MEAN


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_that_hardly_turns_identifies_nothing_but_the_cg(axis):
    def moving(rms):
        window = np.zeros((rb.N_SIGNALS + 3,) * 2)
        for name, rate in zip("pqr", rms, strict=True):
            i = rb.SIGNALS.index(name)
            window[i, i] = 1000 * rate**2
        fit = Fit(ROTATION, None, 30.0, GOOD, moments=FitMoments(window[None], window, 1000))
        return evidence_of(fit, RotorInput.SPEED, 0.004)

    assert moving(on(axis, 0.3, 0.11)) == Evidence()
    still = moving(on(axis, 0.3, 0.04))
    assert AXES[axis] in still.reasons[0]
    assert "0.04 rad/s" in still.reasons[0]
    names = {name for name, p in CLAIMS.items() if axis in p.axes}
    assert capped(still) == names - MEAN


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("bad", "word"),
    [
        (lambda axis: {"r_squared": on(axis, 0.95, 0.49)}, "not predicted"),
        (lambda axis: {"r_squared": on(axis, 0.95, -3.0)}, "not predicted"),
        (lambda axis: {"r_squared": on(axis, 0.95, np.nan)}, "not predicted"),
        (
            lambda axis: {"whiteness": on(axis, 1.0, 3.1), "whiteness_p": on(axis, 0.4, 0.04)},
            "not noise",
        ),
    ],
)
def test_nothing_of_a_contradicted_axis_is_identified(axis, bad, word):
    evidence = found(replace(GOOD, **bad(axis)))
    assert evidence.capped == tuple(i == axis for i in range(3))
    # The CG rests on the mean torque, and hovering, which is not predicted, tells it best.
    free = MEAN if word == "not predicted" else set()
    assert capped(evidence) == {name for name, p in CLAIMS.items() if axis in p.axes} - free
    (reason,) = evidence.reasons
    assert word in reason
    assert AXES[axis] in reason
    assert "nan" not in reason
    assert not any(name in reason for i, name in enumerate(AXES) if i != axis)


@pytest.mark.parametrize(
    "near",
    [
        {"r_squared": np.full(3, RULES.least_r2)},
        {"whiteness": np.full(3, RULES.whiteness), "whiteness_p": np.full(3, 1e-9)},
        {"whiteness": np.full(3, 9.0), "whiteness_p": np.full(3, RULES.whiteness_p)},
        # Less slow power than white noise has: vibration, which biases little.
        {"whiteness": np.full(3, 0.1), "whiteness_p": np.full(3, 1e-9)},
        # Where no second filter is carried nothing is told.
        {"whiteness": np.full(3, np.nan), "whiteness_p": np.full(3, np.nan)},
    ],
)
def test_at_the_limits_there_is_no_cap(near):
    assert found(replace(GOOD, **near)) == Evidence()


@pytest.mark.parametrize("rotor_input", list(RotorInput))
def test_a_filtered_gyro_says_nothing_of_whiteness(rotor_input):
    colored = replace(GOOD, whiteness=np.full(3, 20.0), whiteness_p=np.full(3, 1e-9))
    assert found(colored, rotor_input=rotor_input).capped == (True, True, True)
    assert found(colored, rotor_input=rotor_input, filtered=True) == Evidence()


def test_slow_speeds_say_nothing_of_whiteness():
    """What happened between them colors residuals: no model would leave noise."""
    colored = replace(GOOD, whiteness=np.full(3, 20.0), whiteness_p=np.full(3, 1e-9))
    assert found(colored, dt=0.008).capped == (True, True, True)
    assert found(colored, dt=0.01) == Evidence()
    assert found(colored, rotor_input=RotorInput.COMMAND, dt=0.01).capped == (True, True, True)
    unpredicted = replace(colored, r_squared=np.full(3, 0.3))
    assert found(unpredicted, dt=0.02).capped == (True, True, True)


def test_without_validation_nothing_is_identified():
    evidence = found(None)
    assert capped(evidence) == set(CLAIMS)
    assert "too short" in evidence.reasons[0]
    # A flight that goes on will have one.
    assert found(None, running=True) == Evidence()
    assert evidence_of(Fit(None, None, 0.0), RotorInput.SPEED, 0.004) == Evidence()


@pytest.mark.parametrize("status", ["given", "weak", "unobservable"])
def test_a_cap_raises_nothing_and_changes_no_number(status):
    evidence = found(None)
    value = Estimate(2.0, 0.1, status=status)
    assert evidence.cap(value, REGISTRY["Ixx"]) == value
    sure = Estimate(2.0, 0.1, status="identified")
    assert evidence.cap(sure, REGISTRY["Ixx"]) == replace(sure, status="weak")


def test_what_rests_on_forces_is_not_capped():
    sure = Estimate(2.0, 0.1, status="identified")
    free = [p for p in REGISTRY.values() if not p.axes]
    assert free
    assert all(found(None).cap(sure, p) == sure for p in free)


def test_both_reasons_are_given():
    bad = replace(
        GOOD,
        r_squared=np.array([0.3, 0.95, 0.1]),
        whiteness=np.array([1.0, 7.0, 1.0]),
        whiteness_p=np.array([0.4, 0.001, 0.4]),
    )
    evidence = found(bad)
    assert evidence.capped == (True, True, True)
    assert evidence.reasons == (
        "the held-out part of the flight is not predicted on roll, yaw (10 % on yaw)",
        "residuals on pitch are not noise (whiteness 7.0 on pitch): "
        "the model lacks something there",
    )


def hover(validation, **options):
    window = np.eye(rb.N_SIGNALS + 3)  # 0.03 rad/s rms in 1000 samples
    moments = FitMoments(window[None], window, 1000)
    return evidence_of(
        Fit(ROTATION, None, 30.0, validation, moments=moments, **options), RotorInput.SPEED, 0.004
    )


def test_a_hover_is_told_what_to_fly_and_nothing_else():
    """The rest follows: without motion nothing can be predicted."""
    evidence = hover(replace(GOOD, r_squared=np.full(3, -0.2)))
    (reason,) = evidence.reasons
    assert reason.startswith("hardly any rotation in roll, pitch, yaw")
    assert reason.endswith("fly doublets there")
    assert evidence.still
    assert evidence.capped == (True, True, True)
    short = hover(None)
    assert [reason[:10] for reason in short.reasons] == ["the flight", "hardly any"]
    assert short.still
    running = hover(None, running=True)
    assert (running.reasons, running.capped) == ((reason,), (False, False, False))


def commanded(validation, curve_std):
    """Whether T_max, curve and lag are `identified`, of a fit with a thrust curve known so well."""
    full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    full[Unknown.CURVE, Unknown.CURVE] = curve_std**2
    fit = Fit(replace(ROTATION, full_covariance=full), None, 30.0, validation)
    evidence = evidence_of(fit, RotorInput.COMMAND, 0.004)
    sure = Estimate(1.0, 1e-6, status="identified")
    names = ("T_max", "thrust_curve", "motor_lag")
    return {evidence.cap(sure, REGISTRY[name]).status == "identified" for name in names}


def test_motors_are_capped_with_roll_and_pitch_that_they_are_found_from():
    assert commanded(GOOD, 0.02) == {True}
    assert commanded(None, 0.02) == {False}
    for axis in (0, 1):
        assert commanded(replace(GOOD, r_squared=on(axis, 0.95, 0.2)), 0.02) == {False}
    assert commanded(replace(GOOD, r_squared=on(2, 0.95, 0.2)), 0.02) == {True}


def test_where_the_curve_is_given_t_max_is_gravity_over_a_known_share():
    assert commanded(None, 0.0) == {True}
    assert commanded(replace(GOOD, r_squared=on(0, 0.95, 0.2)), 0.0) == {True}


def test_k_t_rests_on_no_fit_of_motors():
    evidence = found(None)
    assert (
        evidence.cap(Estimate(1.0, 1e-6, status="identified"), REGISTRY["k_T"]).status
        == "identified"
    )
