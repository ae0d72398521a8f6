"""The rate and attitude loops of PX4 and ArduPilot, as their parameters set them.

PX4 (`lib/rate_control`, `sensors/vehicle_angular_velocity`, `control_allocator`), with K, P, I, D
of MC_*RATE_*, angular acceleration from the filtered gyro behind IMU_DGYRO_CUTOFF, and the rate
set-point of the attitude loop, MC_*_P times the attitude error:

    torque = K (P e + I sum(e) dt - D w'_f) + FF w_sp,   e = w_sp - w_f

ArduPilot (`AC_PID`, `AC_AttitudeControl_Multi`, `AP_MotorsMatrix`), with first-order filters FLTT
on the set-point, FLTE on the error and FLTD on the derivative of the filtered error:

    torque = P e_f + I sum(e_f) dt + D (e_f)' + FF w_sp,   e = FLTT(w_sp) - w_f

Both act on the gyro behind a second-order Butterworth low-pass (IMU_GYRO_CUTOFF, INS_GYRO_FILTER).
Torques are normalized; a rotor's thrust command is the sum of its column of the mixer times them,
and goes through the inverse of the thrust curve THR_MDL_FAC or MOT_THST_EXPO.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Rotor

Autopilot = Literal["px4", "ardupilot"]
AUTOPILOTS: tuple[Autopilot, ...] = ("px4", "ardupilot")
_AXIS_NAMES: dict[Autopilot, tuple[str, str, str]] = {
    "px4": ("ROLL", "PITCH", "YAW"), "ardupilot": ("RLL", "PIT", "YAW"),
}  # fmt: skip
_GAIN_NAMES: dict[Autopilot, dict[str, str]] = {
    "px4": {
        "P": "MC_{}RATE_P", "I": "MC_{}RATE_I", "D": "MC_{}RATE_D", "FF": "MC_{}RATE_FF",
        "attitude": "MC_{}_P",
    },
    "ardupilot": {
        "P": "ATC_RAT_{}_P", "I": "ATC_RAT_{}_I", "D": "ATC_RAT_{}_D", "FF": "ATC_RAT_{}_FF",
        "attitude": "ATC_ANG_{}_P",
    },
}  # fmt: skip
"""Fields of `AxisGains` -> the parameter of an axis."""
_USUAL_GAINS: dict[Autopilot, tuple[tuple[float, ...], ...]] = {
    "px4": ((0.15, 0.2, 0.003, 0.0, 6.5), (0.15, 0.2, 0.003, 0.0, 6.5), (0.2, 0.1, 0.0, 0.0, 2.8)),
    "ardupilot": (
        (0.135, 0.135, 0.0036, 0.0, 4.5), (0.135, 0.135, 0.0036, 0.0, 4.5),
        (0.18, 0.018, 0.0, 0.0, 4.5),
    ),
}  # fmt: skip
"""Defaults of the same, in the same order, on each axis."""
_NEGLIGIBLE = 1e-3
"""Entries of PX4's mixer below are zero."""


@dataclass(frozen=True)
class AxisGains:
    """Gains of one axis.

    Attributes:
        P: normalized torque per rad/s.
        I: the same per rad.
        D: the same per rad/s^2.
        FF: normalized torque per rad/s of the rate set-point.
        attitude: 1/s, rate set-point per attitude error.
    """

    P: float
    I: float  # noqa: E741
    D: float
    attitude: float
    FF: float = 0.0


@dataclass(frozen=True)
class RateLoop:
    """The loops of one autopilot with the settings of one vehicle.

    Attributes:
        autopilot: whose law it is.
        rate: Hz, of the rate loop.
        gyro_cutoff: Hz, second-order low-pass of the gyro; 0: none.
        derivative_cutoff: Hz on each axis, first-order low-pass of the derivative; 0: none.
        error_cutoff: Hz on each axis, of the error (ArduPilot); 0: none.
        target_cutoff: Hz on each axis, of the rate set-point (ArduPilot); 0: none.
        torque_cutoff: Hz on each axis, of the torque (PX4, yaw); 0: none.
        curve: c of T/T_max = (1 - c) u + c u^2 that the autopilot inverts.
        mixer: (n, 3) thrust command of each rotor per normalized torque.
        gains: of roll, pitch and yaw.
        assumed: parameters that were not given, and stand at the autopilot's defaults.
    """

    autopilot: Autopilot
    rate: float
    gyro_cutoff: float
    derivative_cutoff: tuple[float, float, float]
    error_cutoff: tuple[float, float, float]
    target_cutoff: tuple[float, float, float]
    torque_cutoff: tuple[float, float, float]
    curve: float
    mixer: Array
    gains: tuple[AxisGains, AxisGains, AxisGains]
    assumed: tuple[str, ...] = ()

    @property
    def period(self) -> float:
        """S."""
        return 1.0 / self.rate

    def with_gains(self, axis: int, gains: AxisGains) -> "RateLoop":
        """The same with other gains on one axis."""
        changed = list(self.gains)
        changed[axis] = gains
        return replace(self, gains=(changed[0], changed[1], changed[2]))

    def as_parameters(self) -> dict[str, float]:
        """The gains as the autopilot's parameters, by name; K of PX4 is 1."""
        out: dict[str, float] = {}
        for axis, gains in zip(_AXIS_NAMES[self.autopilot], self.gains, strict=True):
            if self.autopilot == "px4":
                out[f"MC_{axis}RATE_K"] = 1.0
            for field, name in _GAIN_NAMES[self.autopilot].items():
                out[name.format(axis)] = getattr(gains, field)
        return out

    def controllers(self, omega: Array) -> tuple[Array, Array, Array]:
        """Response of the loops to the vehicle's motion and to set-points, at frequencies.

        Args:
            omega: (w,) rad/s, below half the loop rate.

        Returns:
            (w, 3) normalized torque per negative body rate by the rate loop alone; (w, 3) the same
            per negative attitude error in rad, through the attitude loop; (w, 3) per rate
            set-point.
        """
        s = 1j * omega[:, None]
        z_inverse = np.exp(-s * self.period)
        gyro = np.ones_like(s)
        if self.gyro_cutoff > 0.0:
            x = s / (2.0 * np.pi * self.gyro_cutoff)
            gyro = 1.0 / (1.0 + np.sqrt(2.0) * x + x * x)
        P, Ki, D, attitude, FF = (
            np.array([getattr(g, name) for g in self.gains])
            for name in ("P", "I", "D", "attitude", "FF")
        )
        torque = self._first_order(self.torque_cutoff, z_inverse)
        if self.autopilot == "px4":
            # The integral of the last step acts; it is updated behind the output.
            PI = P + Ki * self.period * z_inverse / (1.0 - z_inverse)
            cutoff = np.array(self.derivative_cutoff)
            # At the gyro's own rate, which is fast against the cutoff.
            lag = np.where(cutoff > 0.0, 1.0 / (2.0 * np.pi * np.maximum(cutoff, 1e-9)), 0.0)
            rate = gyro * (PI + D * s / (1.0 + lag * s))
            reference = PI + FF
        else:
            error = self._first_order(self.error_cutoff, z_inverse)
            derivative = self._first_order(self.derivative_cutoff, z_inverse)
            slope = (1.0 - z_inverse) / self.period
            PID = error * (P + Ki * self.period / (1.0 - z_inverse) + D * slope * derivative)
            rate = gyro * PID
            reference = (PID + FF) * self._first_order(self.target_cutoff, z_inverse)
        return torque * rate, torque * reference * attitude, torque * reference

    def _first_order(self, cutoffs: tuple[float, float, float], z_inverse: Array) -> Array:
        """(w, 3) of y += a (x - y), a = dt / (dt + 1 / (2 pi f)), on each axis; 1 where f is 0."""
        f = np.array(cutoffs)
        a = np.where(f > 0.0, self.period / (self.period + 1.0 / (2.0 * np.pi * f.clip(1e-9))), 1.0)
        response: Array = a / (1.0 - (1.0 - a) * z_inverse)
        return response


def read_loop(
    autopilot: Autopilot, parameters: Mapping[str, float], rotors: tuple[Rotor, ...]
) -> RateLoop:
    """The loops by an autopilot's parameters; what is not there stands at its default.

    Args:
        autopilot: whose.
        parameters: name -> value.
        rotors: of the airframe, in the autopilot's motor order.

    Raises:
        InputError: a parameter makes no sense.
    """
    reader = _ParameterReader(parameters)
    loop = _px4(reader, rotors) if autopilot == "px4" else _ardupilot(reader, rotors)
    return replace(loop, assumed=tuple(reader.assumed))


class _ParameterReader:
    """Parameters with defaults, which remembers what was not there."""

    def __init__(self, parameters: Mapping[str, float]) -> None:
        self.parameters = parameters
        self.assumed: list[str] = []

    def get(self, name: str, usual: float, most: float = 1e4) -> float:
        if name not in self.parameters:
            self.assumed.append(name)
            return usual
        value = self.parameters[name]
        if not 0.0 <= value <= most:
            raise InputError(f"{name} = {value:g}: must lie in 0..{most:g}")
        return value


def _gains(
    reader: _ParameterReader, autopilot: Autopilot
) -> tuple[AxisGains, AxisGains, AxisGains]:
    """Gains of roll, pitch and yaw; PX4's K multiplies P, I and D."""
    names = _GAIN_NAMES[autopilot]
    out = []
    for axis, usual in zip(_AXIS_NAMES[autopilot], _USUAL_GAINS[autopilot], strict=True):
        K = reader.get(f"MC_{axis}RATE_K", 1.0) if autopilot == "px4" else 1.0
        known = {
            field: reader.get(name.format(axis), value) * (K if field in "PID" else 1.0)
            for (field, name), value in zip(names.items(), usual, strict=True)
        }
        out.append(AxisGains(**known))
    return out[0], out[1], out[2]


def _px4(reader: _ParameterReader, rotors: tuple[Rotor, ...]) -> RateLoop:
    cutoff = reader.get("IMU_DGYRO_CUTOFF", 30.0)
    return RateLoop(
        "px4",
        _rate(reader, "IMU_GYRO_RATEMAX", 400.0),
        reader.get("IMU_GYRO_CUTOFF", 40.0),
        (cutoff, cutoff, cutoff),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, reader.get("MC_YAW_TQ_CUTOFF", 2.0)),
        reader.get("THR_MDL_FAC", 0.0, 1.0),
        px4_mixer(*_px4_rotors(reader.parameters, rotors)),
        _gains(reader, "px4"),
    )


def _ardupilot(reader: _ParameterReader, rotors: tuple[Rotor, ...]) -> RateLoop:
    filters = []
    for name in _AXIS_NAMES["ardupilot"]:
        cutoffs = (20.0, 2.5 if name == "YAW" else 0.0, 20.0)
        filters.append(
            [reader.get(f"ATC_RAT_{name}_FLT{x}", f) for x, f in zip("TED", cutoffs, strict=True)]
        )
    target, error, derivative = (tuple(f) for f in zip(*filters, strict=True))
    return RateLoop(
        "ardupilot",
        _rate(reader, "SCHED_LOOP_RATE", 400.0),
        reader.get("INS_GYRO_FILTER", 20.0),
        derivative,  # type: ignore[arg-type]
        error,  # type: ignore[arg-type]
        target,  # type: ignore[arg-type]
        (0.0, 0.0, 0.0),
        reader.get("MOT_THST_EXPO", 0.65, 1.0),
        ardupilot_mixer(rotors),
        _gains(reader, "ardupilot"),
    )


def _rate(reader: _ParameterReader, name: str, usual: float) -> float:
    rate = reader.get(name, usual)
    if rate < 50.0:
        raise InputError(f"{name} = {rate:g}: a rate loop runs at 50 Hz or more")
    return rate


def _px4_rotors(parameters: Mapping[str, float], rotors: tuple[Rotor, ...]) -> tuple[Array, Array]:
    """(n, 2) positions and (n,) moment ratios that PX4 was given, the airframe's where not."""
    places, ratios = [], []
    for i in range(len(rotors)):
        x = parameters.get(f"CA_ROTOR{i}_PX")
        y = parameters.get(f"CA_ROTOR{i}_PY")
        ratio = parameters.get(f"CA_ROTOR{i}_KM")
        if x is None or y is None or not ratio:
            places = [[r.x, r.y] for r in rotors]
            ratios = [0.05 * r.spin for r in rotors]
            break
        places.append([x, y])
        ratios.append(ratio)
    return np.array(places), np.array(ratios)


def px4_mixer(places: Array, ratios: Array) -> Array:
    """(n, 3) PX4's normalized mixer (`ControlAllocationPseudoInverse`).

    Args:
        places: (n, 2) CA_ROTORn_PX, PY.
        ratios: (n,) CA_ROTORn_KM, positive for counter-clockwise.
    """
    x, y = places.T
    effect = np.stack([-y, x, ratios, -np.ones_like(x)])
    mixer = np.linalg.pinv(effect)[:, :3]
    # Roll and pitch share a scale, so that neither loses what the other has.
    acting = np.maximum((np.abs(mixer[:, :2]) > _NEGLIGIBLE).sum(axis=0), 1)
    scale = np.sqrt((mixer[:, :2] ** 2).sum(axis=0) / (acting / 2.0)).max()
    mixer = mixer / [scale, scale, max(mixer[:, 2].max(), 1e-9)]
    out: Array = np.where(np.abs(mixer) < _NEGLIGIBLE, 0.0, mixer)
    return out


def ardupilot_mixer(rotors: tuple[Rotor, ...]) -> Array:
    """(n, 3) ArduPilot's factors (`AP_MotorsMatrix::normalize_rpy_factors`): 0.5 at most."""
    factors = np.array([[-r.y, r.x, float(r.spin)] for r in rotors])
    mixer: Array = 0.5 * factors / np.maximum(np.abs(factors).max(axis=0), 1e-9)
    return mixer
