"""How an unmodeled moment biases an estimate, and how it is detected.

The whiteners of a bank weigh the same data differently (`whitening`). The power of their
innovations shows whether there is a disturbance; the distance between their estimates, whether it
biased the one chosen; the share of the whitened acceleration that rotors explain, how much of the
motion is not theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit, along
from gcs_sysid.estimation.fit.solver import scales
from gcs_sysid.estimation.noise.whitening import Whitener
from gcs_sysid.model import rigid_body as rb


@dataclass(frozen=True)
class DisturbanceRules:
    """From where a disturbance counts, and what it costs."""

    detected: float = 1.0
    """Nats a second. Undisturbed flights of every simulator tried have 0.0 to 0.4, disturbed ones
    4 to 350, real ones 9 to 82."""
    floor: float = 0.04
    """Error of a moment of inertia over the share of the motion that the rotors do not explain: a
    moment of 7 rad/s^2 rms leaves 1 % at a share of 0.76."""

    curve: float = 0.03
    """Of the thrust curve, which air that moves with the vehicle bends: on four disturbed flights
    of an outside simulator curves of 0.4 were off by 0.003 to 0.058."""


RULES = DisturbanceRules()


@dataclass(frozen=True)
class BankTrial:
    """The fit to the data under every whitener.

    Attributes:
        whiteners: of the bank.
        time: s, T of a row.
        unknowns: (bank, N_UNKNOWNS + m), all with the same coordinates.
        variance: (bank, 3) power of the innovations, as of `whitened_fit.alike`.
        information: (bank, N_THETA + m, N_THETA + m), if these are white.
    """

    whiteners: Sequence[Whitener]
    time: float
    unknowns: Array
    variance: Array
    information: Array

    @property
    def pick(self) -> tuple[int, ...]:
        """Whitener of least innovation power, of each axis."""
        return tuple(int(i) for i in np.argmin(self.variance, axis=0))

    @property
    def detected(self) -> Array:
        """(3,) nats a second by which some whitener of a disturbance explains an axis better; NaN
        where there is none.

        g = ln(sigma of the best without disturbance / sigma of the best of all) / T
        """
        calm = [i for i, whitener in enumerate(self.whiteners) if not whitener.disturbed]
        if len(calm) == len(self.whiteners):
            return np.full(3, np.nan)
        best, best_calm = self.variance.min(axis=0), self.variance[calm].min(axis=0)
        return 0.5 * np.log(best_calm / best) / self.time

    def systematic(self, fit: RotationFit, hover: float) -> Array:
        """(k, N_THETA) errors that scatter does not show, each of a cause of its own.

        Args:
            fit: with the whiteners of least innovation power.
            hover: rad^2/s^2 (1 with commands), thrust signal in hover; 0 where the air is known to
                be calm: what disturbs is then zero in the mean.
        """
        disturbed = self.detected.max() > RULES.detected
        errors = [self._contrast(fit)] if disturbed else []
        for axis, strength in enumerate(self.detected):
            if strength > RULES.detected:
                errors.append(axis_floor(fit, axis))
                if axis < 2:
                    errors.append(self._trim(fit, axis, hover))
        if not errors:
            return np.zeros((0, rb.N_THETA))
        found = np.stack(errors)
        return found[found.any(axis=1)]

    def _contrast(self, fit: RotationFit) -> Array:
        """(N_THETA,) how far whiteners of faster disturbances lead away, beyond chance.

        If the rows' model is right all of them estimate the same; those that weigh low frequencies
        less only have more variance (specification test: Hausman 1978, Econometrica 46, 1251-1271).
        What a controller answers, and what moves with the vehicle (aerodynamics), biases slow
        motion most. In calm air it is no disturbance by which they differ, but the noise of rotors
        and gyro, to which the fastest are most sensitive; they do not count there.
        """
        pick, n = list(self.pick), rb.N_THETA
        slowest = min(self.whiteners[i].below for i in pick)
        faster = [i for i, whitener in enumerate(self.whiteners) if whitener.below > slowest]
        if not faster:
            return np.zeros(n)
        stds = {i: _stds(self.information[i])[:n] for i in {*pick, *faster}}
        # By how much scatter exceeds what white innovations would have.
        excess = np.maximum(fit.std / np.min([stds[i] for i in pick], axis=0), 1.0)
        std = excess * np.stack([stds[i] for i in faster])
        weights = std**-2.0  # none where such a whitener leaves no information
        away = (weights * (self.unknowns[faster, :n] - fit.theta)).sum(axis=0)
        apart = away / np.maximum(weights.sum(axis=0), 1e-300)
        chance = std.min(axis=0)
        return np.sign(apart) * np.sqrt(np.maximum(apart**2 - chance**2, 0.0))

    def _trim(self, fit: RotationFit, axis: int, hover: float) -> Array:
        """(N_THETA,) offset of the CG that the moment would hold if it were constant.

        Its rms is that of the Ornstein-Uhlenbeck moment: q_d / (1 - a^2), with q_d = rho_d r.
        """
        whitener = self.whiteners[self.pick[axis]]
        error = np.zeros(rb.N_THETA)
        if whitener.disturbed and hover > 0.0:
            r = whitener.gyro_share * float(fit.residual_covariance[axis, axis])
            q = (2.0 * np.pi * whitener.below * self.time) ** 4 * r
            moment = fit.theta[axis] * np.sqrt(q / (1.0 - whitener.a**2))
            error[rb.CG_Y if axis == 0 else rb.CG_X] = moment / hover
        return error


def curve_doubt(fit: RotationFit) -> Array:
    """(N_UNKNOWNS, N_UNKNOWNS) of a fit by commands, for what a disturbance does to the curve.

    Were the curve another, all unknowns would go with it.
    """
    if not fit.disturbance[:2].max() > RULES.detected:
        return np.zeros_like(fit.full_covariance)
    off = along(fit.full_covariance, Unknown.CURVE, RULES.curve)
    return np.outer(off, off)


def axis_floor(fit: RotationFit, axis: int) -> Array:
    """(N_THETA,) error of an axis whose motion is partly not the rotors'."""
    error = np.zeros(rb.N_THETA)
    moved = (axis,) if axis < 2 else (axis, *_OF_YAW)
    share = RULES.floor * (1.0 - max(float(fit.r_squared[axis]), 0.0))
    error[list(moved)] = share * fit.theta[list(moved)]
    return error


_OF_YAW = (rb.MOMENT_RATIO, rb.ROTOR_INERTIA)
"""Parameters that scale with Izz: the yaw equation determines their ratios to it."""


def _stds(information: Array) -> Array:
    """(p,) standard deviations of (p, p) information; huge where there is none."""
    d = scales(information)
    values, vectors = np.linalg.eigh(information / np.outer(d, d))
    return np.sqrt((vectors**2 / np.maximum(values, _NONE)).sum(axis=1)) / d


_NONE = 1e-14
"""Information, relative to its diagonal, that is rounding."""
