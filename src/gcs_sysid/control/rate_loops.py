"""The rate and attitude loops of PX4, ArduPilot, Betaflight and INAV, as their parameters set them.

PX4 (`lib/rate_control`, `sensors/vehicle_angular_velocity`, `control_allocator`), with K, P, I, D
of MC_*RATE_*, angular acceleration from the filtered gyro behind IMU_DGYRO_CUTOFF, and the rate
set-point of the attitude loop, MC_*_P times the attitude error:

    torque = K (P e + I sum(e) dt - D w'_f) + FF w_sp,   e = w_sp - w_f

ArduPilot (`AC_PID`, `AC_AttitudeControl_Multi`, `AP_MotorsMatrix`), with first-order filters FLTT
on the set-point, FLTE on the error and FLTD on the derivative of the filtered error:

    torque = P e_f + I sum(e_f) dt + D (e_f)' + FF w_sp,   e = FLTT(w_sp) - w_f

Betaflight (`pid.c`, `mixer.c`; 4.3 and later), with its low-passes and notches, of the derivative
D on the filtered gyro; I of yaw counts two and a half times, and feed-forward is of set-points
alone:

    torque = P e + I sum(e) dt - D w'_f,   e = w_sp - w_f

INAV (`pid.c`: pidApplyMulticopterRateController, `mixer.c`; 4 to 9) has Betaflight's law in units
of its own, with a low-pass each of gyro, derivative and yaw's P; its control derivative is of
set-points alone.

Betaflight's ADRC (pull request 15400, July 2026, in no release) takes w'' = f + b0 u for the motion
behind a motor's lag. An observer of poles at wo has z of w, w' and f, from the gyro and u:

    torque = (wc^2 (w_sp - z_1) - 2 wc z_2 - z_3) / b0

That its f decays, and its b0 rises beyond hover, is left out.

The first two act on the gyro behind a second-order Butterworth low-pass (IMU_GYRO_CUTOFF,
INS_GYRO_FILTER), and all of them behind notches at the rotors' frequency.
Torques are normalized; a rotor's thrust command is the sum of its column of the mixer times them,
and goes through the inverse of the thrust curve THR_MDL_FAC or MOT_THST_EXPO.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.control.signal_filters import SignalFilter, chain_response
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Rotor

Autopilot = Literal["px4", "ardupilot", "betaflight", "inav", "betaflight-adrc"]
AUTOPILOTS: tuple[Autopilot, ...] = ("px4", "ardupilot", "betaflight", "inav", "betaflight-adrc")
_AXIS_NAMES: dict[Autopilot, tuple[str, str, str]] = {
    "px4": ("ROLL", "PITCH", "YAW"), "ardupilot": ("RLL", "PIT", "YAW"),
    "betaflight": ("roll", "pitch", "yaw"), "inav": ("roll", "pitch", "yaw"),
    "betaflight-adrc": ("roll", "pitch", "yaw"),
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
    "betaflight": {"P": "p_{}", "I": "i_{}", "D": "d_{}"},
    "inav": {"P": "mc_p_{}", "I": "mc_i_{}", "D": "mc_d_{}"},
    "betaflight-adrc": {"wc": "adrc_wc_{}", "wo": "adrc_wo_{}", "b0": "adrc_b0_{}"},
}  # fmt: skip
"""Fields of `AxisGains` -> the parameter of an axis."""
_USUAL_GAINS: dict[Autopilot, tuple[tuple[float, ...], ...]] = {
    "px4": ((0.15, 0.2, 0.003, 0.0, 6.5), (0.15, 0.2, 0.003, 0.0, 6.5), (0.2, 0.1, 0.0, 0.0, 2.8)),
    "ardupilot": (
        (0.135, 0.135, 0.0036, 0.0, 4.5), (0.135, 0.135, 0.0036, 0.0, 4.5),
        (0.18, 0.018, 0.0, 0.0, 4.5),
    ),
    "betaflight": ((45.0, 80.0, 30.0), (47.0, 84.0, 34.0), (45.0, 80.0, 0.0)),
    "inav": ((40.0, 30.0, 23.0), (40.0, 30.0, 23.0), (85.0, 45.0, 0.0)),
    "betaflight-adrc": ((60.0, 100.0, 2e3), (60.0, 100.0, 2e3), (60.0, 80.0, 2e3)),
}  # fmt: skip
"""Defaults of the same, in the same order, on each axis."""
_PID_SUM_UNITS = {
    "betaflight": {"P": 0.032029, "I": 0.244381, "D": 0.000529, "I of yaw": 2.5 * 0.244381},
    "inav": {"P": 1.0 / 31.0, "I": 1.0 / 4.0, "D": 1.0 / 1905.0, "I of yaw": 1.0 / 4.0},
}
"""PTERM_SCALE, ..., FP_PID_RATE_P_MULTIPLIER, ...; of errors in deg/s. 1000 is full torque."""
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
        wc: rad/s, of ADRC, which has no P, I and D.
        wo: rad/s, of its observer.
        b0: rad/s^3 per normalized torque.
    """

    P: float
    I: float  # noqa: E741
    D: float
    attitude: float = 0.0
    FF: float = 0.0
    wc: float = 0.0
    wo: float = 0.0
    b0: float = 0.0

    @property
    def at_once(self) -> float:
        """Normalized torque per rad/s of a set-point that steps, of ADRC too."""
        return self.wc**2 / self.b0 if self.b0 else self.P


@dataclass(frozen=True)
class RateLoop:
    """The loops of one autopilot with the settings of one vehicle.

    Attributes:
        autopilot: whose law it is.
        rate: Hz, of the rate loop.
        mixer: (n, 3) thrust command of each rotor per normalized torque.
        gains: of roll, pitch and yaw.
        gyro_cutoff: Hz, second-order low-pass of the gyro; 0: none.
        derivative_cutoff: Hz on each axis, first-order low-pass of the derivative; 0: none.
        error_cutoff: Hz on each axis, of the error (ArduPilot), or of what P acts on
            (Betaflight, INAV); 0: none.
        target_cutoff: Hz on each axis, of the rate set-point (ArduPilot); 0: none.
        torque_cutoff: Hz on each axis, of the torque (PX4, yaw); 0: none.
        averaged: s over which the log's gyro is a mean, and so late by half (PX4's, VehicleIMU), as
            far as that is known.
        curve: c of T/T_max = (1 - c) u + c u^2 that the autopilot inverts.
        gyro_filters: of the gyro, besides.
        derivative_filters: of the derivative, besides.
        besides: what else has to be set so that the gains are these, by name.
        assumed: parameters that were not given, and stand at the autopilot's defaults.
        notes: what else was assumed.
    """

    autopilot: Autopilot
    rate: float
    mixer: Array
    gains: tuple[AxisGains, AxisGains, AxisGains]
    gyro_cutoff: float = 0.0
    derivative_cutoff: tuple[float, float, float] = (0.0, 0.0, 0.0)
    error_cutoff: tuple[float, float, float] = (0.0, 0.0, 0.0)
    target_cutoff: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_cutoff: tuple[float, float, float] = (0.0, 0.0, 0.0)
    averaged: float = 0.0
    curve: float = 0.0
    gyro_filters: tuple[SignalFilter, ...] = ()
    derivative_filters: tuple[SignalFilter, ...] = ()
    besides: tuple[tuple[str, float], ...] = ()
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

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
                unit = _unit(self.autopilot, field, axis)
                value = getattr(gains, field) / unit
                out[name.format(axis)] = value if self.holds_attitude else round(value)
        return out | dict(self.besides)

    @property
    def holds_attitude(self) -> bool:
        """Whether an attitude loop is judged and tuned too; Betaflight's and INAV's are left."""
        return "attitude" in _GAIN_NAMES[self.autopilot]

    @property
    def gains_known(self) -> bool:
        """Whether the vehicle has these gains, all or some of them."""
        return not set(self.as_parameters()) <= set(self.assumed)

    def derivative_lag(self, axis: int) -> float:
        """S by which an axis' derivative lags, for slow signals."""
        low_pass = self.derivative_cutoff[axis]
        own = 1.0 / (2.0 * np.pi * low_pass) if low_pass > 0.0 else 0.0
        step = 1e-3
        late = np.angle(chain_response(self.derivative_filters, np.array(1j * step)))
        return float(own - late / step)

    def gyro_response(self, omega: Array) -> Array:
        """(w,) response of the gyro's filters at (w,) rad/s."""
        s = 1j * omega
        own = (SignalFilter("butterworth", self.gyro_cutoff),) if self.gyro_cutoff > 0.0 else ()
        return chain_response((*own, *self.gyro_filters), s)

    @property
    def logs_raw_gyro(self) -> bool:
        """Whether the log's gyro has passed none of the loop's filters, as PX4's; else all."""
        return self.autopilot == "px4"

    def logged_gyro(self, omega: Array) -> Array:
        """(w,) response of the filters that the log's gyro has passed, at (w,) rad/s."""
        return np.ones_like(omega) if self.logs_raw_gyro else self.gyro_response(omega)

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
        gyro = np.ones_like(s) * self.gyro_response(omega)[:, None]
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
        elif self.autopilot in _PID_SUM_UNITS:
            PI = P * self._first_order(self.error_cutoff, z_inverse)
            PI = PI + Ki * self.period / (1.0 - z_inverse)
            slope = (1.0 - z_inverse) / self.period
            rate = gyro * (PI + D * slope * chain_response(self.derivative_filters, s))
            reference = PI
        elif self.autopilot == "betaflight-adrc":
            wc, wo, b0 = (np.array([getattr(g, name) for g in self.gains]) for name in _ADRC)
            # Steps of the observer, which takes the gyro of now and the torque of before.
            step = (1.0 / z_inverse - 1.0) / self.period
            observer = (step + wo) ** 3
            by_rate = (wc**2 * (3.0 * step * (step + wo) + wo**2) + wo**2 * step**2) * wo
            by_rate = by_rate + 2.0 * wc * wo**2 * step * (3.0 * step + wo)
            by_torque = wc * step * (wc + 2.0 * step + 6.0 * wo) - wo**3
            size = b0 * (observer + by_torque)
            rate = gyro * by_rate / z_inverse / size
            reference = wc**2 * observer / size
        else:
            error = self._first_order(self.error_cutoff, z_inverse)
            derivative = self._first_order(self.derivative_cutoff, z_inverse)
            slope = (1.0 - z_inverse) / self.period
            PID = error * (P + Ki * self.period / (1.0 - z_inverse) + D * slope * derivative)
            rate = gyro * PID
            reference = (PID + FF) * self._first_order(self.target_cutoff, z_inverse)
        return torque * rate, torque * reference * attitude, torque * reference

    def feedback(self, omega: Array, *, attitude: bool = True) -> Array:
        """(w, 3) response to the body rates at (w,) rad/s, with or without the attitude loop."""
        rate, angle, _ = self.controllers(omega)
        return rate + angle / (1j * omega[:, None]) if attitude else rate

    def _first_order(self, cutoffs: tuple[float, float, float], z_inverse: Array) -> Array:
        """(w, 3) of y += a (x - y), a = dt / (dt + 1 / (2 pi f)), on each axis; 1 where f is 0."""
        f = np.array(cutoffs)
        a = np.where(f > 0.0, self.period / (self.period + 1.0 / (2.0 * np.pi * f.clip(1e-9))), 1.0)
        return a / (1.0 - (1.0 - a) * z_inverse)


@dataclass(frozen=True)
class HoverPoint:
    """The hover that filters are set by.

    Attributes:
        throttle: mean command of the rotors; None: not known.
        rotor_frequency: Hz, of the mean rotor; None: not known.
    """

    throttle: float | None = None
    rotor_frequency: float | None = None


def read_loop(
    autopilot: Autopilot,
    parameters: Mapping[str, float],
    rotors: tuple[Rotor, ...],
    hover: HoverPoint = HoverPoint(),
) -> RateLoop:
    """The loops by an autopilot's parameters; what is not there stands at its default.

    Args:
        autopilot: whose.
        parameters: name -> value; of Betaflight and INAV by the lines of a blackbox header.
        rotors: of the airframe, in the autopilot's motor order.
        hover: that filters which follow throttle or rotors stand at.

    Raises:
        InputError: a parameter makes no sense.
    """
    if "attitude" not in _GAIN_NAMES[autopilot]:
        parameters = _by_cli_name(autopilot, parameters)
    reader = _ParameterReader(parameters, hover)
    loop = _READERS[autopilot](reader, rotors)
    return replace(loop, assumed=tuple(reader.assumed), notes=tuple(reader.notes))


class _ParameterReader:
    """Parameters with defaults, which remembers what was not there."""

    def __init__(self, parameters: Mapping[str, float], hover: HoverPoint) -> None:
        self.parameters, self.hover = parameters, hover
        self.assumed: list[str] = []
        self.notes: list[str] = []

    def optional(self, name: str, usual: float = 0.0) -> float:
        """The same of what most vehicles do not have."""
        return self.get(name, usual) if name in self.parameters else usual

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
        known = dict.fromkeys("PID", 0.0) | {
            field: reader.get(name.format(axis), value)
            * (K if field in "PID" else 1.0)
            * _unit(autopilot, field, axis)
            for (field, name), value in zip(names.items(), usual, strict=True)
        }
        out.append(AxisGains(**known))
    return out[0], out[1], out[2]


def _unit(autopilot: Autopilot, field: str, axis: str) -> float:
    """A gain whose parameter is one."""
    if field == "b0":
        return math.radians(1000.0)
    if autopilot not in _PID_SUM_UNITS:
        return 1.0
    name = "I of yaw" if (field, axis) == ("I", "yaw") else field
    return _PID_SUM_UNITS[autopilot][name] * math.degrees(1.0) / 1000.0


def _px4(reader: _ParameterReader, rotors: tuple[Rotor, ...]) -> RateLoop:
    cutoff = reader.get("IMU_DGYRO_CUTOFF", 30.0)
    integrated = reader.parameters.get("IMU_INTEG_RATE", 0.0)
    return RateLoop(
        "px4",
        _rate(reader, "IMU_GYRO_RATEMAX", 400.0),
        px4_mixer(*_px4_rotors(reader.parameters, rotors)),
        _gains(reader, "px4"),
        reader.get("IMU_GYRO_CUTOFF", 40.0),
        (cutoff, cutoff, cutoff),
        torque_cutoff=(0.0, 0.0, reader.get("MC_YAW_TQ_CUTOFF", 2.0)),
        averaged=1.0 / integrated if integrated >= 100.0 else 0.0,
        curve=reader.get("THR_MDL_FAC", 0.0, 1.0),
        gyro_filters=(*_px4_notches(reader, len(rotors)),),
    )


def _px4_notches(reader: _ParameterReader, rotors: int) -> Iterator[SignalFilter]:
    """IMU_GYRO_NFn_FRQ and BW, and those at the rotors' harmonics by the ESCs."""
    for i in range(2):
        middle = reader.get(f"IMU_GYRO_NF{i}_FRQ", 0.0)
        if middle > 0.0:
            width = reader.optional(f"IMU_GYRO_NF{i}_BW", 20.0)
            yield SignalFilter("notch", middle, middle / max(width, 1.0))
    dynamic = int(reader.get("IMU_GYRO_DNF_EN", 0.0))
    if dynamic & 2:
        reader.notes.append("notches by FFT (IMU_GYRO_DNF_EN) are where they are: left out")
    if dynamic & 1:
        width = max(reader.optional("IMU_GYRO_DNF_BW", 15.0), 1.0)
        harmonics = int(reader.optional("IMU_GYRO_DNF_HMC", 3.0))
        for middle in _harmonics(reader, 0.0, range(1, harmonics + 1)):
            yield from [SignalFilter("notch", middle, middle / width)] * rotors


def _harmonics(
    reader: _ParameterReader, otherwise: float, numbers: Iterable[int]
) -> Iterator[float]:
    """Hz of the rotors' harmonics in hover.

    `otherwise` is Hz of the first where the rotors' frequency is not known; 0: there is none.
    """
    first = reader.hover.rotor_frequency
    if first is None:
        reader.notes.append(
            "the rotors' frequency is not known: their notches are "
            + (f"taken at {otherwise:g} Hz and its harmonics" if otherwise else "left out")
            + "; a result by rotor speeds (--with) has it"
        )
    middle = first or otherwise
    return (middle * n for n in numbers if middle > 0.0)


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
        ardupilot_mixer(rotors),
        _gains(reader, "ardupilot"),
        reader.get("INS_GYRO_FILTER", 20.0),
        derivative,  # type: ignore[arg-type]
        error,  # type: ignore[arg-type]
        target,  # type: ignore[arg-type]
        curve=reader.get("MOT_THST_EXPO", 0.65, 1.0),
        gyro_filters=(*_ardupilot_notches(reader, len(rotors)),),
    )


_BY_ROTORS = (2, 3)
"""INS_HNTCH_MODE of a notch that follows the rotors' speed."""


def _ardupilot_notches(reader: _ParameterReader, rotors: int) -> Iterator[SignalFilter]:
    """Both harmonic notches, `HarmonicNotchFilter`: one quality for all harmonics."""
    for name in ("INS_HNTCH", "INS_HNTC2"):
        if not reader.get(f"{name}_ENABLE", 0.0):
            continue
        first = reader.optional(f"{name}_FREQ", 80.0)
        width = min(reader.optional(f"{name}_BW", 40.0), first)
        depth = 10.0 ** (-reader.optional(f"{name}_ATT", 40.0) / 20.0)
        ratio = (first / (first - 0.5 * width)) ** 2
        quality = math.sqrt(ratio) / (ratio - 1.0)
        harmonics = int(reader.optional(f"{name}_HMNCS", 3.0))
        numbers = [n + 1 for n in range(16) if harmonics >> n & 1]
        follows = int(reader.optional(f"{name}_MODE", 1.0)) in _BY_ROTORS
        middles = _harmonics(reader, first, numbers) if follows else (first * n for n in numbers)
        of_each = int(reader.optional(f"{name}_OPTS")) & 2
        each = rotors if follows and of_each else 1
        for middle in middles:
            yield from [SignalFilter("notch", middle, quality, depth)] * each


_HEADER_AXES, _ADRC = ("rollPID", "pitchPID", "yawPID"), ("wc", "wo", "b0")


def _by_cli_name(autopilot: Autopilot, parameters: Mapping[str, float]) -> dict[str, float]:
    """Lines of a blackbox header, with gains by the names that the firmware's CLI has.

    Where D rises with quick motion (`d_min` up to 4.5), it is the lower one that holds the hover.
    """
    out = dict(parameters)
    names = _GAIN_NAMES[autopilot]
    for i, (line, axis) in enumerate(zip(_HEADER_AXES, _AXIS_NAMES[autopilot], strict=True)):
        if autopilot == "betaflight-adrc":
            for name in _ADRC:
                if (value := parameters.get(f"adrc{name.upper()}[{i}]")) is not None:
                    out.setdefault(names[name].format(axis), value)
            continue
        for place, gain in enumerate("PID"):
            value = parameters.get(f"{line}[{place}]")
            if value is not None:
                out.setdefault(names[gain].format(axis), value)
        least = parameters.get(f"d_min_{axis}", parameters.get(f"d_min[{i}]", 0.0))
        D = names["D"].format(axis)
        if 0.0 < least < out.get(D, 0.0):
            out[D] = least
    return out


_KINDS: tuple[Literal["first", "butterworth", "second", "third"], ...] = (
    "first", "butterworth", "second", "third",
)  # fmt: skip
"""By the number of a low-pass' type."""


def _betaflight(reader: _ParameterReader, rotors: tuple[Rotor, ...]) -> RateLoop:
    loop_time = reader.get("looptime", 125.0) * reader.get("pid_process_denom", 1.0)
    gyro = [*_low_passes(reader, "gyro", (250.0, 500.0, 500.0)), *_static_notches(reader, "gyro")]
    gyro += _betaflight_notches(reader, len(rotors))
    derivative = [*_low_passes(reader, "dterm", (75.0, 150.0, 150.0))]
    derivative += _static_notches(reader, "dterm")
    rising = [
        (f"{name}_{axis}", 0.0)
        for name in ("d_min", "d_max")
        for i, axis in enumerate(_AXIS_NAMES["betaflight"])
        if reader.optional(f"{name}[{i}]") > 0.0
    ]
    if rising:
        reader.notes.append(
            "D rises with quick motion: margins are those of the lower D, and a proposal holds it"
        )
    throttle, least = reader.hover.throttle, reader.optional("tpa_breakpoint", 2000.0) / 1e3 - 1.0
    if throttle is not None and throttle > least:
        reader.notes.append("TPA acts in hover already (tpa_breakpoint): margins leave it out")
    for name, what in (("thrust_linear", "the thrust curve"), ("use_integrated_yaw", "yaw")):
        if reader.optional(name):
            reader.notes.append(f"{name} is not modeled: {what} is another one")
    return RateLoop(
        "betaflight",
        1e6 / max(loop_time, 1.0),
        2.0 * ardupilot_mixer(rotors),
        _gains(reader, "betaflight"),
        error_cutoff=(0.0, 0.0, reader.get("yaw_lowpass_hz", 100.0)),
        gyro_filters=tuple(gyro),
        derivative_filters=tuple(derivative),
        besides=tuple(rising),
    )


def _inav(reader: _ParameterReader, rotors: tuple[Rotor, ...]) -> RateLoop:
    """By names of its header, which does not say whether dynamic notches act: it is assumed."""
    cutoffs = (reader.get("gyro_lpf_hz", 60.0), reader.get("gyro_anti_aliasing_lpf_hz", 250.0))
    gyro = [SignalFilter("first", cutoff) for cutoff in cutoffs if cutoff > 0.0]
    if reader.get("rpm_gyro_filter_enabled", 0.0):
        least = reader.optional("rpm_gyro_min_hz", 100.0)
        quality = max(reader.optional("rpm_gyro_q", 500.0), 1.0) / 100.0
        numbers = range(1, int(reader.optional("rpm_gyro_harmonics", 1.0)) + 1)
        for middle in _harmonics(reader, least, numbers):
            gyro += [SignalFilter("notch", max(middle, least), quality)] * len(rotors)
    least = reader.get("dynamicGyroNotchMinHz", 0.0)
    if least:
        reader.notes.append(f"dynamic notches are taken at their lowest, {least:g} Hz")
        quality = max(reader.optional("dynamicGyroNotchQ", 250.0), 1.0) / 100.0
        gyro += [SignalFilter("notch", least, quality)] * 3
    kind = _KINDS[min(int(reader.optional("dterm_lpf_type", 2.0)), len(_KINDS) - 1)]
    cutoff = reader.get("dterm_lpf_hz", 110.0)
    return RateLoop(
        "inav",
        1e6 / max(reader.get("looptime", 500.0), 1.0),
        2.0 * ardupilot_mixer(rotors),
        _gains(reader, "inav"),
        error_cutoff=(0.0, 0.0, reader.get("yaw_lpf_hz", 0.0)),
        gyro_filters=tuple(gyro),
        derivative_filters=(SignalFilter(kind, cutoff),) if cutoff > 0.0 else (),
    )


def _betaflight_adrc(reader: _ParameterReader, rotors: tuple[Rotor, ...]) -> RateLoop:
    """Betaflight's loop and gyro filters with one more; b0 is that of the hover."""
    usual = _betaflight(_ParameterReader(reader.parameters, reader.hover), rotors)
    cutoff, throttle = reader.get("adrc_gyro_lpf_hz", 150.0), reader.hover.throttle
    own = (SignalFilter("first", cutoff),) if cutoff > 0.0 else ()
    return replace(
        usual,
        autopilot="betaflight-adrc",
        error_cutoff=(0.0, 0.0, 0.0),
        gains=_gains(reader, "betaflight-adrc"),
        gyro_filters=(*usual.gyro_filters, *own),
        derivative_filters=(),
        besides=() if throttle is None else (("adrc_hover_throttle", round(100.0 * throttle)),),
    )


_READERS: dict[Autopilot, Callable[[_ParameterReader, tuple[Rotor, ...]], RateLoop]] = {
    "px4": _px4, "ardupilot": _ardupilot, "betaflight": _betaflight, "inav": _inav,
    "betaflight-adrc": _betaflight_adrc,
}  # fmt: skip


def _low_passes(
    reader: _ParameterReader, signal: str, usual: tuple[float, float, float]
) -> Iterator[SignalFilter]:
    """The first low-pass, which may follow the throttle, and the second.

    Of "gyro" or "dterm"; `usual` is Hz, lower and upper of the first, and of the second.
    """
    first, second = f"{signal}_lpf1", f"{signal}_lpf2"
    dynamic = f"{first}_dyn_hz[0]" in reader.parameters or f"{first}_static_hz" not in (
        reader.parameters
    )
    low = reader.get(f"{first}_dyn_hz[0]", usual[0]) if dynamic else 0.0
    cutoff = low
    if low > 0.0:
        high = reader.get(f"{first}_dyn_hz[1]", usual[1])
        u, expo = reader.hover.throttle or 0.0, reader.optional(f"{first}_dyn_expo", 5.0) / 10.0
        cutoff = low + (high - low) * (u * (1.0 - u) * expo + u)
    else:
        cutoff = reader.get(f"{first}_static_hz", usual[0])
    for name, hertz in ((first, cutoff), (second, reader.get(f"{second}_static_hz", usual[2]))):
        kind = int(reader.optional(f"{name}_type"))
        if hertz > 0.0:
            yield SignalFilter(_KINDS[min(kind, len(_KINDS) - 1)], hertz)


def _static_notches(reader: _ParameterReader, signal: str) -> Iterator[SignalFilter]:
    """Of middle and lower cutoff: the quality is f f_c / (f^2 - f_c^2)."""
    for place in ("", "[0]", "[1]"):
        middle = reader.optional(f"{signal}_notch_hz{place}")
        cutoff = reader.optional(f"{signal}_notch_cutoff{place}")
        if 0.0 < cutoff < middle:
            yield SignalFilter("notch", middle, middle * cutoff / (middle**2 - cutoff**2))


def _betaflight_notches(reader: _ParameterReader, rotors: int) -> Iterator[SignalFilter]:
    """Those at each rotor's harmonics, and those that look for peaks themselves."""
    harmonics = int(reader.get("rpm_filter_harmonics", 0.0))
    if harmonics and reader.optional("dshot_bidir"):
        least = reader.optional("rpm_filter_min_hz", 100.0)
        fading = max(reader.optional("rpm_filter_fade_range_hz", 50.0), 1.0)
        quality = max(reader.optional("rpm_filter_q", 500.0), 1.0) / 100.0
        for n, middle in enumerate(_harmonics(reader, least + fading, range(1, harmonics + 1))):
            weight = reader.optional(f"rpm_filter_weights[{n}]", 100.0) / 100.0
            weight *= min(max((middle - least) / fading, 0.0), 1.0)
            one = SignalFilter("notch", max(middle, least), quality, 1.0 - weight)
            yield from [one] * rotors
    count = int(reader.get("dyn_notch_count", 0.0))
    if count:
        least = reader.optional("dyn_notch_min_hz", 100.0)
        reader.notes.append(f"dynamic notches are taken at their lowest, {least:g} Hz")
        quality = max(reader.optional("dyn_notch_q", 300.0), 1.0) / 100.0
        yield from [SignalFilter("notch", max(least, 1.0), quality)] * count


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
    return np.where(np.abs(mixer) < _NEGLIGIBLE, 0.0, mixer)


def ardupilot_mixer(rotors: tuple[Rotor, ...]) -> Array:
    """(n, 3) ArduPilot's factors (`AP_MotorsMatrix::normalize_rpy_factors`): 0.5 at most."""
    factors = np.array([[-r.y, r.x, float(r.spin)] for r in rotors])
    return 0.5 * factors / np.maximum(np.abs(factors).max(axis=0), 1e-9)
