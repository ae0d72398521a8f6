"""The true vehicle: every parameter the emulated flight obeys.

A value is a float for one vehicle, or an array of shape (N,) for an ensemble of N.
"""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from gcs_sysid.model.airframe import CommandRange, Rotor
from gcs_sysid.model.parameters import AXIS_DAMPINGS, GRAVITY, REGISTRY

Value = Any
"""A float, or a float array of shape (N,): the physics is written once for both."""

LAGS = ("speed", "thrust", "command")
"""What may lag behind the command."""


@dataclass(frozen=True)
class RotorTraits:
    """How the rotors differ from the ideal ones.

    Attributes:
        thrust: e_i, each rotor's k_T over the vehicle's.
        torque: e'_i, each rotor's k_M over the vehicle's.
        tilt: delta, rad; positive where the cant helps the drag torque.
    """

    thrust: tuple[Value, ...]
    torque: tuple[Value, ...]
    tilt: float = 0.0

    def weakened(self, rotor: int, share: float) -> "RotorTraits":
        """The same with one rotor's thrust and torque less by this share."""
        left = 1.0 - share
        return RotorTraits(
            tuple(left * e if i == rotor else e for i, e in enumerate(self.thrust)),
            tuple(left * e if i == rotor else e for i, e in enumerate(self.torque)),
            self.tilt,
        )


def even(count: int) -> RotorTraits:
    """Rotors that are all alike."""
    return RotorTraits((1.0,) * count, (1.0,) * count)


@dataclass(frozen=True)
class Vehicle:
    """True parameters, with names, symbols and units of results (`model.parameters`).

    Attributes:
        name: of the airframe.
        rotors: positions from the geometric center and spins, in the autopilot's motor order.
        lag_of: what lags: "speed", the rotor's speed behind the one commanded (a motor that turns
            a propeller), "thrust", or "command", the command itself before the thrust curve
            (PX4's SIH).
        imu_x: IMU from the CG, forward, m; imu_y to the right, imu_z down.
        command: range of the actuator outputs.
        rotor_z: height of the rotors' plane from the CG, down, m: below zero is above the CG.
        damping: d of roll, pitch and yaw apart, N m s; None: `rotational_damping` on all three.
        traits: of the single rotors; None: all alike and upright.
    """

    name: str
    rotors: tuple[Rotor, ...]
    mass: Value
    Ixx: Value
    Iyy: Value
    Izz: Value
    k_T: Value
    k_M: Value
    T_max: Value
    Ixy: Value = 0.0
    Iyz: Value = 0.0
    Ixz: Value = 0.0
    cg_x: Value = 0.0
    cg_y: Value = 0.0
    thrust_curve: Value = 0.0
    motor_lag: Value = 0.0
    rotational_damping: Value = 0.0
    rotor_inertia: Value = 0.0
    linear_drag: Value = 0.0
    imu_x: Value = 0.0
    imu_y: Value = 0.0
    imu_z: Value = 0.0
    lag_of: str = "speed"
    command: CommandRange = field(default_factory=CommandRange)
    rotor_z: Value = 0.0
    damping: tuple[Value, Value, Value] | None = None
    traits: RotorTraits | None = None

    def truth(self) -> dict[str, Any]:
        """The parameters under the names that results use, for a truth file.

        The place of the IMU is in it where it is not at the CG, and each rotor's coefficients where
        they differ: `k_T` and `k_M` are then their means.
        """
        values: dict[str, Any] = {
            **{n: getattr(self, n) for n, p in REGISTRY.items() if p.of_vehicle and not p.optional},
            **{
                name: getattr(self, name)
                for name in ("imu_x", "imu_y", "imu_z")
                if np.any(getattr(self, name))
            },
        }
        if self.damping is not None:
            values["damping"] = list(self.damping)
            values |= dict(zip(AXIS_DAMPINGS, self.damping, strict=True))
            values["rotational_damping"] = 0.5 * (self.damping[0] + self.damping[1])
        if self.traits is not None:
            for name, shares in (("k_T", self.traits.thrust), ("k_M", self.traits.torque)):
                each = [e * getattr(self, name) for e in shares]
                values[f"{name}_rotors"], values[name] = each, sum(each) / len(each)
            values["moment_ratio"] = values["k_M"] / values["k_T"]
            values["rotor_tilt"] = self.traits.tilt
        return values

    @property
    def moment_ratio(self) -> Value:
        """k_M / k_T, m."""
        return self.k_M / self.k_T

    def with_mass_factor(self, factor: float) -> "Vehicle":
        """The same vehicle with its mass multiplied; inertia and CG stay."""
        return replace(self, mass=self.mass * factor)

    def command_of(self, speed: Value) -> Value:
        """Command u in 0..1 that gives this rotor speed (rad/s) in steady state.

        Solves (1 - c) u + c u^2 = k_T Omega^2 / T_max; the form below holds for c = 0 too.
        """
        share = self.k_T * speed * speed / self.T_max
        linear = 1.0 - self.thrust_curve
        root = linear * linear + 4.0 * self.thrust_curve * share
        return 2.0 * share / (linear + root**0.5 + 1e-300)

    def speed_of(self, command: Value) -> Value:
        """Rotor speed (rad/s) of this command u in steady state."""
        c = self.thrust_curve
        return (self.T_max / self.k_T * command * (1.0 - c + c * command)) ** 0.5


def stack_vehicles(vehicles: list[Vehicle]) -> Vehicle:
    """One vehicle whose values are arrays of shape (N,): an ensemble of the given ones.

    All must have the same rotors.

    Raises:
        ValueError: the layouts differ.
    """
    first = vehicles[0]
    if any(v.rotors != first.rotors for v in vehicles):
        raise ValueError("an ensemble needs vehicles with the same rotors")
    fixed = {"name", "rotors", "command", "lag_of", "damping", "traits"}
    arrays: dict[str, Any] = {
        f.name: np.array([getattr(v, f.name) for v in vehicles], dtype=float)
        for f in fields(Vehicle)
        if f.name not in fixed
    }
    return replace(first, **arrays)


def allocation(vehicle: Vehicle) -> list[list[Value]]:
    """Per rotor, the shares of (T, M_x, M_y, M_z) that make up its thrust in N.

    The pseudo-inverse of the map from thrusts to wrench about the CG: exact for four rotors,
    of least squared thrust for more.
    """
    v = vehicle
    if v.traits is not None and v.traits.tilt:
        return _canted_allocation(v)
    cg_x, cg_y, moment_ratio = np.broadcast_arrays(v.cg_x, v.cg_y, v.moment_ratio)
    effect = np.stack(
        [
            np.stack(
                [np.ones(cg_x.shape), -(r.y - cg_y), r.x - cg_x, r.spin * moment_ratio], axis=-1
            )
            for r in v.rotors
        ],
        axis=-1,
    )
    return _mixer(effect)


def _canted_allocation(v: Vehicle) -> list[list[Value]]:
    """The same for rotors that the builder has canted, and so knows to be."""
    assert v.traits is not None
    cosine = np.cos(v.traits.tilt)
    columns = []
    for r in v.rotors:
        moments = per_thrust(v, r, v.k_M / v.k_T)[2:]
        columns.append(np.stack(np.broadcast_arrays(cosine, *moments), axis=-1))
    return _mixer(np.stack(columns, axis=-1))


def _mixer(effect: Any) -> list[list[Value]]:
    """Rows of the pseudo-inverse of (..., 4, n), a rotor each."""
    mix = np.linalg.pinv(effect)
    return [
        [float(x) if x.ndim == 0 else x for x in np.moveaxis(mix[..., i, :], -1, 0)]
        for i in range(mix.shape[-2])
    ]


def hover_thrusts(vehicle: Vehicle) -> list[Value]:
    """Thrust of every rotor in steady hover, N."""
    weight = vehicle.mass * GRAVITY
    return [share[0] * weight for share in allocation(vehicle)]


def per_thrust(vehicle: Vehicle, rotor: Rotor, ratio: Value) -> tuple[Value, ...]:
    """(F_x, F_y, M_x, M_y, M_z) of 1 N along a rotor's axis, its drag torque included.

    Args:
        vehicle: whose CG, tilt and height of the rotors count.
        rotor: which.
        ratio: its drag torque over its thrust, m.
    """
    delta = vehicle.traits.tilt if vehicle.traits is not None else 0.0
    cosine, sine = math.cos(delta), math.sin(delta)
    arm = math.hypot(rotor.x, rotor.y) or 1.0
    t_x, t_y = -rotor.y / arm, rotor.x / arm
    f_x, f_y = rotor.spin * sine * t_x, rotor.spin * sine * t_y
    r_x, r_y, r_z = rotor.x - vehicle.cg_x, rotor.y - vehicle.cg_y, vehicle.rotor_z
    return (
        f_x,
        f_y,
        -r_y * cosine - r_z * f_y - rotor.spin * ratio * f_x,
        r_z * f_x + r_x * cosine - rotor.spin * ratio * f_y,
        r_x * f_y - r_y * f_x + rotor.spin * ratio * cosine,
    )
