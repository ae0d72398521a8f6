"""The vehicle in hover, linear from normalized torque commands to body rates.

    w' = -J^-1 diag(d) w + (B + s B_r) A(s) u,   A(s) = exp(-s delay) / (1 + s lag)
    B = J^-1 E diag(dT_i/dt_i) mixer,   E_i = (-(y_i - cg_y), x_i - cg_x, s_i k_M/k_T)
    B_r: the reaction of the rotors' inertia about the yaw axis, J_r s_i dOmega_i

with t_i the thrust command of rotor i. A rotor's slope dT/dt is that of its own thrust curve at its
own share of the hover, over the slope of the curve that the autopilot inverts. Gyroscopic coupling
is left out: it vanishes in hover where as many rotors turn either way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.control.rate_loops import RateLoop
from gcs_sysid.exports.exported_vehicle import ExportedVehicle, MissingError
from gcs_sysid.model.parameters import AXIS_DAMPINGS, GRAVITY, INERTIA

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
        out: Array = body @ (self.effectiveness[:, None] + s * self.reaction[:, None]) * actuator
        return out

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


def check_needs(vehicle: ExportedVehicle) -> None:
    """Check that all that a loop depends on is known and identified.

    Raises:
        MissingError: says what is not, why it matters, and which flight would help.
    """
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
        elif vehicle.known[name].origin == "weak" and name not in _WEAK_ENOUGH:
            missing.setdefault(group, f"{name} (weak)")
    if missing:
        names = ", ".join(missing.values())
        advice = "; ".join(FLIGHT_FOR[group] for group in missing)
        raise MissingError(f"no gains from this result: {names} not identified: {advice}")
    if all(n in vehicle.known for n in INERTIA):
        vehicle.check_inertia()


def _one(
    v: ExportedVehicle, loop: RateLoop, reaction_time: float | None
) -> tuple[Array, Array, Array, float, Array]:
    places = np.array([[r.x, r.y] for r in v.rotors])
    spins = np.array([float(r.spin) for r in v.rotors])
    cg = np.array([v.get("cg_x") or 0.0, v.get("cg_y") or 0.0])
    thrust, ratio = _of_each_rotor(v)
    levers = places - cg
    E = np.stack([-levers[:, 1], levers[:, 0], spins * ratio])
    J = np.array([[v.get(n) or 0.0 for n in row] for row in _ELEMENTS])
    weight = v["mass"] * GRAVITY
    hover = np.linalg.pinv(np.vstack([np.ones(len(spins)), E])) @ [weight, 0.0, 0.0, 0.0]
    # No rotor of a hover gives next to nothing.
    share = np.maximum(hover / (v["T_max"] * thrust), 0.02)
    f = loop.curve
    c = v.get("thrust_curve")
    c = f if c is None else c
    u = _command(share, c)
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


_ELEMENTS = (("Ixx", "Ixy", "Ixz"), ("Ixy", "Iyy", "Iyz"), ("Ixz", "Iyz", "Izz"))


def _of_each_rotor(v: ExportedVehicle) -> tuple[Array, Array]:
    """(n,) thrust of each rotor over their mean, and moment ratio, m."""
    n = len(v.rotors)
    if not v.rotors_differ or v.get("k_T") is None:
        return np.ones(n), np.full(n, v["moment_ratio"])
    k_T, ratio = np.array([v.rotor_coefficients(i) for i in range(n)]).T
    return k_T / v["k_T"], ratio


def _command(share: Array, c: float) -> Array:
    """Command u with (1 - c) u + c u^2 = share."""
    linear = 1.0 - c
    out: Array = 2.0 * share / (linear + np.sqrt(np.maximum(linear**2 + 4.0 * c * share, 1e-12)))
    return out
