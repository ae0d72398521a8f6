"""Deviations from the model: their torques, their evidence, and what fits make of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from gcs_sysid.estimation.fit.deviations import (
    AXIS_DAMPING,
    NO_DEVIATIONS,
    SIZES,
    SURE,
    DeviationChoice,
)
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS
from gcs_sysid.estimation.fit.whitened_fit import fit_whitened
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.session.chain import Chain, ChainOptions
from gcs_sysid.significance import Z95
from testbed.rate_loop import DISTURBANCES, EXCITATIONS, Vehicle
from testbed.rate_loop import fly as fly_cell
from tests.feeding import feed

T = 0.004
QUAD = Vehicle().geometry
TURN = np.arange(6) * np.pi / 3.0
HEXA = np.array([0.3 * np.cos(TURN), 0.3 * np.sin(TURN), np.tile([1.0, -1.0], 3)])
KINDS = tuple(SIZES)


def cell(excitation, seconds, seed):
    """A flight at 250 Hz inside the model, at its own speeds."""
    how = {"flights": 1, "seconds": seconds, "rate": 250.0, "seed": seed}
    return fly_cell(Vehicle(), EXCITATIONS[excitation], DISTURBANCES["none"], **how)[0]


def unknowns_of(vehicle=None):
    return np.concatenate([(vehicle or Vehicle()).theta, [0.0, 0.0, 1.0]])


def kind_of(geometry):
    """(m,) kind of each deviation."""
    rotors = geometry.shape[1]
    return np.repeat(np.arange(3), [3, rotors - 1, rotors - 1])


@pytest.mark.parametrize("geometry", [QUAD, HEXA], ids=["quad", "hexa"])
def test_torques_are_those_of_rotors_that_differ(geometry):
    x, y, s = geometry
    unknowns = unknowns_of()
    every = DeviationChoice(geometry).every(unknowns)
    rng = np.random.default_rng(1)
    phi = 0.05 * rng.standard_normal(len(every.std))
    # What an allocation of full rank can ask for.
    signals = np.array([900.0, -700.0, 2.7e5, 8e3])
    squares = signals @ np.linalg.pinv(rb.mixer(geometry))
    rates = np.array([0.7, -0.4, 0.9])
    row = np.zeros(rb.N_SIGNALS)
    row[:4] = signals
    row[[rb.SIGNALS.index(name) for name in "pqr"]] = rates
    found = every.torque(phi) @ row
    kind = kind_of(geometry)
    thrust = phi[kind == 1] @ every.thrusts[kind == 1]
    assert thrust.sum() == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(thrust) == pytest.approx(np.linalg.norm(phi[kind == 1]))
    contrasts = every.thrusts[kind == 1]
    drag = phi[kind == 2] @ contrasts
    expected = -phi[:3] * rates
    expected[0] += (thrust * (unknowns[rb.CG_Y] - y) * squares).sum()
    expected[1] += (thrust * (x - unknowns[rb.CG_X]) * squares).sum()
    expected[2] += (drag * s * squares).sum()
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def brute_force(A, z, kind, units):
    """Sizes of greatest evidence by the density of z = A phi + noise; torque comes with thrust."""
    best, found = 0.0, (0.0, 0.0, 0.0)
    nothing = multivariate_normal.logpdf(z, cov=np.eye(len(z)))
    grids = [(0.0, *SIZES[name]) for name in KINDS]
    for sizes in np.array(np.meshgrid(*grids, indexing="ij")).reshape(3, -1).T:
        allowed = np.maximum(sizes, [0.0, min(sizes[2], 0.01), 0.0])
        spread = A * (allowed[kind] * units)
        told = multivariate_normal.logpdf(z, cov=np.eye(len(z)) + spread @ spread.T) - nothing
        told -= SURE * np.count_nonzero(sizes)
        if told > best:
            best, found = told, tuple(allowed)
    return found


@pytest.mark.parametrize("true", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
def test_choice_is_that_of_the_density_of_the_data(true):
    rng = np.random.default_rng([7, *true])
    kind, unknowns = kind_of(QUAD), unknowns_of()
    choice = DeviationChoice(QUAD)
    every = choice.every(unknowns)
    units = np.array(
        [*np.abs(unknowns[rb.MOMENTS]), *np.ones(3), *np.full(3, unknowns[rb.MOMENT_RATIO])]
    )
    size = np.array([0.2, 0.03, 0.2]) * true
    A = rng.standard_normal((24, len(kind))) / (np.array([0.02, 0.004, 0.02])[kind] * units)
    z = A @ (size[kind] * units * rng.standard_normal(len(kind))) + rng.standard_normal(24)
    chosen = choice.choose(every, unknowns, A.T @ z, A.T @ A)
    sizes = brute_force(A, z, kind, units)
    expected = np.maximum(sizes, [AXIS_DAMPING, 0.0, 0.0])[kind] * units
    np.testing.assert_allclose(chosen.std, expected[expected > 0.0])
    # Three nats are no certainty, and what is not there may seem to be.
    assert all(s for s, t in zip(sizes, true, strict=True) if t)
    assert ("damping" in chosen.shown) == bool(sizes[0])


@pytest.fixture(scope="module")
def flown():
    """16 s at 250 Hz inside the model, as whitened moments."""
    samples = cell("aggressive", 16.0, seed=31)
    estimator = OnlineEstimator(QUAD, T, EstimatorTuning())
    estimator.update(samples)
    record = estimator.record.whitened
    return record.moments(estimator.record.whitened_noise()), record.basis


class Fixed(DeviationChoice):
    """Takes some deviations whatever the evidence, and keeps what it was told."""

    def __init__(self, of):
        super().__init__(QUAD)
        self.of, self.told = of, []

    def choose(self, every, unknowns, score, information):
        self.told.append((score, information))
        if self.of is None:
            return NO_DEVIATIONS
        units = np.abs(unknowns[rb.MOMENTS])[self.of]
        return replace(
            every,
            torques=every.torques[self.of],
            std=100.0 * units,
            thrusts=every.thrusts[self.of],
            turns=every.turns[self.of],
            sized=every.sized[self.of],
        )


@pytest.mark.slow
def test_score_and_information_are_those_of_a_fit_with_the_deviations(flown):
    """One step from no deviations leads where fitting them outright does."""
    data, basis = flown
    looked = Fixed(None)
    plain = fit_whitened(data, basis, choice=looked).rotation
    score, information = looked.told[0]
    # Damping of roll and pitch: with that of all axes they make up the damping of yaw.
    of = [0, 1]
    step = np.linalg.solve(information[np.ix_(of, of)], score[of])
    fit = fit_whitened(data, basis, choice=Fixed(of)).rotation
    assert fit.deviations.shape == (2,)
    std = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(of, of)])))
    assert np.all(np.abs(fit.deviations - step) < 0.1 * std)
    # That of a fit is widened for scatter, and the same but for that.
    ratio = np.sqrt(np.diag(fit.deviations_covariance)) / std
    assert np.all((ratio > 0.7) & (ratio < 1.6))
    assert np.all(np.abs(fit.theta[:2] - plain.theta[:2]) < 2.0 * plain.std[:2])
    assert fit.warm_start.unknowns.shape == (N_UNKNOWNS + 2,)


@pytest.mark.slow
def test_nothing_is_chosen_on_an_ideal_flight():
    samples = cell("doublets", 12.0, seed=41)
    estimator = OnlineEstimator(QUAD, T, EstimatorTuning())
    estimator.update(samples)
    fit = estimator.fit().rotation
    assert not fit.deviating.shown
    assert fit.deviations.shape == (3,)  # damping by axis
    assert np.all(np.abs(fit.theta - Vehicle().theta)[:9] < 4.0 * fit.std[:9])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("physics", "seed", "kinds"),
    [
        pytest.param("damping=0.5:0.5:0.05", 6, 3, marks=pytest.mark.thorough),
        pytest.param("scatter=0.03", 6, 9, marks=pytest.mark.thorough),
        ("tilt=1", 5, 9),
    ],
)
def test_intervals_hold_where_the_vehicle_deviates(fly, physics, seed, kinds):
    """Yaw damped a tenth of roll and pitch; rotors that differ by 3 %, or lean by a degree."""
    flight = fly(
        "--mission", "doublets", "--noise", "mems", "--rate", "250", "--duration", "32",
        "--turbulence", "0", "--seed", str(seed), "--physics", physics,
    )  # fmt: skip
    chain = Chain(load_airframe("paper"), ChainOptions())
    feed(chain, flight.records())
    result = chain.finish()
    assert len(chain.fit.rotation.deviations) == kinds
    for name in ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y"):
        estimate = result.parameters[name]
        assert abs(estimate.value - flight.truth[name]) < Z95 * estimate.std, name
    # The next flight's thrust is by these rotors, too.
    bare, estimator = replace(chain.fit, translation=None), chain.tracker.estimator
    thrust = estimator.with_thrust_by(chain.fit.rotation, bare).translation
    assert thrust.kappa == pytest.approx(chain.fit.translation.kappa)


@pytest.mark.slow
def test_intervals_hold_where_one_rotor_is_read_later_than_the_others():
    """By 8 ms Ixx was 3.9 standard deviations off."""
    samples = cell("aggressive", 12.0, seed=32)
    late = samples.speeds.copy()
    late[2:, 1] = late[:-2, 1]
    estimator = OnlineEstimator(QUAD, T, EstimatorTuning())
    estimator.update(replace(samples, speeds=late))
    fit = estimator.fit().rotation
    assert np.all(np.abs(fit.theta - Vehicle().theta)[:9] <= Z95 * fit.std[:9])


def test_a_turned_imu_is_no_rotor_of_another_torque():
    """What roll and pitch do is seen in yaw then, as if rotors differed in torque."""
    unknowns = unknowns_of()
    choice = DeviationChoice(QUAD, turn=np.radians(1.0))
    every = choice.every(unknowns)
    _, by_each = every.jacobian(unknowns, np.zeros(len(every.std)))
    by_each = by_each[rb.N_THETA :]
    turned = np.tensordot([1.0, -0.8, 0.0], by_each[-3:], 1)
    # Rows of all signals, each as strong as the torque that it makes is to be seen.
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((4000, rb.N_SIGNALS))
    rows *= 1.0 / np.maximum(np.abs(rb.forward_matrix(unknowns[: rb.N_THETA])).max(axis=0), 1e-9)
    noise = 0.02 * rng.standard_normal((4000, 3))
    z = rows @ turned.T + noise
    A = np.einsum("kas,ns->nak", by_each, rows)
    score = np.einsum("nak,na->k", A, z) / 0.02**2
    information = np.einsum("nak,nal->kl", A, A) / 0.02**2
    exact, m = DeviationChoice(QUAD), len(every.std) - 3
    alone = exact.choose(exact.every(unknowns), unknowns, score[:m], information[:m, :m])
    assert np.abs(alone.ratios).any()
    competing = choice.choose(every, unknowns, score, information)
    assert not competing.ratios.any()


def test_misplaced_rotors_turn_the_body_by_their_thrust():
    given = DeviationChoice(QUAD, place=1e-3).given
    signal = np.linalg.pinv(rb.mixer(QUAD))
    x, y = np.swapaxes(given.places, 0, 1)
    assert given.torques[:, 0, :4] == pytest.approx(-y @ signal.T, abs=1e-15)
    assert given.torques[:, 1, :4] == pytest.approx(x @ signal.T, abs=1e-15)


def fit_to(samples, geometry, **given):
    """The fit to a flight, by what is given and how well that is known."""
    estimator = OnlineEstimator(geometry, T, EstimatorTuning(**given))
    estimator.update(samples)
    return estimator.fit().rotation


@pytest.fixture(scope="module")
def lively():
    """16 s inside the model, at its own speeds."""
    return cell("aggressive", 16.0, seed=33)


@pytest.mark.slow
def test_a_flight_shows_how_the_imu_is_turned(lively):
    """Three to eight degrees left up to five standard deviations, were it undone to first order."""
    turn = np.radians([4.0, -6.0, 3.0])
    R = Rotation.from_rotvec(turn).inv().as_matrix()
    gyro = lively.gyro @ R.T
    samples = replace(lively, gyro=gyro, rates=gyro)
    straight = fit_to(samples, QUAD)
    theta = Vehicle().theta
    assert np.max(np.abs(straight.theta - theta)[:6] / straight.std[:6]) > 4.0
    fit = fit_to(samples, QUAD, imu_turn=np.radians(3.0))
    turns = fit.deviating.turns
    std = np.sqrt(np.diag(turns.T @ fit.deviations_covariance @ turns))
    assert np.all(std < np.radians(0.3))
    assert np.all(np.abs(fit.deviations @ turns - turn) < 3.0 * std)
    assert np.all(np.abs(fit.theta - theta)[:9] < 3.0 * fit.std[:9])


@pytest.mark.slow
def test_rotors_that_are_not_quite_where_they_are_given_are_in_the_interval(lively):
    theta, off, known = Vehicle().theta, [], []
    place = 0.01 * float(np.mean(np.hypot(*QUAD[:2])))
    for seed in range(2):
        errors = place * np.random.default_rng([seed, 5]).standard_normal((2, 4))
        # A common shift and a common scale are others' affair (`given_errors`).
        errors -= errors.mean(axis=1, keepdims=True)
        centered = QUAD[:2] - QUAD[:2].mean(axis=1, keepdims=True)
        errors -= centered * (errors * centered).sum() / (centered**2).sum()
        geometry = np.vstack([QUAD[:2] + errors, QUAD[2:]])
        for fits, tolerance in ((off, 0.0), (known, place)):
            fit = fit_to(lively, geometry, rotor_place=tolerance)
            fits.append(np.abs(fit.theta - theta)[:8] / fit.std[:8])
    assert np.max(off) > 6.0
    assert np.mean(np.array(known) < Z95) > 0.85
    assert np.max(known) < 3.5
