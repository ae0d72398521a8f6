"""What speaks against a fit: caps on statuses, and on nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.checks.validation import Validation
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit, FitMoments
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.judge import Stage, judge, judged
from gcs_sysid.judgement.prediction import RULES, is_hover
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import AXES, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput

ROTATION = RotationFit(
    np.ones(rb.N_THETA), np.eye(rb.N_THETA), np.eye(3), np.full(3, 0.99), 5000, converged=True
)
GOOD = Validation(
    r_squared=np.full(3, 0.95),
    theil=np.full(3, 0.1),
    held_out=np.array([[0.6, 1.0]]),
    whiteness=np.ones(3),
    whiteness_p=np.full(3, 0.4),
    Q=np.zeros((3, rb.N_SIGNALS)),
    coordinates=np.array([0.0, 0.0, 1.0]),
)
CLAIMS = {name: p for name, p in REGISTRY.items() if p.axes}
MEAN = {name for name, p in CLAIMS.items() if p.mean_torque}


QUAD, OCTO, HEXA = map(load_airframe, ("px4-quad-x", "px4-octo-x", "px4-hexa-x"))


def evidence_of(
    fit, rotor_input=RotorInput.SPEED, interval=0.004, *, airframe=QUAD, filtered=False
):
    """Of a fit by which everything is known to a millionth."""
    sure = {name: Estimate(1.0, 1e-6, p.unit) for name, p in REGISTRY.items()}
    return Evidence(sure, fit, airframe, rotor_input, interval=interval, filtered=filtered)


def found(validation, *, running=False, rotor_input=RotorInput.SPEED, dt=0.004, filtered=False):
    fit = Fit(ROTATION, None, 30.0, validation, running=running)
    return evidence_of(fit, rotor_input, dt, filtered=filtered)


def reasons(evidence):
    """What is said of the fit itself."""
    own = ("prediction", "whiteness", "motion")
    return [o.words for o in judge(evidence).objections if o.by in own]


def status(evidence, name):
    return judged(evidence, Stage.FLIGHT)[name].status


def silent(evidence):
    """Whether nothing speaks against the fit."""
    return not reasons(evidence) and not capped(evidence)


def on(axis, usual, value):
    out = np.full(3, usual)
    out[axis] = value
    return out


def capped(evidence):
    """Names of the parameters that are `identified` no longer."""
    statuses = judged(evidence, Stage.FLIGHT)
    return {name for name in CLAIMS if statuses[name].status != "identified"}


def axes_of(names):
    """Which of roll, pitch and yaw all parameters of are among these, but for the CG."""
    on = [{n for n, p in CLAIMS.items() if axis in p.axes} - MEAN for axis in range(3)]
    return tuple(own <= names for own in on)


def test_nothing_speaks_against_a_flight_that_is_predicted():
    assert silent(found(GOOD))


def test_where_rotors_explain_nothing_of_what_was_flown_the_cg_is_in_doubt():
    poor = replace(GOOD, r_squared=np.array([0.9, 0.9, 0.0]))

    def of(airframe, r_squared):
        fit = Fit(replace(ROTATION, r_squared=np.array(r_squared)), None, 30.0, poor)
        return capped(evidence_of(fit, airframe=airframe))

    assert of(HEXA, [0.9, 0.9, 0.02]) > MEAN
    assert not of(HEXA, [0.9, 0.9, 0.3]) & MEAN  # wind
    assert not of(QUAD, [0.9, 0.9, 0.02]) & MEAN
    assert of(QUAD, [0.9, 0.02, 0.9]) > MEAN


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_that_hardly_turns_identifies_nothing_but_the_cg(axis):
    def moving(rms):
        window = np.zeros((rb.N_SIGNALS + 3,) * 2)
        for name, rate in zip("pqr", rms, strict=True):
            i = rb.SIGNALS.index(name)
            window[i, i] = 1000 * rate**2
        fit = Fit(ROTATION, None, 30.0, GOOD, moments=FitMoments(window[None], window, 1000))
        return evidence_of(fit)

    assert silent(moving(on(axis, 0.3, 0.11)))
    still = moving(on(axis, 0.3, 0.04))
    (reason,) = reasons(still)
    assert AXES[axis] in reason
    assert "0.04 rad/s" in reason
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
    # The CG rests on the mean torque, and hovering, which is not predicted, tells it best.
    free = MEAN if word == "not predicted" else set()
    assert capped(evidence) == {name for name, p in CLAIMS.items() if axis in p.axes} - free
    (reason,) = reasons(evidence)
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
    assert silent(found(replace(GOOD, **near)))


@pytest.mark.parametrize("rotor_input", list(RotorInput))
def test_a_filtered_gyro_says_nothing_of_whiteness(rotor_input):
    colored = replace(GOOD, whiteness=np.full(3, 20.0), whiteness_p=np.full(3, 1e-9))
    assert capped(found(colored, rotor_input=rotor_input)) == set(CLAIMS)
    assert silent(found(colored, rotor_input=rotor_input, filtered=True))


def test_slow_speeds_say_nothing_of_whiteness():
    """What happened between them colors residuals: no model would leave noise."""
    colored = replace(GOOD, whiteness=np.full(3, 20.0), whiteness_p=np.full(3, 1e-9))
    assert capped(found(colored, dt=0.008)) == set(CLAIMS)
    assert silent(found(colored, dt=0.01))
    assert capped(found(colored, rotor_input=RotorInput.COMMAND, dt=0.01)) == set(CLAIMS)
    unpredicted = replace(colored, r_squared=np.full(3, 0.3))
    assert capped(found(unpredicted, dt=0.02)) == set(CLAIMS) - MEAN


def test_without_validation_nothing_is_identified():
    evidence = found(None)
    assert capped(evidence) == set(CLAIMS)
    assert "too short" in reasons(evidence)[0]
    # A flight that goes on will have one.
    assert silent(found(None, running=True))
    assert silent(evidence_of(Fit(None, None, 0.0)))


@pytest.mark.parametrize(
    ("std", "before"), [(0.0, "given"), (0.1, "weak"), (0.6, "unobservable"), (1e-6, "identified")]
)
def test_a_cap_raises_nothing_and_changes_no_number(std, before):
    evidence = found(None)
    evidence = replace(evidence, estimates={**evidence.estimates, "Ixx": Estimate(1.0, std)})
    after = judged(evidence, Stage.FLIGHT)["Ixx"]
    assert (after.value, after.std) == (1.0, std)
    assert after.status == ("weak" if before == "identified" else before)


def test_what_is_known_to_be_small_stays_so():
    evidence = found(None)
    evidence = replace(evidence, estimates={**evidence.estimates, "Ixy": Estimate(0.0, 1e-6)})
    assert status(evidence, "Ixy") == "zero"


def test_what_rests_on_forces_is_not_capped():
    free = [name for name, p in REGISTRY.items() if not p.axes]
    assert free
    assert {status(found(None), name) for name in free} == {"identified"}


def test_both_reasons_are_given():
    bad = replace(
        GOOD,
        r_squared=np.array([0.3, 0.95, 0.1]),
        whiteness=np.array([1.0, 7.0, 1.0]),
        whiteness_p=np.array([0.4, 0.001, 0.4]),
    )
    evidence = found(bad)
    assert axes_of(capped(evidence)) == (True, True, True)
    assert reasons(evidence) == [
        "the held-out part of the flight is not predicted on roll, yaw (10 % on yaw)",
        "residuals on pitch are not noise (whiteness 7.0 on pitch): "
        "the model lacks something there",
    ]


def hover(validation, **options):
    window = np.eye(rb.N_SIGNALS + 3)  # 0.03 rad/s rms in 1000 samples
    moments = FitMoments(window[None], window, 1000)
    return evidence_of(Fit(ROTATION, None, 30.0, validation, moments=moments, **options))


def test_a_hover_is_told_what_to_fly_and_nothing_else():
    """The rest follows: without motion nothing can be predicted."""
    evidence = hover(replace(GOOD, r_squared=np.full(3, -0.2)))
    (reason,) = reasons(evidence)
    assert reason.startswith("hardly any rotation in roll, pitch, yaw")
    assert reason.endswith("fly doublets there")
    stopped = judge(replace(evidence, frozen=0.5)).reasons
    assert [r.endswith("rad/s rms)") for r in stopped if r.startswith("hardly")] == [True]
    assert is_hover(evidence)
    assert axes_of(capped(evidence)) == (True, True, True)
    short = hover(None)
    assert [reason[:10] for reason in reasons(short)] == ["the flight", "hardly any"]
    assert is_hover(short)
    running = hover(None, running=True)
    assert reasons(running) == [reason]
    assert not capped(running)


def commanded(validation, curve_std):
    """Whether T_max, curve and lag are `identified`, of a fit with a thrust curve known so well."""
    full = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    full[Unknown.CURVE, Unknown.CURVE] = curve_std**2
    fit = Fit(replace(ROTATION, full_covariance=full), None, 30.0, validation)
    evidence = evidence_of(fit, RotorInput.COMMAND)
    names = ("T_max", "thrust_curve", "motor_lag")
    return {status(evidence, name) == "identified" for name in names}


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
    assert status(found(None), "k_T") == "identified"
