"""What an alarm is taken for: changes of a hovering vehicle, and all that looks like them."""

import numpy as np
import pytest

from gcs_sysid.estimation.changes.change_hypotheses import judge
from gcs_sysid.estimation.changes.change_reference import N_X, TOTAL, Actuator, Reference
from gcs_sysid.estimation.changes.change_window import (
    TUNING,
    AlarmWindow,
    ResidualHistory,
    covariance,
    strengths,
)
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.records import Samples
from tests.known_theta import theta_from

GEOMETRY = np.array([[0.25, -0.25, 0.25, -0.25], [0.25, -0.25, -0.25, 0.25], [1, 1, -1, -1]])
THETA = theta_from(80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.0, 0.0, 0.03, 0.0, 0.0)
SUM = 7e4
"""rad^2/s^2, squared speeds in hover."""
KAPPA = GRAVITY / SUM
DT, AT, END = 0.004, 5.0, 11.5
TIME = np.arange(0.0, END, DT)
LATER = TIME >= AT
LAST = len(TUNING.ages) - 1
STEP = 0.25
"""s between means of the history."""


def reference(watched=(0, 1, 2, 3), actuator=None):
    matrix = np.full((4, N_X), np.nan)
    rows = np.zeros((4, N_X))
    rows[0, TOTAL] = -KAPPA
    rows[1:, : rb.N_SIGNALS] = rb.forward_matrix(THETA)
    matrix[list(watched)] = rows[list(watched)]
    return Reference(GEOMETRY, matrix, 0.0, actuator)


def fly(thrust=1.0, share=0.0, force=0.0, turn=(0.0, 0.0, 0.0), velocity=None, seed=1):
    """Samples of a hover in which something happens.

    Args:
        thrust: (n,) sum of squared speeds over that in hover.
        share: (n,) of thrust over mass that is gone.
        force: (n,) m/s^2 down, besides.
        turn: three (n,) rad/s^2.
        velocity: (n, 3) m/s; None: not sent.
    """
    rng = np.random.default_rng(seed)
    n = len(TIME)
    total = SUM * np.broadcast_to(thrust, n) * (1.0 + 0.01 * np.sin(3.0 * TIME))
    f_z = -KAPPA * total * (1.0 - np.asarray(share)) + force
    rates = np.stack([np.cumsum(np.broadcast_to(a, n)) * DT for a in turn], axis=1)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    return Samples(
        gyro=rates + 0.002 * rng.standard_normal((n, 3)),
        rates=rates,
        speeds=np.sqrt(total / 4.0)[:, None] + 0.2 * rng.standard_normal((n, 4)),
        attitude=level,
        force=np.stack([np.zeros(n), np.zeros(n), f_z + 0.1 * rng.standard_normal(n)], axis=1),
        velocity=np.full((n, 3), np.nan) if velocity is None else velocity,
    )


def quiet(force=0.01, moment=0.02, seconds=40.0, level=0.0, seed=2):
    """A history of white residuals."""
    rng = np.random.default_rng(seed)
    size = np.array([force, moment, moment, moment])
    left = size * rng.standard_normal((round(seconds / STEP), 4))
    return ResidualHistory(np.array([level, 0.0, 0.0, 0.0]), left, STEP)


def looked(samples, look=0, known=None, history=None, onset=AT, **others):
    now = onset + TUNING.ages[look] >= TIME
    return judge(
        TIME[now],
        samples.part(now),
        DT,
        known or reference(),
        history or quiet(),
        onset,
        look,
        **others,
    )


def verdicts(samples, **others):
    """At all times at which it is looked at."""
    return [looked(samples, look, **others).verdict for look in range(len(TUNING.ages))]


@pytest.mark.parametrize("ratio", [0.8, 1.1, 1.2, 1.5])
@pytest.mark.parametrize("look", [0, 3])
def test_a_mass_that_changes_at_once_and_stays_is_a_change(ratio, look):
    # The controller answers within a second: thrust goes with the weight.
    thrust = 1.0 + (ratio - 1.0) * np.clip((TIME - AT) / 0.8, 0.0, 1.0)
    found = looked(fly(thrust, np.where(LATER, 1.0 - 1.0 / ratio, 0.0)), look)
    assert (found.verdict, found.cause.kind) == ("changed", "mass_change")
    assert found.cause.mass_ratio == pytest.approx(ratio, rel=0.02)
    assert found.onset == pytest.approx(AT, abs=0.06)


@pytest.mark.parametrize(("share", "called"), [(0.034, False), (0.046, True)])
def test_less_than_four_per_cent_is_not_called(share, called):
    samples = fly(share=np.where(LATER, share, 0.0))
    assert ("changed" in verdicts(samples)) is called


@pytest.mark.slow
def test_what_passes_is_no_change():
    for length in (0.3, 0.7, 1.5):
        share = np.where(LATER & (AT + length > TIME), 0.15, 0.0)
        found = verdicts(fly(share=share))
        assert found[-1] == "disturbance", length
        if length < TUNING.ages[0]:
            assert "changed" not in found


@pytest.mark.parametrize(("left", "called"), [(0.55, False), (0.85, True)])
def test_a_step_of_which_half_is_gone_again_is_no_change(left, called):
    """Both halves of the 3 s since must show it, within three tenths of it."""
    share = np.where(LATER, 0.2, 0.0) * np.where(TIME < AT + 1.5, 1.0, left)
    found = looked(fly(1.0 / (1.0 - share), share), 3)
    assert (found.verdict == "changed") is called


@pytest.mark.slow
def test_the_end_of_a_gust_is_no_change():
    """The vehicle is then what it was in all of the flight before the gust."""
    samples = fly(force=np.where(LATER, 0.0, 1.5))
    assert "changed" not in verdicts(samples)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_climb_moves_thrust_as_slowly_as_the_vehicle(sign):
    """Inflow of 0.6 1/s at 2 m/s is 12 % of the weight, and lasts."""
    speed = sign * 2.0 * np.clip((TIME - AT) / 0.8, 0.0, 1.0)
    velocity = np.stack([np.zeros_like(TIME), np.zeros_like(TIME), -speed], axis=1)
    samples = fly(force=0.6 * speed, velocity=velocity)
    assert "changed" not in verdicts(samples)
    assert looked(samples, LAST).cause.disturbance == "climb"


def test_the_ground_is_not_a_lighter_vehicle():
    """It carries what the rotors no longer do: specific force stays, whatever they turn at."""
    thrust = np.where(LATER, 0.6 - 0.2 * np.clip((TIME - AT) / 2.0, 0.0, 1.0), 1.0)
    thrust = np.where(LATER & (AT + 0.1 > TIME), 1.0 - 4.0 * (TIME - AT), thrust)
    samples = fly(thrust, 1.0 - 1.0 / thrust)
    assert "changed" not in verdicts(samples)
    assert looked(samples, LAST).cause.disturbance == "contact"


@pytest.mark.parametrize(("left", "called"), [(-1.0, False), (0.3, False), (0.6, True)])
def test_who_falls_or_lies_on_its_back_has_not_grown_heavier(left, called):
    """A crash: rotors turn on, and what carries the vehicle is the ground, the wrong way up."""
    found = [looked(fly(share=np.where(LATER, 1.0 - left, 0.0)), look) for look in range(LAST + 1)]
    assert ("changed" in [f.verdict for f in found]) is called
    if left < 0.0:
        assert found[LAST].cause.disturbance == "contact"


def test_after_full_throttle_no_line_tells_what_thrust_does():
    """At 6 m/s upwards inflow is no longer in proportion; the same step in hover is a change."""
    velocity = np.tile([0.0, 0.0, -6.0], (len(TIME), 1))
    share = np.where(LATER, 0.15, 0.0)
    assert "changed" not in verdicts(fly(share=share, velocity=velocity))
    assert looked(fly(share=share, velocity=0.0 * velocity)).verdict == "changed"


@pytest.mark.parametrize(("share", "called"), [(-0.17, True), (0.0, False)])
def test_a_payload_dropped_in_a_punch_out_shows_in_the_calm_flight_since(share, called):
    """At once nothing is sure; by then the step stands out of two seconds of hover."""
    punch = (TIME > AT - 0.3) & (AT + 0.4 > TIME)
    rising = 3.0 * np.interp(TIME, [AT - 0.3, AT + 0.4, AT + 1.2], [0.0, 1.0, 0.0])
    velocity = np.stack([np.zeros_like(TIME), np.zeros_like(TIME), -rising], axis=1)
    # The curve is a little off: full throttle by itself steps.
    off = np.where(LATER, share, 0.0) + np.where(punch, 0.1, 0.0)
    thrust = np.where(punch, 1.8, np.where(LATER, 1.0 + share, 1.0))
    samples = fly(thrust, off, velocity=velocity)
    looks = [looked(samples, look) for look in range(LAST + 1)]
    assert looks[0].verdict != "changed"
    assert ("changed" in [found.verdict for found in looks]) is called
    if called:
        found = next(found for found in looks if found.verdict == "changed")
        assert found.cause.mass_ratio == pytest.approx(1.0 / (1.0 - share), rel=0.02)
        assert found.onset <= AT + 0.06
        assert AT + 0.4 < found.settled < AT + 1.3


@pytest.mark.slow
def test_full_throttle_with_a_thrust_curve_a_little_off_is_no_change():
    thrust = np.where(LATER, 2.0, 1.0)
    samples = fly(thrust, np.where(LATER, 0.05, 0.0))
    assert "changed" not in verdicts(samples)
    assert looked(samples, LAST).cause.disturbance == "thrust"


def test_a_step_counts_for_less_where_residuals_wander():
    samples = fly(share=np.where(LATER, 0.08, 0.0))
    rng = np.random.default_rng(3)
    wander = np.convolve(rng.standard_normal(200), np.exp(-np.arange(8) / 2.0))[:160]
    rough = quiet()
    rough.left[:, 0] = 0.6 * wander
    assert looked(samples, 0).verdict == "changed"
    assert "changed" not in verdicts(samples, history=rough)


@pytest.mark.parametrize("rotor", range(4))
def test_a_rotor_that_lost_thrust_is_named(rotor):
    loss = np.where(LATER, 0.2, 0.0)
    x, y, spin = GEOMETRY[:, rotor]
    effect = rb.forward_matrix(THETA)[:, :4] @ [-y, x, 1.0, spin]
    # The body is held level: the other rotors make up for the moment, and speeds tell it.
    samples = fly(share=0.25 * loss, turn=[-e * loss * SUM / 4.0 for e in effect])
    found = looked(samples)
    assert (found.verdict, found.cause.kind) == ("changed", "rotor_failure")
    assert found.cause.rotor == rotor
    assert found.cause.loss == pytest.approx(0.2, abs=0.01)


def test_a_speed_that_is_read_wrong_is_no_weak_rotor():
    samples, more = fly(), np.array([1.37 * 0.2, 0.2, -0.2, -0.2])
    samples.speeds[LATER] *= np.sqrt(1.0 + more)
    assert "changed" not in verdicts(samples, known=reference((0, 1, 2)))


@pytest.mark.slow
def test_force_and_moment_of_no_rotors_direction_are_a_disturbance():
    # Pitch alone, with the thrust that a rotor's loss would go with.
    samples = fly(share=np.where(LATER, 0.03, 0.0), turn=[0.0, np.where(LATER, 4.0, 0.0), 0.0])
    assert "changed" not in verdicts(samples)
    assert "changed" not in verdicts(samples, known=reference(watched=(0, 2)))
    only = fly(turn=[0.0, np.where(LATER, 4.0, 0.0), 0.0])
    found = looked(only, LAST, force=False)
    assert (found.verdict, found.cause.disturbance) == ("disturbance", "moment")


def test_thrust_alone_does_not_tell_a_mass_from_weak_rotors():
    samples = fly(share=np.where(LATER, 0.15, 0.0))
    found = looked(samples, known=reference(watched=(0,)))
    assert (found.verdict, found.cause.kind) == ("changed", "change")


def test_of_commands_an_uncertain_curve_is_in_the_margin():
    """Hover at two thrusts is explained by a curve as well as by a mass."""
    ratio = 1.2
    after = 1.0 - 1.0 / ratio
    total = np.where(LATER, ratio, 1.0)
    samples = fly(total, np.where(LATER, after, 0.0))
    # Commands whose linear shares of full thrust, a third in hover, are those of the speeds.
    samples = Samples(
        samples.gyro, samples.rates, samples.speeds**2 * 4.0 / SUM / 3.0, *samples.signals[3:]
    )
    matrix = reference().matrix.copy()
    matrix[0, TOTAL] = -KAPPA * SUM * 3.0 / 4.0
    matrix[1:, :4] *= SUM * 3.0 / 4.0
    shares = []
    for curve_std in (0.01, 1.0):
        known = Reference(GEOMETRY, matrix, 0.0, Actuator(0.0, 0.0, curve_std=curve_std))
        shares.append(looked(samples, 1, known=known))
    assert [found.verdict for found in shares] == ["changed", "undecided"]


def test_where_nothing_is_to_be_decided_a_step_is_doubtful():
    """As at the end of a flight."""
    for share, doubtful in ((0.15, True), (0.0, False)):
        found = looked(fly(share=np.where(LATER, share, 0.0)), LAST, decide=False)
        assert (found.verdict, found.doubtful) == ("disturbance", doubtful)


def test_with_little_to_look_at_nothing_is_said():
    samples = fly(share=np.where(LATER, 0.15, 0.0))
    early = TIME < 0.3
    found = judge(TIME[early], samples.part(early), DT, reference(), quiet(), 0.2, 0)
    assert found.verdict == "undecided"
    assert looked(samples, known=reference(watched=())).verdict == "undecided"


def test_a_gap_is_no_step():
    samples = fly()
    lost = (TIME > AT) & (TIME < AT + 0.4)
    for signal in (samples.gyro, samples.rates, samples.force, samples.speeds):
        signal[lost] = np.nan
    assert "changed" not in verdicts(samples)
    thrust = 1.0 + 0.15 / 0.85 * np.clip((TIME - AT) / 0.8, 0.0, 1.0)
    found = fly(thrust, np.where(LATER, 0.15, 0.0))
    found.speeds[lost] = np.nan
    assert looked(found, 2).verdict == "changed"


def test_the_noise_of_a_history_is_found_again():
    """White noise and an Ornstein-Uhlenbeck process: the variance of a second's mean."""
    rng = np.random.default_rng(4)
    n, h, tau, size = 1200, STEP, 1.5, 0.3
    keep = np.exp(-h / tau)
    wander = np.zeros(n)
    for k in range(1, n):
        wander[k] = keep * wander[k - 1] + size * np.sqrt(1.0 - keep**2) * rng.standard_normal()
    left = np.zeros((n, 4))
    left[:, 0] = wander + 0.1 * rng.standard_normal(n)
    samples = fly()
    window = AlarmWindow(TIME, samples, DT, reference(), AT, TUNING)
    strength = strengths(window, ResidualHistory(np.zeros(4), left, h), 0)
    found = covariance(window, 0, strength, 0.0)
    known = size**2 * np.exp(-np.abs(window.index[:, None] - window.index) * window.step / tau)
    for seconds in (0.5, 1.0, 2.0):
        m = round(seconds / window.step)
        weight = np.zeros(len(window.index))
        weight[:m], weight[m : 2 * m] = -1.0 / m, 1.0 / m
        true = weight @ known @ weight + 2.0 * 0.1**2 * h / seconds
        # Raised where it would fall short, and by what few values may mislead.
        assert 0.9 * true < weight @ found @ weight < 2.0 * true


@pytest.mark.parametrize("before", [0.0, 0.01, 0.05, 0.2])
def test_a_step_at_the_very_end_says_nothing(before):
    """As where a flight ends while an alarm is undecided."""
    found = judge(TIME, fly(), DT, reference(), quiet(), TIME[-1] - before, LAST, decide=False)
    assert found.verdict != "change"
