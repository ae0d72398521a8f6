"""The rate controllers of PX4, ArduPilot, Betaflight (with ADRC) and INAV, by their sources.

They replace the torque loop of `controller.Controller`; position and attitude set-points stay
those of the mission. A loop runs at the controller's period, the gyro's filters at every step of
the physics. What an autopilot does where rotors saturate is left out but for its end: a command
stays within 0 to 1, and the integrators stop growing.

PX4: `RateControl::update`, `VehicleAngularVelocity`, `ControlAllocationPseudoInverse`, THR_MDL_FAC.
ArduPilot: `AC_PID::update_all`, `AC_AttitudeControl_Multi`, `AP_MotorsMatrix`, MOT_THST_EXPO.
Betaflight: `pidController`, `gyroFiltering`, `rpm_filter`, `mixTable`; set-points come from the
attitude, as its angle mode has them. INAV (`pid.c`, `filter.c`): the same with other units and
filters.
The first two filter the gyro by a second-order Butterworth low-pass, bilinear with prewarping
(`LowPassFilter2p`), and other signals by y += dt / (dt + 1 / (2 pi f)) (x - y).
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from gcs_sysid.errors import InputError
from gcs_sysid.model.parameter_file import read_parameter_file
from sim_bridge.controller import Controller, Gains, clip, multiply, sign
from sim_bridge.dynamics import State
from sim_bridge.missions import Reference
from sim_bridge.simulated_vehicle import Value, Vehicle, hover_thrusts

PX4_DEFAULTS: dict[str, float] = {
    "IMU_GYRO_CUTOFF": 40.0, "IMU_DGYRO_CUTOFF": 30.0, "MC_YAW_TQ_CUTOFF": 2.0, "THR_MDL_FAC": 0.0,
    **{f"MC_{a}RATE_{x}": v for a, row in
       {"ROLL": (1.0, 0.15, 0.2, 0.003, 0.0), "PITCH": (1.0, 0.15, 0.2, 0.003, 0.0),
        "YAW": (1.0, 0.2, 0.1, 0.0, 0.0)}.items()
       for x, v in zip(("K", "P", "I", "D", "FF"), row, strict=True)},
    "MC_ROLL_P": 6.5, "MC_PITCH_P": 6.5, "MC_YAW_P": 2.8,
    "MC_RR_INT_LIM": 0.3, "MC_PR_INT_LIM": 0.3, "MC_YR_INT_LIM": 0.3,
}  # fmt: skip
ARDUPILOT_DEFAULTS: dict[str, float] = {
    "INS_GYRO_FILTER": 20.0, "MOT_THST_EXPO": 0.65,
    **{f"ATC_RAT_{a}_{x}": v for a, row in
       {"RLL": (0.135, 0.135, 0.0036, 0.0, 20.0, 0.0, 20.0, 0.5),
        "PIT": (0.135, 0.135, 0.0036, 0.0, 20.0, 0.0, 20.0, 0.5),
        "YAW": (0.18, 0.018, 0.0, 0.0, 20.0, 2.5, 20.0, 0.5)}.items()
       for x, v in zip(("P", "I", "D", "FF", "FLTT", "FLTE", "FLTD", "IMAX"), row, strict=True)},
    "ATC_ANG_RLL_P": 4.5, "ATC_ANG_PIT_P": 4.5, "ATC_ANG_YAW_P": 4.5,
}  # fmt: skip
BETAFLIGHT_DEFAULTS: dict[str, float] = {
    **{f"{x}_{a}": v for a, row in
       {"roll": (45.0, 80.0, 30.0), "pitch": (47.0, 84.0, 34.0), "yaw": (45.0, 80.0, 0.0)}.items()
       for x, v in zip("pid", row, strict=True)},
    "gyro_lpf1_static_hz": 250.0, "gyro_lpf2_static_hz": 500.0, "dterm_lpf1_static_hz": 75.0,
    "dterm_lpf2_static_hz": 150.0, "yaw_lowpass_hz": 100.0, "p_level": 50.0,
    "dshot_bidir": 0.0, "rpm_filter_harmonics": 3.0, "rpm_filter_q": 500.0,
    "rpm_filter_min_hz": 100.0, "thrust_curve": 0.0,
}  # fmt: skip
DEFAULTS = {
    "px4": PX4_DEFAULTS, "ardupilot": ARDUPILOT_DEFAULTS, "betaflight": BETAFLIGHT_DEFAULTS,
    "inav": {
        **{f"mc_{x}_{a}": v for a in ("roll", "pitch")
           for x, v in zip("pid", (40.0, 30.0, 23.0), strict=True)},
        "mc_p_yaw": 85.0, "mc_i_yaw": 45.0, "mc_d_yaw": 0.0,
        "gyro_lpf_hz": 60.0, "gyro_anti_aliasing_lpf_hz": 250.0, "dterm_lpf_hz": 110.0,
        "yaw_lpf_hz": 0.0, "mc_p_level": 20.0, "rpm_gyro_filter_enabled": 0.0,
        "rpm_gyro_harmonics": 1.0, "rpm_gyro_q": 500.0, "rpm_gyro_min_hz": 100.0,
        "thrust_curve": 0.0,
    },
    "betaflight-adrc": BETAFLIGHT_DEFAULTS | {
        "adrc_gyro_lpf_hz": 150.0,
        **{f"adrc_{x}_{a}": v for a, row in
           {"roll": (60.0, 100.0, 2e3), "pitch": (60.0, 100.0, 2e3),
            "yaw": (60.0, 80.0, 2e3)}.items()
           for x, v in zip(("wc", "wo", "b0"), row, strict=True)},
    },
    "indiflight": {"attitude": 5.0, "thrust_curve": 0.0},
}  # fmt: skip
"""Of each autopilot; an ensemble may have arrays of shape (N,) in their place."""

LOOP_RATE = 400.0
"""Hz: IMU_GYRO_RATEMAX and SCHED_LOOP_RATE as shipped."""
_SLOW_RATE = math.radians(400.0)
"""rad/s, rate error at which PX4's integrator stops."""
_LEAST = 0.01
"""Of a rotor's command: it keeps turning."""
Injection = Callable[[float], tuple[Value, Value, Value]]


class LowPass2:
    """Second-order Butterworth low-pass of three signals at a fixed rate; `LowPassFilter2p`."""

    def __init__(self, cutoff: float, step: float) -> None:
        self._on = cutoff > 0.0
        k = math.tan(math.pi * cutoff * step)
        c = 1.0 + 2.0 * math.cos(math.pi / 4.0) * k + k * k
        self._b = k * k / c, 2.0 * k * k / c, k * k / c
        self._a = 2.0 * (k * k - 1.0) / c, (1.0 - 2.0 * math.cos(math.pi / 4.0) * k + k * k) / c
        self._delayed: list[tuple[Value, Value]] = [(0.0, 0.0)] * 3

    def __call__(self, signals: list[Value]) -> list[Value]:
        """The three signals behind it."""
        if not self._on:
            return signals
        b0, b1, b2 = self._b
        a1, a2 = self._a
        out = []
        for i, x in enumerate(signals):
            d1, d2 = self._delayed[i]
            d0 = x - a1 * d1 - a2 * d2
            out.append(b0 * d0 + b1 * d1 + b2 * d2)
            self._delayed[i] = d0, d1
        return out


class Notch:
    """Notch of three signals at a fixed rate; `biquadFilterInit` with FILTER_NOTCH."""

    def __init__(self, middle: float, quality: float, step: float) -> None:
        omega = 2.0 * math.pi * middle * step
        alpha = math.sin(omega) / (2.0 * quality)
        self._turn = -2.0 * math.cos(omega) / (1.0 + alpha)
        self._gain, self._decay = 1.0 / (1.0 + alpha), (1.0 - alpha) / (1.0 + alpha)
        self._state: list[tuple[Value, Value]] = [(0.0, 0.0)] * 3

    def __call__(self, signals: list[Value]) -> list[Value]:
        """The three signals behind it."""
        out = []
        for i, x in enumerate(signals):
            s1, s2 = self._state[i]
            y = self._gain * x + s1
            self._state[i] = self._turn * (x - y) + s2, self._gain * x - self._decay * y
            out.append(y)
        return out


def _share(cutoff: Value, step: float) -> Value:
    """Of the new sample in a first-order low-pass; 1 where it is off."""
    with np.errstate(divide="ignore"):
        lag = 1.0 / (2.0 * np.pi * np.maximum(cutoff, 1e-12))
    return np.where(np.asarray(cutoff) > 0.0, step / (step + lag), 1.0)


class RateController(Controller, ABC):
    """What both autopilots share: attitude loop, mixer, thrust curve, delay.

    Args:
        vehicle: as the builder knows it: its rotors and thrust at full command.
        period: s, of the rate loop.
        settings: parameters by name; the defaults of the autopilot fill up.
        delay_loops: periods from the gyro's sample to the rotors' command, beyond the loop's hold.
        gains: of the position loops.
        injection: added to the normalized torques at a time in s, to measure the loop.

    Attributes:
        targets: rad/s, rate set-points, last period.
        asked: normalized torques as the loops asked for them, last period.
        sent: the same with what was injected.
    """

    names: tuple[str, str, str]
    curve_name: str
    autopilot: str

    def __init__(
        self,
        vehicle: Vehicle,
        period: float,
        settings: Mapping[str, Value],
        delay_loops: int = 0,
        gains: Gains | None = None,
        injection: Injection | None = None,
    ) -> None:
        super().__init__(vehicle, period, gains)
        self._settings: dict[str, Value] = {**DEFAULTS[self.autopilot], **settings}
        self._injection = injection
        self._time = 0.0
        self._gyro: list[Value] = [0.0, 0.0, 0.0]
        self._filter: LowPass2 | None = None
        self._mixer = self._make_mixer(vehicle)
        self.targets: tuple[Value, ...] = (0.0, 0.0, 0.0)
        self.asked: tuple[Value, ...] = (0.0, 0.0, 0.0)
        self.sent: tuple[Value, ...] = (0.0, 0.0, 0.0)
        shares = [thrust / vehicle.T_max for thrust in hover_thrusts(vehicle)]
        self._integral: list[Value] = self._trim(shares)
        first = [vehicle.speed_of(vehicle.command_of((s * vehicle.T_max / vehicle.k_T) ** 0.5))
                 for s in shares]  # fmt: skip
        self._late: deque[list[Value]] = deque([first] * delay_loops)
        self._begin()

    def _begin(self) -> None:
        """What the loops of one autopilot remember, from the start."""

    def _get(self, name: str) -> Value:
        return self._settings[name]

    @abstractmethod
    def _make_mixer(self, vehicle: Vehicle) -> list[tuple[Value, Value, Value]]:
        """Per rotor, its shares of roll, pitch and yaw."""

    def _trim(self, shares: list[Value]) -> list[Value]:
        """Integrators that hold the hover from the start: what the rotors differ by."""
        columns = np.array([[float(np.mean(x)) for x in row] for row in self._mixer])
        whole = np.column_stack([columns, np.ones(len(columns))])
        hover = np.array(np.broadcast_arrays(*shares))
        solution = np.linalg.pinv(whole) @ hover.reshape(len(columns), -1)
        values = solution[:3].reshape((3, *hover.shape[1:]))
        return [float(v) if v.ndim == 0 else v for v in values]

    def observe(self, state: State, step: float) -> None:
        """Filter the gyro, at every step of the physics."""
        self._time += step
        if self._filter is None:
            cutoff = self._get("IMU_GYRO_CUTOFF" if self.autopilot == "px4" else "INS_GYRO_FILTER")
            self._filter = LowPass2(float(np.mean(cutoff)), step)
        filtered = self._filter(list(state.rates))
        self._differentiate(filtered, step)
        self._gyro = filtered

    def _differentiate(self, filtered: list[Value], step: float) -> None:
        """PX4 has the angular acceleration from here."""

    def update(self, state: State, reference: Reference) -> list[Value]:
        """Rotor-speed targets, rad/s, for the next period."""
        thrust, set_point = self._attitude(state, reference, *self._acceleration(state, reference))
        a, b, c, d = state.quaternion
        e0, *error = multiply((a, -b, -c, -d), set_point)
        turn = 2.0 * sign(e0)
        attitude = (self._get(name) for name in self._attitude_names)
        self.targets = tuple(
            r + P * turn * e for r, P, e in zip(reference.rate, attitude, error, strict=True)
        )
        self.asked = tuple(self._torques(self.targets))
        extra = (0.0, 0.0, 0.0) if self._injection is None else self._injection(self._time)
        self.sent = tuple(u + e for u, e in zip(self.asked, extra, strict=True))
        v = self._model
        collective = thrust / (len(v.rotors) * v.T_max)
        f = self._get(self.curve_name)
        speeds = []
        for row in self._mixer:
            share = clip(
                collective + sum(m * u for m, u in zip(row, self.sent, strict=True)), 0.0, 1.0
            )
            # The inverse of (1 - f) u + f u^2.
            u = 2.0 * share / (1.0 - f + ((1.0 - f) ** 2 + 4.0 * f * share) ** 0.5 + 1e-12)
            speeds.append(v.speed_of(clip(u, _LEAST, 1.0)))
        self._late.append(speeds)
        return self._late.popleft()

    @property
    @abstractmethod
    def _attitude_names(self) -> tuple[str, str, str]:
        """Parameters of the attitude loop, of roll, pitch and yaw."""

    @abstractmethod
    def _torques(self, targets: Sequence[Value]) -> list[Value]:
        """Normalized torques that the rate loops ask for, by the rates wanted in rad/s."""


class Px4RateController(RateController):
    """PX4's: K (P e + integral - D w') + FF w_sp, the integral updated behind the output."""

    autopilot = "px4"
    curve_name = "THR_MDL_FAC"
    names = ("ROLL", "PITCH", "YAW")
    _limits = ("MC_RR_INT_LIM", "MC_PR_INT_LIM", "MC_YR_INT_LIM")
    _slope: tuple[Value, ...] = (0.0, 0.0, 0.0)
    _yaw: Value = None

    @property
    def _attitude_names(self) -> tuple[str, str, str]:
        return "MC_ROLL_P", "MC_PITCH_P", "MC_YAW_P"

    def _make_mixer(self, vehicle: Vehicle) -> list[tuple[Value, Value, Value]]:
        rotors = vehicle.rotors
        # CA_ROTORn_CT is one for all, and falls out by the normalization.
        effect = np.array(
            [[-r.y for r in rotors], [r.x for r in rotors], [0.05 * r.spin for r in rotors],
             [-1.0] * len(rotors)]
        )  # fmt: skip
        mix = np.linalg.pinv(effect)[:, :3]
        scales = []
        for column in mix.T[:2]:
            acting = max(int((np.abs(column) > 1e-3).sum()), 1)
            scales.append(math.sqrt(float(column @ column) / (acting / 2.0)))
        mix = mix / [max(scales), max(scales), mix[:, 2].max()]
        mix[np.abs(mix) < 1e-3] = 0.0
        return [tuple(row) for row in mix.tolist()]

    def _differentiate(self, filtered: list[Value], step: float) -> None:
        share = _share(self._get("IMU_DGYRO_CUTOFF"), step)
        self._slope = tuple(
            y + share * ((new - old) / step - y)
            for y, new, old in zip(self._slope, filtered, self._gyro, strict=True)
        )

    def _torques(self, targets: Sequence[Value]) -> list[Value]:
        out = []
        for i, name in enumerate(self.names):
            K, P, Ki, D, FF = (self._get(f"MC_{name}RATE_{x}") for x in ("K", "P", "I", "D", "FF"))
            error = targets[i] - self._gyro[i]
            torque = K * P * error + self._integral[i] - K * D * self._slope[i] + FF * targets[i]
            factor = np.maximum(1.0 - (error / _SLOW_RATE) ** 2, 0.0)
            limit = self._get(self._limits[i])
            self._integral[i] = clip(
                self._integral[i] + factor * K * Ki * error * self.period, -limit, limit
            )
            out.append(torque)
        # Begins at the trim, as a vehicle that hovers for a while.
        previous = out[2] if self._yaw is None else self._yaw
        self._yaw = previous + _share(self._get("MC_YAW_TQ_CUTOFF"), self.period) * (
            out[2] - previous
        )
        return [out[0], out[1], self._yaw]


class ArduPilotRateController(RateController):
    """ArduPilot's `AC_PID` on each axis."""

    autopilot = "ardupilot"
    curve_name = "MOT_THST_EXPO"
    names = ("RLL", "PIT", "YAW")

    def _begin(self) -> None:
        self._target: list[Value] = [0.0, 0.0, 0.0]
        self._error: list[Value] = [0.0, 0.0, 0.0]
        self._derivative: list[Value] = [0.0, 0.0, 0.0]

    @property
    def _attitude_names(self) -> tuple[str, str, str]:
        return "ATC_ANG_RLL_P", "ATC_ANG_PIT_P", "ATC_ANG_YAW_P"

    def _make_mixer(self, vehicle: Vehicle) -> list[tuple[Value, Value, Value]]:
        factors = np.array([[-r.y, r.x, float(r.spin)] for r in vehicle.rotors])
        scaled = 0.5 * factors / np.abs(factors).max(axis=0)
        return [tuple(row) for row in scaled.tolist()]

    def _torques(self, targets: Sequence[Value]) -> list[Value]:
        out = []
        for i, name in enumerate(self.names):
            P, Ki, D, FF, t, e, d, limit = (
                self._get(f"ATC_RAT_{name}_{x}")
                for x in ("P", "I", "D", "FF", "FLTT", "FLTE", "FLTD", "IMAX")
            )
            step = self.period
            self._target[i] = self._target[i] + _share(t, step) * (targets[i] - self._target[i])
            before = self._error[i]
            error = self._target[i] - self._gyro[i]
            self._error[i] = before + _share(e, step) * (error - before)
            slope = (self._error[i] - before) / step
            self._derivative[i] = self._derivative[i] + _share(d, step) * (
                slope - self._derivative[i]
            )
            self._integral[i] = clip(self._integral[i] + Ki * self._error[i] * step, -limit, limit)
            out.append(
                P * self._error[i]
                + self._integral[i]
                + D * self._derivative[i]
                + FF * self._target[i]
            )
        return out


class BetaflightRateController(RateController):
    """Betaflight's `pidController` without feed-forward, on each axis.

    A PID sum of 1000, of deg/s, is a torque of one. Its attitude loop is angle mode's.
    """

    autopilot = "betaflight"
    curve_name = "thrust_curve"
    names = ("roll", "pitch", "yaw")
    _gain = "{}_{}"
    _units = (0.032029, 0.244381, 0.000529)
    _yaw_integral = 2.5
    _level = ("p_level", 10.0)
    _gyro_low_passes: tuple[str, ...] = ("gyro_lpf1_static_hz", "gyro_lpf2_static_hz")
    _slope_low_passes = (("dterm_lpf1_static_hz", 1.0), ("dterm_lpf2_static_hz", 1.0))
    _yaw_low_pass = "yaw_lowpass_hz"
    _notched = ("dshot_bidir", "rpm_filter_{}")

    def _begin(self) -> None:
        self._low: list[list[Value]] = [[0.0, 0.0, 0.0] for _ in self._gyro_low_passes]
        self._notches: list[Notch] | None = None
        self._slow: list[list[Value]] = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
        self._before: list[Value] = [0.0, 0.0, 0.0]
        self._yaw: Value = 0.0

    def observe(self, state: State, step: float) -> None:
        """Filter the gyro, at every step of the physics."""
        self._time += step
        if self._notches is None:
            self._notches = self._at_harmonics(step)
        signals = list(state.rates)
        for notch in self._notches:
            signals = notch(signals)
        for held, name in zip(self._low, self._gyro_low_passes, strict=True):
            share = _share(self._get(name), step)
            held[:] = [y + share * (x - y) for x, y in zip(signals, held, strict=True)]
            signals = list(held)
        self._gyro = signals

    def _at_harmonics(self, step: float) -> list[Notch]:
        """A notch at each harmonic of each rotor in hover."""
        enabled, of_notch = self._notched
        if not self._get(enabled):
            return []
        harmonics, least, quality = (
            float(self._get(of_notch.format(name))) for name in ("harmonics", "min_hz", "q")
        )
        v = self._model
        out = []
        for thrust in hover_thrusts(v):
            first = float(np.mean((thrust / v.k_T) ** 0.5)) / (2.0 * math.pi)
            for n in range(1, round(harmonics) + 1):
                # At its least frequency a notch has faded out.
                if least < n * first < 0.45 / step:
                    out.append(Notch(n * first, quality / 100.0, step))
        return out

    @property
    def _attitude_names(self) -> tuple[str, str, str]:
        return "angle", "angle", "angle"

    def _get(self, name: str) -> Value:
        level, unit = self._level
        return self._settings[level] / unit if name == "angle" else super()._get(name)

    def _make_mixer(self, vehicle: Vehicle) -> list[tuple[Value, Value, Value]]:
        factors = np.array([[-r.y, r.x, float(r.spin)] for r in vehicle.rotors])
        return [tuple(row) for row in (factors / np.abs(factors).max(axis=0)).tolist()]

    def _torques(self, targets: Sequence[Value]) -> list[Value]:
        step, out = self.period, []
        sum_of_one = math.degrees(1.0) / 1000.0
        for i, name in enumerate(self.names):
            P, Ki, D = (
                self._get(self._gain.format(x, name)) * sum_of_one * unit
                for x, unit in zip("pid", self._units, strict=True)
            )
            error = targets[i] - self._gyro[i]
            slope = -(self._gyro[i] - self._before[i]) / step
            for held, (low_pass, times) in zip(self._slow, self._slope_low_passes, strict=True):
                share = _share(self._get(low_pass) * times, step)
                held[i] = held[i] + share * (slope - held[i])
                slope = held[i]
            self._before[i] = self._gyro[i]
            faster = self._yaw_integral if name == "yaw" else 1.0
            self._integral[i] = clip(self._integral[i] + Ki * faster * error * step, -0.4, 0.4)
            proportional = P * error
            if name == "yaw":
                share = _share(self._get(self._yaw_low_pass), step)
                self._yaw = self._yaw + share * (proportional - self._yaw)
                proportional = self._yaw
            out.append(proportional + self._integral[i] + D * slope)
        return out


class InavRateController(BetaflightRateController):
    """INAV's `pidApplyMulticopterRateController` without control derivative; D behind a PT2."""

    autopilot = "inav"
    _gain = "mc_{}_{}"
    _units = (1.0 / 31.0, 1.0 / 4.0, 1.0 / 1905.0)
    _yaw_integral = 1.0
    _level = ("mc_p_level", 6.56)
    _gyro_low_passes = ("gyro_lpf_hz", "gyro_anti_aliasing_lpf_hz")
    _slope_low_passes = (("dterm_lpf_hz", 1.553773974), ("dterm_lpf_hz", 1.553773974))
    _yaw_low_pass = "yaw_lpf_hz"
    _notched = ("rpm_gyro_filter_enabled", "rpm_gyro_{}")


class AdrcRateController(BetaflightRateController):
    """Betaflight's experimental ADRC (pull request 15400), at a b0 that does not change.

    Its observer has the rate, its slope and what else moves the vehicle; this is the hover's trim
    at first.
    """

    autopilot = "betaflight-adrc"
    _gyro_low_passes = (*BetaflightRateController._gyro_low_passes, "adrc_gyro_lpf_hz")

    def _begin(self) -> None:
        super()._begin()
        self._sent: list[Value] = list(self._integral)
        self._observed: list[tuple[Value, Value, Value]] = [
            (0.0, 0.0, -math.radians(1000.0 * self._get(f"adrc_b0_{name}")) * trim)
            for name, trim in zip(self.names, self._integral, strict=True)
        ]

    def _torques(self, targets: Sequence[Value]) -> list[Value]:
        for i, name in enumerate(self.names):
            wc, wo, b0 = (self._get(f"adrc_{x}_{name}") for x in ("wc", "wo", "b0"))
            b0 = math.radians(1000.0 * b0)
            rate, slope, other = self._observed[i]
            off = self._gyro[i] - rate
            rate, slope, other = (
                rate + self.period * (slope + 3.0 * wo * off),
                slope + self.period * (other + b0 * self._sent[i] + 3.0 * wo**2 * off),
                other + self.period * wo**3 * off,
            )
            self._observed[i] = rate, slope, other
            self._sent[i] = (wc**2 * (targets[i] - rate) - 2.0 * wc * slope - other) / b0
        return list(self._sent)


class IndiRateController(RateController):
    """Incremental nonlinear dynamic inversion with Indiflight's parameters.

    What the last commands did is measured, and only the rest is asked for (Smeur et al. 2016,
    Journal of Guidance, Control, and Dynamics 39, 450-461).

    Its effectiveness is that of the settings, not of the vehicle, which it inverts by least
    squares; torques are angular accelerations in rad/s^2. What the commands did, with the motors'
    lag and what rotors do to yaw in spinning up (G2), is behind the acceleration's low-pass.
    """

    autopilot = "indiflight"
    curve_name = "thrust_curve"
    names = ("roll", "pitch", "yaw")
    _rate, _cutoff = 15.0, 20.0
    """1/s, from the error of a rate to the acceleration wanted; Hz, of the low-pass."""

    def _begin(self) -> None:
        self._slope_filter: LowPass2 | None = None
        self._sent_filter, self._spun_filter = (
            LowPass2(self._cutoff, self.period) for _ in range(2)
        )
        self._turned: list[Value] = [0.0, 0.0, 0.0]
        self._slope: list[Value] = [0.0, 0.0, 0.0]
        self._start = tuple(self._integral)
        effect, reaction, full, hover = (
            scale * np.array(self._get(f"indi_act_{name}"))
            for name, scale in (
                ("g1_yaw", 0.1), ("g2_yaw", 1e-5), ("max_rpm", math.pi / 30.0),
                ("hover_rpm", math.pi / 30.0),
            )
        )  # fmt: skip
        # rad/s per share of full thrust around hover.
        reaction = reaction * full**2 / (2.0 * hover)
        self._reacts = (0.0, 0.0, float(reaction @ effect / (effect @ effect)))

    @property
    def _attitude_names(self) -> tuple[str, str, str]:
        return "attitude", "attitude", "attitude"

    def _make_mixer(self, vehicle: Vehicle) -> list[tuple[Value, Value, Value]]:
        effect = np.array([0.1 * np.array(self._get(f"indi_act_g1_{a}")) for a in self.names])
        force = 0.01 * np.array([self._get("indi_act_g1_fz")])
        return [tuple(row) for row in np.linalg.pinv(np.vstack([effect, force]))[:, :3].tolist()]

    def observe(self, state: State, step: float) -> None:
        """Filter the angular acceleration, at every step of the physics."""
        self._time += step
        if self._slope_filter is None:
            self._slope_filter = LowPass2(self._cutoff, step)
            self._gyro = list(state.rates)
        raw = [(w - before) / step for w, before in zip(state.rates, self._gyro, strict=True)]
        self._slope, self._gyro = self._slope_filter(raw), list(state.rates)

    def _torques(self, targets: Sequence[Value]) -> list[Value]:
        lag = 1e-3 * float(np.mean(self._get("indi_act_time_const_ms")))
        share = 1.0 - math.exp(-self.period / lag)
        # From the trim on, which the rotors do already.
        sent = [u - start for u, start in zip(self.sent, self._start, strict=True)]
        sent = sent if any(np.any(u) for u in self.sent) else [0.0, 0.0, 0.0]
        rising = [share * (u - y) for y, u in zip(self._turned, sent, strict=True)]
        self._turned = [y + up for y, up in zip(self._turned, rising, strict=True)]
        reactions = [up * r / self.period for up, r in zip(rising, self._reacts, strict=True)]
        done, spun = self._sent_filter(self._turned), self._spun_filter(reactions)
        out = []
        for i, reacts in enumerate(self._reacts):
            wanted = self._rate * (targets[i] - self._gyro[i])
            lacking = (wanted - self._slope[i] + spun[i]) / (1.0 + reacts / lag)
            out.append(self._start[i] + done[i] + lacking)
        return out


CONTROLLERS: dict[str, type[RateController]] = {
    "px4": Px4RateController,
    "ardupilot": ArduPilotRateController,
    "betaflight": BetaflightRateController,
    "inav": InavRateController,
    "betaflight-adrc": AdrcRateController,
    "indiflight": IndiRateController,
}


def rate_controller(autopilot: str, gains: str) -> Callable[[Vehicle, float], RateController]:
    """What makes the rate controller of an autopilot.

    Args:
        autopilot: "px4" or "ardupilot".
        gains: a .params, .param or .parm file, or "default".

    Raises:
        InputError: the file cannot be read, or holds no gain of this autopilot.
    """
    settings: dict[str, float] = {}
    if gains != "default":
        found = read_parameter_file(Path(gains))
        settings = {name: found[name] for name in DEFAULTS[autopilot] if name in found}
        if not settings:
            raise InputError(f"--gains {gains}: has no gains of {autopilot}: give its own file")
    return lambda vehicle, period: CONTROLLERS[autopilot](vehicle, period, settings)
