"""From telemetered rotor signals to the inputs that may act on the body.

Measured speeds need no more than their squares. Commands pass a first-order motor lag and a
thrust curve that are not known: their signals are formed for some lags, of the lagged commands
and of their squares (`estimation.rows.actuator_dynamics`). All are in units of the anchor:
rad^2/s^2 with k_T for speeds, shares of full thrust with T_max for commands.

An autopilot that low-passes its gyro sees the rotors' effect late and rounded; the same filter on
the rotors' side puts both in step again.
"""

import math

import numpy as np

from gcs_sysid.arrays import Array, complete_rows, runs
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics, motor_filter
from gcs_sysid.model import rigid_body
from gcs_sysid.signals.recursions import lfilter

_SETTLED = 5.0
"""Time constants after which a motor's past is forgotten."""


class RotorPath:
    """The rotors' signals for every lag and set of a basis, block by block.

    Args:
        geometry: (3, rotors) of the airframe.
        dt: s between samples.
        basis: for which lags, and whether the samples hold commands.
        gyro_cutoff: Hz of the second-order low-pass that the autopilot puts on its gyro; None: the
            gyro is not filtered.
    """

    def __init__(
        self,
        geometry: Array,
        dt: float,
        basis: ActuatorDynamics,
        gyro_cutoff: float | None = None,
    ) -> None:
        self._geometry = geometry
        self._motors = basis.motors
        lags = basis.lags
        self._bent = list(basis.bent_lags)
        filters = [motor_filter(dt, lag) for lag in lags]
        self._filters = [*((1, f) for f in filters), *((2, filters[i]) for i in self._bent)]
        """Powers of commands, and the motors that they pass."""
        self._lag_settling = int(np.ceil(_SETTLED * lags[-1] / dt))
        self._low_pass = low_pass_for(gyro_cutoff, dt)
        self.restart()

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._last: Array | None = None
        self._last_command: Array = np.empty(0)
        self._wait = 0
        if self._low_pass is not None:
            self._low_pass.restart()

    def signals(self, rotors: Array) -> tuple[Array, Array, Array]:
        """The signals of (n, rotors) speeds in rad/s, or commands of 0 to 1; NaN where missing.

        Returns:
            (lags * sets, n, SIGNALS): roll, pitch, thrust, yaw and H for the rotation, as the
            autopilot's gyro feels them, (bent lags, n, 4) the bends of the first four of them, and
            (lags * sets + bent lags, n) thrust as it acts.
        """
        bent = np.empty((0, len(rotors), 4))
        if self._motors:
            w, squares = self._lagged(rotors)
            mixed, H = self._of_commands(w)
            bent = (squares - w[self._bent] ** 2) @ rigid_body.mixer(self._geometry)
        else:
            mixed, H = rigid_body.rotor_signals(self._geometry, rotors[None])
        signals = np.concatenate([mixed, H[..., None]], axis=-1)
        thrust = np.concatenate([mixed[..., 2], bent[..., 2]])
        if self._low_pass is not None:
            k, n = len(signals), len(rotors)
            flat = np.zeros((len(bent), n, signals.shape[2] - bent.shape[2]))
            both = np.concatenate([signals, np.concatenate([bent, flat], axis=-1)])
            both = np.swapaxes(self._low_pass.update(np.swapaxes(both, 0, 1)), 0, 1)
            signals, bent = both[:k], both[k:, :, :4]
        return signals, bent, thrust

    def _of_commands(self, w: Array) -> tuple[Array, Array]:
        """(lags * 2, n, 4) signals and (lags * 2, n) H of lagged commands: of each w and w^2."""
        shares = np.stack([w, w * w], axis=1)
        mixed = shares @ rigid_body.mixer(self._geometry)
        # A rotor's speed goes with the root of its thrust: sqrt(w) at one end of the curves, w at
        # the other; between them a straight line will do.
        H = np.stack([np.sqrt(np.clip(w, 0.0, None)), w], axis=1) @ self._geometry[2]
        n = w.shape[1]
        return mixed.reshape(-1, n, 4), H.reshape(-1, n)

    def _lagged(self, commands: Array) -> tuple[Array, Array]:
        """(lags, n, rotors) commands through motors of first order; (bent lags, ...) squares."""
        out = np.full((len(self._filters), *commands.shape), np.nan)
        for run, there in runs(complete_rows(commands)):
            if not there:
                self._last = None
                continue
            part = commands[run]
            if self._last is None:
                self._last = np.stack([part[0] ** power for power, _ in self._filters])
                self._last_command = part[:1]
                self._wait = self._lag_settling
            skip = min(self._wait, len(part))
            self._wait -= skip
            with_last = np.concatenate([self._last_command, part])
            self._last_command = part[-1:]
            for i, (power, (a, b0, b1)) in enumerate(self._filters):
                input_ = with_last**power
                driven = b0 * input_[1:] + b1 * input_[:-1]
                lagged, _ = lfilter([1.0], [1.0, -a], driven, a * self._last[i : i + 1])
                self._last[i] = lagged[-1]
                out[i, run.start + skip : run.stop] = lagged[skip:]
        lags = len(self._filters) - len(self._bent)
        return out[:lags], out[lags:]


class GyroLowPass:
    """An autopilot's second-order low-pass of its gyro, for signals that meet that gyro.

    Args:
        cutoff: cycles a sample.
    """

    def __init__(self, cutoff: float) -> None:
        self._b, self._a = butterworth(cutoff)
        self._settling = int(np.ceil(_SETTLED / (4.4 * cutoff)))
        self.restart()

    def restart(self) -> None:
        """What comes next does not join on to what came before."""
        self._state: Array | None = None
        self._settle = 0

    def update(self, signals: Array) -> Array:
        """(n, ...) signals filtered, NaN where they are missing and until the filter settles."""
        out = np.full_like(signals, np.nan)
        for run, there in runs(complete_rows(signals.reshape(len(signals), -1))):
            if not there:
                self._state = None
                continue
            part = signals[run]
            if self._state is None:
                self._state = steady_state(self._b, self._a, part[0])
                self._settle = self._settling
            filtered, self._state = lfilter(self._b, self._a, part, self._state)
            skip = min(self._settle, len(part))
            self._settle -= skip
            out[run.start + skip : run.stop] = filtered[skip:]
        return out


def low_pass_for(cutoff: float | None, dt: float) -> GyroLowPass | None:
    """The low-pass of this cutoff, Hz, for samples dt s apart; None where it passes them all."""
    return None if cutoff is None or cutoff >= 0.45 / dt else GyroLowPass(cutoff * dt)


def low_pass_delay(cutoff: float | None) -> float:
    """S by which the second-order low-pass of a gyro delays slow motion; None: there is none."""
    return 0.0 if cutoff is None else math.sqrt(2.0) / (2.0 * math.pi * cutoff)


def cutoff_of(delay: float) -> float:
    """Hz of the second-order low-pass that delays slow motion by so many s."""
    return math.sqrt(2.0) / (2.0 * math.pi * delay)


def butterworth(cutoff: float) -> tuple[Array, Array]:
    """(b, a) of the second-order low-pass, its cutoff in cycles a sample, by bilinear transform."""
    w = math.tan(math.pi * cutoff)
    scale = 1.0 / (1.0 + math.sqrt(2.0) * w + w * w)
    b = scale * w * w * np.array([1.0, 2.0, 1.0])
    return b, np.array(
        [1.0, 2.0 * scale * (w * w - 1.0), scale * (1.0 - math.sqrt(2.0) * w + w * w)]
    )


def steady_state(b: Array, a: Array, first: Array) -> Array:
    """(2, ...) state of the filter as if the first value had always been."""
    gain = b.sum() / a.sum()
    return np.stack([(gain - b[0]) * first, (b[2] - a[2] * gain) * first])
