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
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate, LagOf, motor_filter
from gcs_sysid.model import attitude
from gcs_sysid.model import rigid_body as rb
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
TABLE = 7
"""Columns of gyro, rates and vertical specific force, before those of the rotors."""


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

    def lagged_of(self, root: Array) -> Array:
        """What lags, of roots of shares of full thrust."""
        if self.lag_of == "speed":
            return root
        share = root * root
        if self.lag_of == "thrust":
            return share
        linear = 1.0 - self.curve
        whole = np.sqrt(np.maximum(linear * linear + 4.0 * self.curve * share, 0.0))
        return 2.0 * share / np.maximum(linear + whole, 1e-6)

    def _share(self, u: Array) -> Array:
        return np.maximum((1.0 - self.curve) * u + self.curve * u * u, 0.0)


class Rotors:
    """Speeds (or roots of the shares of full thrust) of a stream, block by block."""

    def __init__(self, dt: float, actuator: Actuator | None) -> None:
        self._dt = dt
        self._w: Array | None = None
        self._command: Array = np.empty(0)
        """The newest one, as it was sent."""
        self._actuator = actuator

    @property
    def actuator(self) -> Actuator | None:
        """In force; with another one the rotors go on with the thrust that they have."""
        return self._actuator

    @actuator.setter
    def actuator(self, actuator: Actuator | None) -> None:
        before, self._actuator = self._actuator, actuator
        if actuator is None or before is None:
            self._w = None
        elif self._w is not None:
            self._w = actuator.lagged_of(before.after_lag(self._w))

    def restart(self) -> None:
        """What comes next does not join on."""
        self._w = None

    def update(self, speeds: Array) -> Array:
        """(n, rotors) whose squares make thrust, of (n, rotors) speeds or commands."""
        actuator = self.actuator
        if actuator is None:
            return speeds
        a, b0, b1 = motor_filter(self._dt, actuator.lag)
        out = np.full_like(speeds, np.nan)
        for run, there in runs(complete_rows(speeds)):
            if not there:
                self._w = None
                continue
            if self._w is None:
                self._command = speeds[run.start : run.start + 1].copy()
                self._w = actuator.before_lag(self._command)
            part = actuator.before_lag(np.concatenate([self._command, speeds[run]]))
            w, _ = lfilter([1.0], [1.0, -a], b0 * part[1:] + b1 * part[:-1], a * self._w)
            self._w, self._command = w[-1:].copy(), speeds[run.stop - 1 : run.stop].copy()
            out[run] = actuator.after_lag(w)
        return out


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
        """Outputs (m, 4), inputs (m, N_X) and O (m, rotors) of n samples, from the second on.

        The last ones are missing where the rotor stream is late.
        """
        speeds = Rotors(dt, self.actuator).update(samples.speeds)
        table = np.column_stack([samples.gyro, samples.rates, samples.force[:, 2], speeds])
        late = max(int(np.ceil(self.shift)), 0)
        early = max(-int(np.floor(self.shift)), 0)
        start, n = early, len(table) - late - early
        y, x, squares = form_rows(self.geometry, table, start, max(n - 1, 0), self.shift, dt)
        gone = np.full((early, 1), np.nan)
        return tuple(  # type: ignore[return-value]
            np.concatenate([np.broadcast_to(gone, (early, a.shape[1])), a]) for a in (y, x, squares)
        )


def body_velocity(samples: Samples) -> Array:
    """(n, 3) velocity along the body axes, m/s; NaN where none is reported."""
    velocity = samples.velocity
    if not np.isfinite(velocity).any():
        return velocity
    return (velocity[:, None, :] @ attitude.matrices(samples.attitude))[:, 0]


def form_rows(
    geometry: Array, table: Array, at: int, n: int, shift: float, dt: float
) -> tuple[Array, Array, Array]:
    """Outputs (n, 4), inputs (n, N_X) and O (n, rotors).

    Args:
        geometry: (3, rotors).
        table: (m, TABLE + rotors) gyro, rates, vertical specific force and speeds.
        at: row of the sample before the first.
        n: how many.
        shift: samples by which speeds are late.
        dt: s between samples.
    """
    if n <= 0:
        return np.empty((0, 4)), np.empty((0, N_X)), np.empty((0, geometry.shape[1]))
    imu = table[at : at + n + 1]
    whole = int(np.floor(shift))
    part = shift - whole
    rotor = table[at + whole : at + whole + n + 1, TABLE:]
    if part:
        later = table[at + whole + 1 : at + whole + n + 2, TABLE:]
        rotor = (1.0 - part) * rotor + part * later
    signals, H = rb.rotor_signals(geometry, rotor)
    rates = imu[:, 3:6]
    columns = np.column_stack([signals, rb.rate_signals(rates), rates[:, 1::-1] * H[:, None]])
    x = np.empty((n, N_X))
    x[:, : rb.N_SIGNALS - 1] = 0.5 * (columns[1:] + columns[:-1])
    x[:, rb.N_SIGNALS - 1] = np.diff(H) / dt
    x[:, TOTAL] = signals[1:, 2]
    y = np.column_stack([imu[1:, 6], np.diff(imu[:, :3], axis=0) / dt])
    # Held: a channel with anything missing. Zero inputs keep the product defined.
    gone = ~np.isfinite(x).all(axis=1)
    y[gone] = np.nan
    x[gone] = 0.0
    return y, x, rotor[1:] ** 2


def reference_of(
    fit: Fit, geometry: Array, dt: float, *, motors: bool = False, moments: bool = True
) -> Reference:
    """A fit as a reference, on the axes where it is good enough.

    Args:
        fit: of the flight so far.
        geometry: (3, rotors).
        dt: s between samples.
        motors: whether they lie between the rotors' input and thrust.
        moments: whether the angular channels can be watched: not where the gyro is filtered.
    """
    matrix = np.full((4, N_X), np.nan)
    trans, rot = fit.translation, fit.rotation
    if trans is not None and 0.0 < trans.kappa_std < MAX_KAPPA_SHARE * trans.kappa:
        matrix[0] = 0.0
        matrix[0, TOTAL] = -trans.kappa
    shift, actuator = 0.0, None
    if rot is not None:
        known = _axes_known(rot) & moments
        Q = np.column_stack([rb.forward_matrix(rot.theta), np.zeros(3)])
        matrix[1:] = np.where(known[:, None], Q, np.nan)
        if (known.any() or motors) and abs(rot.delay) < MAX_DELAY:
            # To a quarter of a sample: a finer shift gains nothing, a whole one adds no lag.
            shift = round(4.0 * rot.delay / dt) / 4.0
        if motors:
            where, std = rot.coordinates, rot.coordinates_std
            actuator = Actuator(
                float(where[Coordinate.LAG]),
                float(where[Coordinate.CURVE]),
                "command" if rot.lag_place is None else rot.lag_place.of,
                float(std[Coordinate.LAG]),
                float(std[Coordinate.CURVE]),
            )
    stuck = rot is not None and rot.warm_start is not None and rot.warm_start.stuck
    if motors and (actuator is None or stuck):
        matrix[:] = np.nan  # of commands nothing is known without lag and curve
    return Reference(geometry, matrix, shift, actuator)


def _axes_known(rot: RotationFit) -> Array:
    """(3,) the axes on which a fit is good enough as a reference."""
    sharp = rot.std[:3] < MAX_INERTIA_SHARE * rot.theta[:3]
    return np.asarray(sharp & (rot.r_squared > MIN_R_SQUARED))
