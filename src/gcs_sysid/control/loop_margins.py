"""Margins and step responses of the loops around a vehicle in hover.

The loop of an axis is broken at its torque, with the loops of the other axes closed: what a sweep
injected there measures. With H the loops' response to body rates and G the vehicle,

    1 + l_i = 1 / [(1 + H G)^-1]_ii

G is linear, from normalized torque commands to body rates:

    w' = -J^-1 diag(d) w + (B + s B_r) A(s) u,   A(s) = exp(-s delay) / (1 + s lag)
    B = J^-1 E diag(dT_i/dt_i) mixer,   E_i = (-(y_i - cg_y), x_i - cg_x, s_i k_M/k_T)
    B_r: the reaction of the rotors' inertia about the yaw axis, J_r s_i dOmega_i

with t_i the thrust command of rotor i. A rotor's slope dT/dt is that of its own thrust curve at its
own share of the hover, over the slope of the curve that the autopilot inverts. Gyroscopic coupling
is left out: it vanishes in hover where as many rotors turn either way.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.control.rate_loops import HoverPoint, RateLoop
from gcs_sysid.exports.exported_vehicle import ExportedVehicle, MissingError
from gcs_sysid.model.parameters import AXIS_DAMPINGS, GRAVITY, INERTIA
from gcs_sysid.model.rigid_body import inertia_matrix
from gcs_sysid.model.rotor_input import RotorInput

FLIGHT_FOR = {
    "inertia": "fly doublets on all axes until Ixx, Iyy and Izz are identified (gcs-sysid plan)",
    "motor_lag": "analyze a lively flight with commands (ACTUATOR_OUTPUT_STATUS or "
    'SERVO_OUTPUT_RAW, rotor_input = "command"), or give --set motor_lag=S',
    "T_max": "analyze a flight with commands, or give --set rotor_speed_max=RAD_S or --set T_max=N",
    "moment_ratio": "fly yaw together with roll and pitch until k_M is identified",
    "mass": "weigh the vehicle and analyze again with --mass KG",
}
"""What would help where something is missing."""

_WEAK_ENOUGH = ("moment_ratio", "motor_lag")
"""Margins are kept over the whole interval: what trades against the delay counts by their sum."""
_USUAL_REACTION = (0.0, 0.25)
"""s, J_r / (2 k_M Omega) in hover: 0.02 of a Crazyflie with bare propellers, 0.2 where rotor and
bell are heavy for the propeller (the vehicles of benchmarks/truth: 0.1 to 0.25)."""


@dataclass(frozen=True)
class HoverDynamics:
    """The linear model of N vehicles (draws from the covariance), the nominal one first.

    Attributes:
        effectiveness: (N, 3, 3) B, rad/s^2 per normalized torque.
        reaction: (N, 3, 3) B_r, rad/s per normalized torque.
        damping: (N, 3, 3) J^-1 diag(d), 1/s.
        lag: (N,) s.
        delay: (N,) s, from the gyro's sample to the rotor's command, hold of the loop not included.
        hover: (N, n) share of the thrust command in hover of each rotor.
        notes: what was assumed.
    """

    effectiveness: Array
    reaction: Array
    damping: Array
    lag: Array
    delay: Array
    hover: Array
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.lag)

    def first(self, count: int) -> "HoverDynamics":
        """The nominal vehicle and the first draws: `count` altogether."""
        arrays = {f.name: getattr(self, f.name)[:count] for f in fields(self) if f.name != "notes"}
        return replace(self, **arrays)

    def response(self, omega: Array, period: float = 0.0) -> Array:
        """(N, w, 3, 3) body rates over normalized torques.

        Args:
            omega: (w,) rad/s.
            period: s, of the loop whose outputs are held; 0: no hold.
        """
        s = 1j * omega[:, None, None]
        body = np.linalg.inv(s * np.eye(3) + self.damping[:, None])
        actuator = np.exp(-s * self.delay[:, None, None, None]) / (
            1.0 + s * self.lag[:, None, None, None]
        )
        if period > 0.0:
            actuator = actuator * (1.0 - np.exp(-s * period)) / (s * period)
        return body @ (self.effectiveness[:, None] + s * self.reaction[:, None]) * actuator

    def as_control(self, axis: int, pade: int = 2) -> object:
        """The nominal transfer function of one axis, as a `control.TransferFunction`.

        From normalized torque to body rate in rad/s, without the loop's hold; the delay is a Pade
        approximation of the order given.

        Raises:
            ImportError: python-control is not installed (`pip install gcs-sysid[control]`).
        """
        import control

        gain = self.effectiveness[0, axis, axis]
        numerator = [self.reaction[0, axis, axis], gain]
        lag = [self.lag[0], 1.0] if self.lag[0] > 0.0 else [1.0]
        denominator = np.polymul(lag, [1.0, self.damping[0, axis, axis]])
        plant = control.tf(np.trim_zeros(numerator, "f"), denominator)
        if self.delay[0] > 0.0 and pade > 0:
            plant = plant * control.tf(*control.pade(self.delay[0], pade))
        return plant


def hover_dynamics(
    vehicles: Sequence[ExportedVehicle],
    loop: RateLoop,
    delay: tuple[float, float],
    seed: int = 1,
    *,
    traded: bool = False,
) -> HoverDynamics:
    """The linear model of vehicles in hover.

    Args:
        vehicles: the nominal one, then draws from its covariance.
        loop: of the autopilot, for its mixer and thrust curve.
        delay: s and standard deviation, the same for every rotor.
        seed: of the draws of the delay.
        traded: whether the delay was identified together with the motors' lag. A flight determines
            their sum far better than either, so they are drawn with opposite errors.

    Raises:
        MissingError: the result lacks what a loop depends on; names the flight that would help.
    """
    first = vehicles[0]
    check_needs(first)
    random = np.random.default_rng(seed)
    delays = np.maximum(delay[0] + delay[1] * random.standard_normal(len(vehicles)), 0.0)
    delays[0] = delay[0]
    # Where the flight does not determine the rotors' inertia, it is drawn from the usual range.
    unknown = first.get("rotor_inertia") is None or first.get("k_T") is None
    reactions = random.uniform(*_USUAL_REACTION, len(vehicles))
    reactions[0] = np.mean(_USUAL_REACTION)
    parts = [
        _one(vehicle, loop, float(reaction) if unknown else None)
        for vehicle, reaction in zip(vehicles, reactions, strict=True)
    ]
    B, reaction, damping, lag, hover = (np.array(v) for v in zip(*parts, strict=True))
    std = first.known["motor_lag"].std
    if traded and std:
        delays = np.maximum(delay[0] - delay[1] / std * (lag - lag[0]), 0.0)
    notes = []
    if first.get("thrust_curve") is None:
        notes.append(
            "the thrust curve is not identified: assumed to be the one that the autopilot inverts"
        )
    if unknown:
        low, high = _USUAL_REACTION
        notes.append(
            "rotor inertia is not identified: its reaction in yaw, J_r / (2 k_M Omega), is "
            f"drawn from {low:g} to {high:g} s; a result by rotor speeds (--with) narrows it"
        )
    return HoverDynamics(B, reaction, damping, lag, delays, hover, tuple(notes))


def hover_point(v: ExportedVehicle) -> HoverPoint:
    """What is known of the rotors in hover."""
    if v.get("mass") is None:
        return HoverPoint()
    throttle = v.hover_command(v.get("thrust_curve") or 0.0) if v.get("T_max") else None
    return HoverPoint(
        None if throttle is None else min(throttle, 1.0),
        v.hover_speed / (2.0 * math.pi) if v.get("k_T") else None,
    )


def check_needs(vehicle: ExportedVehicle) -> None:
    """Check that all that a loop depends on is known and identified.

    Raises:
        MissingError: says what is not, why it matters, and which flight would help.
    """
    if vehicle.result.verdict == "refused":
        why = "; ".join(vehicle.result.reasons[:1])
        raise MissingError(f"no gains from a result that is refused: {why}")
    missing: dict[str, str] = {}
    for name, group in (
        *((name, "inertia") for name in INERTIA[:3]),
        ("mass", "mass"),
        ("T_max", "T_max"),
        ("moment_ratio", "moment_ratio"),
        ("motor_lag", "motor_lag"),
    ):
        if vehicle.get(name) is None:
            missing.setdefault(group, name)
        elif name not in _WEAK_ENOUGH and (weak := _weak_in(vehicle, name)):
            missing.setdefault(group, f"{weak} (weak)")
    if missing:
        names = ", ".join(missing.values())
        advice = "; ".join(FLIGHT_FOR[group] for group in missing)
        raise MissingError(f"no gains from this result: {names} not identified: {advice}")
    if all(n in vehicle.known for n in INERTIA):
        vehicle.check_inertia()


def _weak_in(vehicle: ExportedVehicle, name: str) -> str:
    """The parameter, or one that it follows from, if that is weak; else empty."""
    own = vehicle.known[name]
    of = own.origin.removeprefix("from ").split(" and ") if own.derived else [name]
    return next((n for n in of if n in vehicle.known and vehicle.known[n].origin == "weak"), "")


def _one(
    v: ExportedVehicle, loop: RateLoop, reaction_time: float | None
) -> tuple[Array, Array, Array, float, Array]:
    places = np.array([[r.x, r.y] for r in v.rotors])
    spins = np.array([float(r.spin) for r in v.rotors])
    cg = np.array([v.get("cg_x") or 0.0, v.get("cg_y") or 0.0])
    thrust, ratio = _of_each_rotor(v)
    levers = places - cg
    E = np.stack([-levers[:, 1], levers[:, 0], spins * ratio])
    J = inertia_matrix(np.array([v.get(n) or 0.0 for n in INERTIA]))
    weight = v["mass"] * GRAVITY
    hover = np.linalg.pinv(np.vstack([np.ones(len(spins)), E])) @ [weight, 0.0, 0.0, 0.0]
    # No rotor of a hover gives next to nothing.
    share = np.maximum(hover / (v["T_max"] * thrust), 0.02)
    f = loop.curve
    c = v.get("thrust_curve")
    c = f if c is None else c
    u = RotorInput.COMMAND.at_load(share, np.array(c))
    slope = v["T_max"] * thrust * (1.0 - c + 2.0 * c * u) / (1.0 - f + 2.0 * f * u)
    inverse = np.linalg.inv(J)
    B = inverse @ (E * slope) @ loop.mixer
    k_T, J_r = v.get("k_T"), v.get("rotor_inertia")
    reaction = np.zeros((3, 3))
    if reaction_time is not None:
        reaction = inverse[:, 2:] @ (spins * ratio * reaction_time * slope @ loop.mixer)[None]
    elif k_T is not None and J_r:
        speed = np.sqrt(np.maximum(hover, 1e-9) / (k_T * thrust))
        # T = k_T Omega^2: a rotor turns faster by dT / (2 k_T Omega).
        turning = spins * J_r * slope / (2.0 * k_T * thrust * speed)
        reaction = inverse[:, 2:] @ (turning @ loop.mixer)[None]
    mean = v.get("rotational_damping") or 0.0
    d = [mean if v.get(n) is None else v[n] for n in AXIS_DAMPINGS]
    stick = (1.0 - f) * u + f * u * u
    return B, reaction, inverse * d, v["motor_lag"], stick


def _of_each_rotor(v: ExportedVehicle) -> tuple[Array, Array]:
    """(n,) thrust of each rotor over their mean, and moment ratio, m."""
    n = len(v.rotors)
    if not v.rotors_differ or v.get("k_T") is None:
        return np.ones(n), np.full(n, v["moment_ratio"])
    k_T, ratio = np.array([v.rotor_coefficients(i) for i in range(n)]).T
    return k_T / v["k_T"], ratio


_SECONDS = 16.0
"""s, half the period of the square wave whose response is the step response."""


@dataclass(frozen=True)
class Margins:
    """Of one loop, for N vehicles.

    Attributes:
        crossover: (N,) rad/s, last gain crossover; NaN: the loop has no gain.
        phase: (N,) deg, the least at any crossover; below zero: unstable.
        gain: (N,) dB by which the gain may rise; below zero: unstable.
        reduction: (N,) dB by which it may fall; infinite where it may fall to nothing.
    """

    crossover: Array
    phase: Array
    gain: Array
    reduction: Array

    @property
    def delay(self) -> Array:
        """(N,) s by which the loop may be later."""
        return np.radians(self.phase) / self.crossover

    def worst(self) -> tuple[float, float]:
        """Least phase and gain margin (deg, dB) of all."""
        return float(np.min(self.phase)), float(np.min(self.gain))


def frequencies(loop: RateLoop, points: int = 400) -> Array:
    """(w,) rad/s up to just below half the loop rate."""
    # From 0.2 rad/s on: all crossovers lie above.
    return np.geomspace(0.2, 0.98 * np.pi * loop.rate, points)


def open_loops(
    dynamics: HoverDynamics, loop: RateLoop, omega: Array, *, attitude: bool = True
) -> Array:
    """(N, w, 3) loop transfer of each axis, broken at its torque, the other axes closed.

    At (w,) rad/s; `attitude`: the attitude loop is closed, as in any mode but Acro.
    """
    G = dynamics.response(omega, loop.period)
    difference = np.eye(3) + loop.feedback(omega, attitude=attitude)[None, :, :, None] * G
    own = np.diagonal(np.linalg.inv(difference), axis1=-2, axis2=-1)
    return 1.0 / own - 1.0


def closed_loops(
    dynamics: HoverDynamics, loop: RateLoop, omega: Array, *, attitude: bool = False
) -> tuple[Array, Array]:
    """(N, w, 3, 3) response of each axis to set-points of each, and to disturbances of its own.

    Args:
        dynamics: of N vehicles.
        loop: around them.
        omega: (w,) rad/s.
        attitude: whether set-points are those of the attitude; else those of body rates.

    Returns:
        Body rates over set-points; body rates over what they were without any loop.
    """
    G = dynamics.response(omega, loop.period)
    rate, angle, reference = loop.controllers(omega)
    H = rate + angle / (1j * omega[:, None]) if attitude else rate
    sensitivity = np.linalg.inv(np.eye(3) + G * H[None, :, None, :])
    return sensitivity @ G * (angle if attitude else reference)[None, :, None, :], sensitivity


def margins_of(omega: Array, loops: Array) -> Margins:
    """Margins of (N, w) loop transfers at (w,) rad/s, by interpolation."""
    rows = [_of_one(np.log(omega), *each) for each in zip(*bode(loops), strict=True)]
    return Margins(*(np.array(column) for column in zip(*rows, strict=True)))


def bode(loops: Array) -> tuple[Array, Array]:
    """Size in dB and phase in deg, without jumps, of (N, w) loop transfers."""
    first = np.angle(loops[:, :1])
    # An integrator or two begin at -90 to -270 deg, never above 0.
    start = np.where(first > 1e-6, first - 2.0 * np.pi, first)
    phase = np.degrees(start + np.unwrap(np.angle(loops), axis=1) - first)
    return 20.0 * np.log10(np.maximum(np.abs(loops), 1e-12)), phase


def _of_one(logs: Array, size: Array, phase: Array) -> tuple[float, float, float, float]:
    at, margin = _crossings(logs, size, phase + 180.0)
    _, above = _crossings(logs, phase + 180.0, size)
    crossover = float(np.exp(at[-1])) if len(at) else np.nan
    stable = not len(margin) or margin.min() > 0.0
    up = -above[above < 0.0]
    down = above[above >= 0.0]
    gain = float(up.min()) if len(up) else np.inf
    # Unstable: how far the gain must fall.
    if not stable:
        gain = -float(down.max()) if len(down) else -np.inf
    reduction = float(down.min()) if stable and len(down) else np.inf
    return crossover, float(margin.min()) if len(margin) else np.inf, gain, reduction


def _crossings(x: Array, level: Array, other: Array) -> tuple[Array, Array]:
    """Where a curve crosses zero: x there, and another curve's values there."""
    i = np.flatnonzero((level[:-1] > 0.0) != (level[1:] > 0.0))
    share = level[i] / (level[i] - level[i + 1])
    return x[i] + share * (x[i + 1] - x[i]), other[i] + share * (other[i + 1] - other[i])


@dataclass(frozen=True)
class StepResponse:
    """Response to a step of the set-point on one axis.

    Attributes:
        t: (k,) s.
        values: (N, k) over the step.
    """

    t: Array
    values: Array

    @property
    def overshoot(self) -> Array:
        """(N,) share of the step by which the peak exceeds it; never below zero."""
        shown = self.values[:, self.t <= 3.0]  # no overshoot comes later
        return np.maximum(shown.max(axis=1) - 1.0, 0.0)

    @property
    def rise(self) -> Array:
        """(N,) s from 10 to 90 % of the step."""
        low, high = ((self.values > level).argmax(axis=1) for level in (0.1, 0.9))
        return self.t[high] - self.t[low]


def step_response(
    dynamics: HoverDynamics, loop: RateLoop, axis: int, *, of: str = "attitude"
) -> StepResponse:
    """Response of attitude to its set-point, or of the rate to its own with no attitude loop.

    Of a square wave so long that each half settles, by its Fourier series. `of` is "attitude" or
    "rate".
    """
    half = round(_SECONDS * loop.rate)
    t = np.arange(half) * loop.period
    wave = np.repeat([1.0, 0.0], half)
    spectrum = np.fft.rfft(wave)
    omega = 2.0 * np.pi * np.fft.rfftfreq(2 * half, loop.period)
    # The even harmonics of a square wave are zero; what is near the Nyquist frequency does not act.
    used = np.flatnonzero(
        (np.abs(spectrum) > 1e-9) & (omega > 0.0) & (omega < 0.9 * np.pi * loop.rate)
    )
    w = omega[used]
    attitude = of == "attitude"
    shape = closed_loops(dynamics, loop, w, attitude=attitude)[0][:, :, axis, axis]
    if attitude:
        shape = shape / (1j * w)
    out = np.zeros((len(dynamics), len(omega)), complex)
    out[:, used] = shape * spectrum[used]
    out[:, 0] = spectrum[0]
    values = np.fft.irfft(out, 2 * half, axis=1)[:, :half]
    # Each half ends where it settled: the other half's end is the start.
    return StepResponse(t, values)
