"""The reference fit for change detection: its predicted thrust and angular acceleration.

Four residuals per sample, measured less predicted, without a window that would add lag:

    thrust:            f_z + kappa sum O             (m/s^2)
    roll, pitch, yaw:  gyro increment / dt - Q x     (rad/s^2, x by the trapezoid)

O are the rotors' squared speeds; with commands u as the input their shares of full thrust, those of
the reference's lag and thrust curve c: (1 - c) w + c w^2 with w the lagged command, or where the
rotors' speed lags the square of the lagged root of (1 - c) u + c u^2.
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.estimation.fit.priors import COORDINATE_MEAN, COORDINATE_STD
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate, LagOf, motor_filter
from gcs_sysid.model import attitude
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.recursions import lfilter

MIN_R_SQUARED = 0.8
MAX_INERTIA_SHARE = 0.1
"""An axis is watched when the fit explains this share of its motion and knows its inertia so."""
MAX_KAPPA_SHARE = 0.05
"""Thrust is watched when k_T / m is known to this; with commands, at a given thrust curve."""
MAX_DELAY = 0.1
"""s, largest delay of the rotor stream that can be made up for."""

TOTAL = rb.N_SIGNALS
"""Column of the instantaneous sum of O, after the forward form's inputs."""
N_X = rb.N_SIGNALS + 1


@dataclass(frozen=True)
class Actuator:
    """How commands become thrust; speeds need none.

    Attributes:
        lag: s, of first order.
        curve: thrust curve c.
        lag_of: what lags.
        lag_std: s.
        curve_std: both standard deviations are those of the fit.
    """

    lag: float
    curve: float
    lag_of: LagOf = "command"
    lag_std: float = 0.0
    curve_std: float = 0.0

    def before_lag(self, commands: Array) -> Array:
        """What lags."""
        if self.lag_of == "command":
            return commands
        share = self._share(commands)
        return share if self.lag_of == "thrust" else np.sqrt(share)

    def after_lag(self, lagged: Array) -> Array:
        """Roots of the shares of full thrust."""
        if self.lag_of == "speed":
            return np.maximum(lagged, 0.0)
        share = self._share(lagged) if self.lag_of == "command" else np.maximum(lagged, 0.0)
        return np.sqrt(share)

    def roots(self, commands: Array, dt: float) -> Array:
        """(n, rotors) roots of the shares of full thrust, of commands dt s apart.

        Where they begin, and after a gap, they are taken to have been constant before.
        """
        a, b0, b1 = motor_filter(dt, self.lag)
        out = np.full_like(commands, np.nan)
        for run, there in runs(complete_rows(commands)):
            if there:
                part = self.before_lag(commands[run])
                part = np.concatenate([part[:1], part])
                w, _ = lfilter([1.0], [1.0, -a], b0 * part[1:] + b1 * part[:-1], a * part[:1])
                out[run] = self.after_lag(w)
        return out

    def _share(self, u: Array) -> Array:
        return np.maximum(RotorInput.COMMAND.load(u, np.array(self.curve)), 0.0)


@dataclass(frozen=True)
class Reference:
    """What residuals are formed with.

    Attributes:
        geometry: (3, rotors) of the airframe.
        matrix: (4, N_X) thrust and three angular accelerations of the inputs; NaN rows where a
            channel is not watched.
        shift: samples by which the rotor stream is late, in quarters.
        actuator: of commands.
    """

    geometry: Array
    matrix: Array
    shift: float = 0.0
    actuator: Actuator | None = None

    @property
    def kappa(self) -> float:
        """k_T / m (T_max / m); 1 where thrust is not watched: moments need but its changes."""
        return -float(self.matrix[0, TOTAL]) if self.watched[0] else 1.0

    @property
    def watched(self) -> Mask:
        """(4,) which channels are."""
        return np.asarray(np.isfinite(self.matrix).all(axis=1))

    @property
    def arm(self) -> float:
        """m, mean distance of the rotors."""
        return float(np.mean(np.hypot(self.geometry[0], self.geometry[1])))

    def floors(self, thrust: float) -> Array:
        """(4,) each channel's effect of a sum of O; of a tenth of the arm's moment, for moments.

        Args:
            thrust: the sum of O in hover.
        """
        known = np.abs(np.nan_to_num(self.matrix))
        arm = 0.2 * self.arm
        return thrust * np.array(
            [known[0, TOTAL], arm * known[1, 0], arm * known[2, 1], 0.2 * known[3, 3]]
        )

    def rows(self, samples: Samples, dt: float) -> tuple[Array, Array, Array]:
        """Outputs (n - 1, 4), inputs (n - 1, N_X) and O (n - 1, rotors) of n samples, from the
        second on; NaN where inputs are missing, as by a late rotor stream at the end.
        """
        speeds = (
            samples.speeds if self.actuator is None else self.actuator.roots(samples.speeds, dt)
        )
        whole = int(np.floor(self.shift))
        part = self.shift - whole
        rotor = _ahead(speeds, whole)
        if part:
            rotor = (1.0 - part) * rotor + part * _ahead(speeds, whole + 1)
        signals, H = rb.rotor_signals(self.geometry, rotor)
        rates = samples.rates
        columns = np.column_stack([signals, rb.rate_signals(rates), rates[:, 1::-1] * H[:, None]])
        x = np.empty((len(rates) - 1, N_X))
        x[:, : rb.N_SIGNALS - 1] = 0.5 * (columns[1:] + columns[:-1])
        x[:, rb.N_SIGNALS - 1] = np.diff(H) / dt
        x[:, TOTAL] = signals[1:, 2]
        y = np.column_stack([samples.force[1:, 2], np.diff(samples.gyro, axis=0) / dt])
        gone = ~complete_rows(x)
        y[gone], x[gone] = np.nan, np.nan
        return y, x, rotor[1:] ** 2


def _ahead(values: Array, count: int) -> Array:
    """(n, ...) values so many rows later (earlier: less than 0); NaN where there are none."""
    moved = np.full_like(values, np.nan)
    n = len(values)
    moved[max(-count, 0) : n - max(count, 0)] = values[max(count, 0) : n - max(-count, 0)]
    return moved


def body_velocity(samples: Samples) -> Array:
    """(n, 3) velocity along the body axes, m/s; NaN where none is reported."""
    velocity = samples.velocity
    if not np.isfinite(velocity).any():
        return velocity
    return (velocity[:, None, :] @ attitude.matrices(samples.attitude))[:, 0]


def actuator_of(fit: RotationFit | None, curves: tuple[float, ...]) -> Actuator:
    """Lag and thrust curve by a fit, as far as it knows them better than they ordinarily are.

    Args:
        fit: to commands; None while there is none.
        curves: least and greatest thrust curve; one value is given.
    """
    mean, std = COORDINATE_MEAN.copy(), COORDINATE_STD.copy()
    if len(curves) == 1:
        mean[Coordinate.CURVE], std[Coordinate.CURVE] = curves[0], 0.0
    lag_of: LagOf = "command"
    if fit is not None:
        known = fit.coordinates_std < std
        mean = np.where(known, fit.coordinates, mean)
        std = np.where(known, fit.coordinates_std, std)
        lag_of = lag_of if fit.lag_place is None else fit.lag_place.of
    return Actuator(
        float(mean[Coordinate.LAG]),
        float(mean[Coordinate.CURVE]),
        lag_of,
        float(std[Coordinate.LAG]),
        float(std[Coordinate.CURVE]),
    )


def reference_of(
    fit: Fit, geometry: Array, dt: float, actuator: Actuator | None, *, moments: bool = True
) -> Reference:
    """A fit as a reference, on the axes where it is good enough.

    Args:
        fit: of the flight so far.
        geometry: (3, rotors).
        dt: s between samples.
        actuator: of commands, by the same fit; None with speeds.
        moments: whether the angular channels can be watched: not where the gyro is filtered.
    """
    matrix = np.full((4, N_X), np.nan)
    trans, rot, shift = fit.translation, fit.rotation, 0.0
    if actuator is not None and rot is None:
        # Of commands nothing is known without lag and curve.
        return Reference(geometry, matrix, shift, actuator)
    if trans is not None and 0.0 < trans.kappa_std < MAX_KAPPA_SHARE * trans.kappa:
        matrix[0] = 0.0
        matrix[0, TOTAL] = -trans.kappa
    if rot is not None:
        known = _axes_known(rot) & moments
        Q = np.column_stack([rb.forward_matrix(rot.theta), np.zeros(3)])
        matrix[1:] = np.where(known[:, None], Q, np.nan)
        if (known.any() or actuator is not None) and abs(rot.delay) < MAX_DELAY:
            # To a quarter of a sample: a finer shift gains nothing, a whole one adds no lag.
            shift = round(4.0 * rot.delay / dt) / 4.0
    return Reference(geometry, matrix, shift, actuator)


def _axes_known(rot: RotationFit) -> Array:
    """(3,) the axes on which a fit is good enough as a reference."""
    sharp = rot.std[:3] < MAX_INERTIA_SHARE * rot.theta[:3]
    return np.asarray(sharp & (rot.r_squared > MIN_R_SQUARED))
