"""Six degrees of freedom of an identified multirotor, for one set of parameters or an ensemble.

    J w' = M - w x (J w + h) - h' - d w + J a_d,        h = -J_r H z,  H = sum s_i Omega_i
    v'   = g z - (R z T + D v) / m + f_d,               q' = q (0, w) / 2,  x' = v
    T = sum T_i,  M = sum (r_i - r_cg) x (-T_i z) + sum s_i Q_i z
    T_i = k_T Omega_i^2,  Q_i = k_M Omega_i^2           with rotor speeds
    T_i = T_max ((1-c) u_i + c u_i^2),  Q_i = (k_M/k_T) T_i,  tau_m u_i' = u_c,i - u_i
                                                        with commands u_c

Body axes are forward, right, down, world axes north, east, down. These are the terms that
`model.rigid_body` identifies; a_d and f_d are unmodeled accelerations.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.parameters import GRAVITY, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput

_LONGEST_STEP = 0.01
"""s; longer steps between samples are divided. Body rates of a multirotor change by about a tenth
of themselves in that time, and the midpoint rule is then off by less than 1e-4 of them."""


FURTHER = tuple(
    name
    for name in rb.THETA
    if name != "rotational_damping"
    and (terms := REGISTRY[name].torque)
    and {signal for _, signal, _ in terms} <= set(rb.RATE_SIGNALS)
)
"""Entries of theta that turn the body at a rate, and have no field of `FlightModel`."""


@dataclass(frozen=True)
class MotionState:
    """Motion at one instant; leading axes broadcast against those of the model and the inputs.

    Attributes:
        rates: (..., 3) body rates p, q, r in rad/s.
        attitude: (..., 4) unit quaternions w, x, y, z, body to world.
        velocity: (..., 3) north, east, down, m/s.
        position: (..., 3) m.
        rotors: (..., rotors) lagged commands at the start; None: settled at the first command.
    """

    rates: ArrayLike = (0.0, 0.0, 0.0)
    attitude: ArrayLike = (1.0, 0.0, 0.0, 0.0)
    velocity: ArrayLike = (0.0, 0.0, 0.0)
    position: ArrayLike = (0.0, 0.0, 0.0)
    rotors: ArrayLike | None = None


@dataclass(frozen=True)
class Trajectory:
    """Motion over time.

    Attributes:
        t: (n,) s.
        rates: (..., n, 3) rad/s.
        attitude: (..., n, 4) w, x, y, z, body to world.
        velocity: (..., n, 3) m/s.
        position: (..., n, 3) m.
    """

    t: Array
    rates: Array
    attitude: Array
    velocity: Array
    position: Array


_Body = tuple[list[Array], list[Array], list[Array], list[tuple[int, int, Array]]]
"""J, its inverse, damping of each axis, and further torques: axis, rate signal, coefficient."""


class _Forcing(NamedTuple):
    """What drives the body, component by component; time comes first.

    Attributes:
        moment: three of (n, ...) N m.
        thrust: (n, ...) N.
        momentum: (n, ...) J_r H in N m s.
        reaction: (n - 1, ...) J_r H' in N m, constant over a step.
    """

    moment: tuple[Array, Array, Array]
    thrust: Array
    momentum: Array
    reaction: Array


@dataclass(frozen=True)
class FlightModel:
    """Equations of motion with values; leading axes (...) are those of an ensemble.

    Attributes:
        geometry: (3, rotors) x, y in m from the geometric center, and spin.
        rotor_input: what drives it, speeds in rad/s or commands of 0 to 1.
        mass: (...) kg.
        inertia: (..., 6) Ixx, Iyy, Izz, Ixy, Iyz, Ixz in kg m^2.
        cg: (..., 2) m from the geometric center, forward and right.
        thrust: (..., rotors) k_T of each rotor in N s^2; with commands T_max in N.
        torque: (..., rotors) k_M of each rotor in N m s^2; with commands at full command, in N m.
        damping: (..., 3) N m s.
        rotor_inertia: (...) kg m^2.
        drag: (...) N s/m.
        thrust_curve: (...) c above; with commands.
        motor_lag: (...) s; with commands.
        further: (...) of other parameters that turn the body at a rate, see `FURTHER`.

    Raises:
        InputError: an inertia matrix is none of a rigid body, or a mass is not positive.
    """

    geometry: Array
    rotor_input: RotorInput
    mass: Array
    inertia: Array
    cg: Array
    thrust: Array
    torque: Array
    damping: Array
    rotor_inertia: Array
    drag: Array
    thrust_curve: Array = field(default_factory=lambda: np.zeros(()))
    motor_lag: Array = field(default_factory=lambda: np.zeros(()))
    further: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not rb.are_physical(self.inertia).all():
            raise InputError("no rigid body has this inertia: see result.parameters")
        if not (np.asarray(self.mass) > 0.0).all():
            raise InputError("the mass of a flight model must be positive")

    @property
    def hover(self) -> Array:
        """(...) speed in rad/s or command at which the mean rotor carries the weight."""
        load = np.asarray(self.mass) * GRAVITY / self.thrust.sum(axis=-1)
        return self.rotor_input.at_load(load, np.asarray(self.thrust_curve))

    def over_stretches(self) -> "FlightModel":
        """An ensemble (samples,) as (samples, 1): each sample then flies each of many inputs."""
        arrays: dict[str, Any] = {
            each.name: np.expand_dims(value, 1)
            for each in fields(self)
            if each.name not in ("geometry", "rotor_input", "further")
            and np.ndim(value := getattr(self, each.name))
        }
        arrays["further"] = {
            name: np.expand_dims(value, 1) if np.ndim(value) else value
            for name, value in self.further.items()
        }
        return replace(self, **arrays)

    def simulate(
        self,
        t: ArrayLike,
        rotors: ArrayLike,
        initial: MotionState | None = None,
        *,
        angular_disturbance: ArrayLike | None = None,
        linear_disturbance: ArrayLike | None = None,
    ) -> Trajectory:
        """Fly the model by the midpoint rule; inputs run straight between their samples.

        Leading axes of model, inputs and initial state broadcast: an ensemble of shape
        (samples, 1) over inputs of shape (stretches, n, rotors) flies each sample on each stretch.

        Args:
            t: (n,) s, increasing.
            rotors: (..., n, rotors) speeds in rad/s, or commands of 0 to 1.
            initial: motion at t[0]; None: level and at rest.
            angular_disturbance: (..., n - 1, 3) a_d of each step, rad/s^2, body axes.
            linear_disturbance: (..., n - 1, 3) f_d of each step, m/s^2, world axes.

        Raises:
            InputError: shapes do not fit, or something is not finite.

        Example:
            >>> import numpy as np
            >>> import gcs_sysid
            >>> model = gcs_sysid.analyze("logs/sample.tlog", "paper").model()
            >>> t = np.linspace(0.0, 0.5, 126)
            >>> speeds = np.tile(model.hover, (len(t), 4))
            >>> flown = model.simulate(t, speeds)  # its CG is not in the middle: it tips over
            >>> bool(abs(flown.rates[-1, 0]) > 1.0), flown.attitude.shape
            (True, (126, 4))
        """
        times, inputs = self._checked(t, rotors)
        start = MotionState() if initial is None else initial
        if self.rotor_input.motors:
            inputs = self.lagged(times, inputs, start.rotors)
        forcing = self._forcing(times, inputs)
        steps = len(times) - 1
        noise = (
            _over_time(angular_disturbance, "angular_disturbance", steps),
            _over_time(linear_disturbance, "linear_disturbance", steps),
        )
        states = [
            *_by_component(_finite(start.rates, "initial rates")),
            *_by_component(_finite(start.attitude, "initial attitude")),
            *_by_component(_finite(start.velocity, "initial velocity")),
            *_by_component(_finite(start.position, "initial position")),
        ]
        try:
            shape = np.broadcast_shapes(
                forcing.thrust.shape[1:],
                np.shape(self.mass),
                *(part.shape for part in states),
                *(part.shape[1:] for three in noise if three is not None for part in three),
            )
            return self._flown(times, forcing, noise, states, shape)
        except ValueError as error:
            raise InputError(
                f"shapes of model, inputs and initial state differ: {error}"
            ) from error

    def _checked(self, t: ArrayLike, rotors: ArrayLike) -> tuple[Array, Array]:
        times, inputs = _finite(t, "t"), _finite(rotors, "rotors")
        if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise InputError("t: must be two or more increasing times in s")
        n = self.geometry.shape[1]
        if inputs.ndim < 2 or inputs.shape[-2:] != (len(times), n):
            raise InputError(
                f"rotors: must have the shape (..., {len(times)}, {n}), not {inputs.shape}"
            )
        return times, inputs

    def lagged(self, t: Array, commands: Array, before: ArrayLike | None = None) -> Array:
        """(..., n, rotors) commands behind the motors' lag, exact for straight lines.

        w_k = a w_{k-1} + b0 u_k + b1 u_{k-1} with a = exp(-dt / tau), as of `motor_filter`.
        """
        lag = np.maximum(np.asarray(self.motor_lag, np.float64), 1e-9)[..., None]
        w = commands[..., 0, :] if before is None else _finite(before, "initial rotors")
        out = np.empty((*np.broadcast_shapes(lag.shape, w.shape)[:-1], *commands.shape[-2:]))
        if commands.ndim > 2:
            shape = np.broadcast_shapes(out.shape[:-2], commands.shape[:-2])
            out = np.empty((*shape, *commands.shape[-2:]))
        out[..., 0, :] = w
        for k, dt in enumerate(np.diff(t), 1):
            a = np.exp(-dt / lag)
            share = lag / dt * (1.0 - a)
            new, old = commands[..., k, :], commands[..., k - 1, :]
            out[..., k, :] = a * out[..., k - 1, :] + (1.0 - share) * new + (share - a) * old
        return out

    def _forcing(self, t: Array, inputs: Array) -> _Forcing:
        x, y, s = self.geometry
        curve = np.asarray(self.thrust_curve)[..., None, None]
        load = self.rotor_input.load(inputs, curve)
        turning = self.rotor_input.turning(inputs, curve)
        thrusts = load * self.thrust[..., None, :]
        total = thrusts.sum(axis=-1)
        cg_x, cg_y = self.cg[..., 0, None], self.cg[..., 1, None]
        moment = (
            cg_y * total - thrusts @ y,
            thrusts @ x - cg_x * total,
            (load * self.torque[..., None, :]) @ s,
        )
        momentum = np.asarray(self.rotor_inertia)[..., None] * (turning @ s)
        reaction = np.diff(momentum, axis=-1) / np.diff(t)
        first = [np.moveaxis(part, -1, 0) for part in (*moment, total, momentum, reaction)]
        return _Forcing((first[0], first[1], first[2]), *first[3:])

    def _flown(
        self,
        t: Array,
        forcing: _Forcing,
        noise: tuple[list[Array] | None, list[Array] | None],
        states: list[Array],
        shape: tuple[int, ...],
    ) -> Trajectory:
        J = _by_component(self.inertia)
        inverse = np.linalg.inv(rb.inertia_matrix(self.inertia))
        J_inv = [inverse[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
        d = _by_component(self.damping)
        own = [
            (axis, rb.RATE_SIGNALS.index(signal), factor * value)
            for name, value in self.further.items()
            for axis, signal, factor in REGISTRY[name].torque
        ]
        mass, drag = np.asarray(self.mass), np.asarray(self.drag)
        out = np.empty((len(t), 13, *shape))
        out[0] = np.stack([np.broadcast_to(part, shape) for part in states])
        state = out[0]
        for k, dt in enumerate(np.diff(t)):
            parts = max(1, int(np.ceil(dt / _LONGEST_STEP - 1e-9)))
            angular, linear = (None if n is None else [part[k] for part in n] for n in noise)
            for part in range(parts):
                state = self._step(
                    state, dt / parts, _between(forcing, k, part / parts),
                    _between(forcing, k, (part + 0.5) / parts), (J, J_inv, d, own),
                    (mass, drag), (angular, linear),
                )  # fmt: skip
            out[k + 1] = state
        whole = np.moveaxis(np.moveaxis(out, 1, -1), 0, -2)
        return Trajectory(t, whole[..., :3], whole[..., 3:7], whole[..., 7:10], whole[..., 10:])

    @staticmethod
    def _step(
        state: Array,
        h: float,
        begin: tuple[Array, ...],
        middle: tuple[Array, ...],
        body: _Body,
        translation: tuple[Array, Array],
        noise: tuple[list[Array] | None, list[Array] | None],
    ) -> Array:
        """One step of the midpoint rule: w by its derivative there, q by the turn at w there."""
        mass, drag = translation
        angular, linear = noise
        new = np.empty_like(state)
        w, q, v = state[:3], state[3:7], state[7:10]
        w_mid = w + 0.5 * h * _acceleration(w, begin, body, angular)
        new[:3] = w + h * _acceleration(w_mid, middle, body, angular)
        new[3:7] = _turned(q, w_mid, h)
        a, b, c, d = _turned(q, w_mid, 0.5 * h)
        pull = -middle[3] / mass
        force = np.empty_like(v)  # over mass, without drag
        force[0] = pull * 2.0 * (b * d + a * c)
        force[1] = pull * 2.0 * (c * d - a * b)
        force[2] = pull * (1.0 - 2.0 * (b * b + c * c)) + GRAVITY
        for axis, extra in enumerate(linear or ()):
            force[axis] += extra
        # v' = f - (D/m) v, to second order.
        slow = drag / mass
        new[7:10] = v + h * (force - slow * (v + 0.5 * h * (force - slow * v)))
        new[10:] = state[10:] + 0.5 * h * (v + new[7:10])
        return new


def _between(forcing: _Forcing, k: int, share: float) -> tuple[Array, ...]:
    """Moment (three), thrust, J_r H and J_r H' between samples k and k + 1."""
    kept = 1.0 - share
    values = [
        kept * part[k] + share * part[k + 1]
        for part in (*forcing.moment, forcing.thrust, forcing.momentum)
    ]
    return (*values, forcing.reaction[k])


def _acceleration(
    w: Array,
    forcing: tuple[Array, ...],
    body: _Body,
    extra: list[Array] | None,
) -> Array:
    """(3, ...) w' = J^-1 (M - w x (J w + h) - h' - d w) + a_d."""
    J, J_inv, d, own = body
    p, q, r = w
    m_x, m_y, m_z, _, momentum, reaction = forcing
    l_x = J[0] * p + J[3] * q + J[5] * r
    l_y = J[3] * p + J[1] * q + J[4] * r
    l_z = J[5] * p + J[4] * q + J[2] * r - momentum
    n_x = m_x - (q * l_z - r * l_y) - d[0] * p
    n_y = m_y - (r * l_x - p * l_z) - d[1] * q
    n_z = m_z - (p * l_y - q * l_x) - d[2] * r + reaction
    if own:
        signals, torque = rb.rate_signals(np.moveaxis(w, 0, -1)), [n_x, n_y, n_z]
        for axis, signal, coefficient in own:
            torque[axis] = torque[axis] + coefficient * signals[..., signal]
        n_x, n_y, n_z = torque
    out = np.empty_like(w)
    out[0] = J_inv[0] * n_x + J_inv[3] * n_y + J_inv[5] * n_z
    out[1] = J_inv[3] * n_x + J_inv[1] * n_y + J_inv[4] * n_z
    out[2] = J_inv[5] * n_x + J_inv[4] * n_y + J_inv[2] * n_z
    for axis, more in enumerate(extra or ()):
        out[axis] += more
    return out


def _turned(q: Array, w: Array, h: float) -> Array:
    """(4, ...) quaternions after turning at body rates w for h s: q exp(w h / 2)."""
    half = 0.5 * h * np.sqrt((w * w).sum(axis=0))
    c, s = np.cos(half), 0.5 * h * np.sinc(half / np.pi)
    x, y, z = s * w
    a, b, e, f = q
    out = np.empty_like(q)
    out[0] = a * c - b * x - e * y - f * z
    out[1] = a * x + b * c + e * z - f * y
    out[2] = a * y - b * z + e * c + f * x
    out[3] = a * z + b * y - e * x + f * c
    return out


def _by_component(values: Array) -> list[Array]:
    """The last axis as a list."""
    return [values[..., i] for i in range(values.shape[-1])]


def _over_time(values: ArrayLike | None, name: str, steps: int) -> list[Array] | None:
    """Three of (steps, ...) of (..., steps, 3)."""
    if values is None:
        return None
    array = _finite(values, name)
    if array.ndim < 2 or array.shape[-2:] != (steps, 3):
        raise InputError(f"{name}: must have the shape (..., {steps}, 3), not {array.shape}")
    return _by_component(np.moveaxis(array, -2, 0))


def _finite(values: ArrayLike, name: str) -> Array:
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: not an array of numbers ({error})") from error
    if not np.isfinite(array).all():
        raise InputError(f"{name}: must be finite")
    return array
