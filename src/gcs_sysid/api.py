"""The chain for notebooks and scripts: `gcs_sysid.analyze`, and `gcs_sysid.identify` for arrays.

Both end with the `Result` that the command line prints and `--json` writes. What cannot be used,
a file, a name or an array, is an `InputError` with one line that says what and why.

What reads logs is imported by the functions that are given one: arrays need no MAVLink.
"""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from gcs_sysid.argument_types import GIVEN, parse_given, with_given
from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import ANCHORS, Airframe
from gcs_sysid.model.airframe import load_airframe as read_airframe
from gcs_sysid.model.estimate import Estimate, IdentifiedEstimate
from gcs_sysid.model.flight_model import FlightModel, MotionState, Trajectory
from gcs_sysid.report.data import predicted
from gcs_sysid.results.history import Acceleration
from gcs_sysid.results.parameter_samples import ParameterSamples
from gcs_sysid.results.result import Result
from gcs_sysid.results.result_file import read_result
from gcs_sysid.session.chain import HISTORY_INTERVAL, Chain, ChainOptions
from gcs_sysid.signals.columns import Track
from gcs_sysid.signals.records import Stream
from gcs_sysid.signals.sampling import WINDOW
from gcs_sysid.telemetry.track_collector import in_order
from gcs_sysid.twin.measured_flight import FlightRecorder
from gcs_sysid.twin.twin_flight import TwinFlight

__all__ = [
    "Airframe",
    "Estimate",
    "FlightModel",
    "IdentifiedEstimate",
    "InputError",
    "MotionState",
    "ParameterSamples",
    "Result",
    "Signals",
    "Trajectory",
    "TwinFlight",
    "analyze",
    "fly_twin",
    "identify",
    "load_airframe",
    "read_result",
]


@dataclass(frozen=True)
class Signals:
    """What a vehicle measured, as arrays. Body axes forward, right, down; world north, east, down.

    Signals are sampled at `t` unless `times` gives them times of their own. Times must increase, on
    one clock, but need not be uniform. NaN marks missing values.

    Attributes:
        t: (n,) s.
        gyro: (n, 3) body rates as measured, rad/s.
        force: (n, 3) specific force, as an accelerometer reads it, m/s^2.
        attitude: (n, 4) unit quaternions w, x, y, z, body to world.
        speeds: (n, rotors) measured speeds in rad/s, in the airframe's order of rotors.
        commands: (n, rotors) outputs to the motors in the same order, 0 to 1, or in the unit of
            the airframe's command range. At least one of the two.
        velocity: (n, 3) m/s; without it thrust over mass comes from the accelerometer alone.
        position: (n, 3) m, at the times of the velocity; helps to detect flight.
        flying: (n,) whether it flies; default: derived from rotors and height.
        times: name of a signal -> (k,) s, where it has times of its own. Gyro and force share
            `t`, velocity and position share the times of the velocity.
    """

    t: ArrayLike
    gyro: ArrayLike
    force: ArrayLike
    attitude: ArrayLike
    speeds: ArrayLike | None = None
    commands: ArrayLike | None = None
    velocity: ArrayLike | None = None
    position: ArrayLike | None = None
    flying: ArrayLike | None = None
    times: Mapping[str, ArrayLike] | None = None

    def tracks(self, rotors: int) -> tuple[Track, ...]:
        """The signals as the chain takes them.

        Args:
            rotors: how many the airframe has.

        Raises:
            InputError: shapes do not match, or times do not increase.
        """
        own = {"attitude", "speeds", "commands", "velocity", "flying"}
        unknown = set(self.times or {}) - own
        if unknown:
            raise InputError(
                f"no separate times for {', '.join(sorted(unknown))}; only {', '.join(sorted(own))}"
            )
        if self.speeds is None and self.commands is None:
            raise InputError("give speeds or commands of the rotors")
        if self.position is not None and self.velocity is None:
            raise InputError("position needs velocity too")
        imu = np.hstack([self._values("gyro", 3), self._values("force", 3)])
        attitude = self._values("attitude", 4)
        with np.errstate(invalid="ignore"):
            stretched = np.abs(np.linalg.norm(attitude, axis=1) - 1.0) > 0.1
        if stretched.any():
            raise InputError(f"attitude: row {int(stretched.argmax())} is not a unit quaternion")
        # Of one instant the IMU comes last: the chain then has what goes with it.
        tracks = [Track(Stream.ATTITUDE, self._times("attitude"), attitude)]
        for name, stream in (("speeds", Stream.ROTOR_SPEED), ("commands", Stream.ROTOR_COMMAND)):
            if getattr(self, name) is not None:
                values = self._values(name, rotors)
                tracks.append(Track(stream, self._times(name), values, source=name))
        if self.velocity is not None:
            motion = np.full((len(self._times("velocity")), 6), np.nan)
            motion[:, :3] = self._values("velocity", 3)
            if self.position is not None:
                motion[:, 3:] = self._values("position", 3, "velocity")
            tracks.append(Track(Stream.VELOCITY, self._times("velocity"), motion))
        if self.flying is not None:
            tracks.append(Track(Stream.IN_AIR, self._times("flying"), self._values("flying", 1)))
        tracks.append(Track(Stream.IMU, self._times("t"), imu))
        return tuple(map(_without_gaps, tracks))

    def _times(self, name: str) -> Array:
        try:
            t = np.asarray((self.times or {}).get(name, self.t), np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"times of {name}: not an array of numbers ({error})") from error
        if t.ndim != 1 or len(t) < 2 or not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
            raise InputError(f"times of {name}: must be increasing times in s")
        return t

    def _values(self, name: str, width: int, times: str | None = None) -> Array:
        try:
            values = np.asarray(getattr(self, name), np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: not an array of numbers ({error})") from error
        if width == 1 and values.ndim == 1:
            values = values[:, None]
        rows = len(self._times(times or name))
        if values.shape != (rows, width):
            raise InputError(f"{name}: must have the shape {(rows, width)}, not {values.shape}")
        return values


class Known(TypedDict, total=False):
    """What may be said of an airframe beyond its file.

    Attributes:
        arm: m, mean distance of the rotors that the layout is scaled to; this and the next three
            perhaps with a standard deviation, as "0.25+-0.003" or "0.25+-1%".
        mass: kg, weighed, as the scale.
        k_T: N s^2, as the scale; with measured speeds.
        T_max: N, a rotor's thrust at full command, as the scale; with commands.
        priors: name -> value and standard deviation, SI.
        uncertainty: of arm, mass, ...: number or percentage, as in a file's `[uncertainty]`.
    """

    arm: float | str
    mass: float | str
    k_T: float | str
    T_max: float | str
    priors: Mapping[str, tuple[float, float]]
    uncertainty: Mapping[str, float | str]


def load_airframe(
    airframe: str | PathLike[str] | Airframe,
    **known: Unpack[Known],
) -> Airframe:
    """An airframe with a scale.

    Args:
        airframe: a built-in name, a .toml file, or an airframe to modify.
        known: see `Known`.

    Raises:
        InputError: there is no such airframe, several scales are given, or none.

    Example:
        >>> import gcs_sysid
        >>> airframe = gcs_sysid.load_airframe("paper", mass=1.62, arm=0.3)
        >>> airframe.anchor(), round(airframe.arm, 6)
        (('mass', 1.62), 0.3)
    """
    out = _as_known(airframe, known)
    if out.anchor() is None:
        raise InputError(
            f"nothing sets the scale: give one of {', '.join(ANCHORS)}; IMU and rotor data alone "
            "fix ratios only"
        )
    return out


def _as_known(airframe: str | PathLike[str] | Airframe, known: Known) -> Airframe:
    """An airframe with what is known of it, perhaps no scale."""
    unknown = known.keys() - Known.__annotations__.keys()
    if unknown:
        raise TypeError(f"unexpected keyword argument {min(unknown)!r}")
    out = airframe if isinstance(airframe, Airframe) else read_airframe(fspath(airframe))
    scales = [name for name in ANCHORS if name in known]
    if len(scales) > 1:
        raise InputError(f"give one scale only, not {' and '.join(scales)} together")
    for name in GIVEN:
        if name in known:
            value = known[name]
            given = parse_given(name, value, name) if isinstance(value, str) else value
            out = with_given(out, name, given, name)
    out = out.with_uncertainty(known.get("uncertainty", {}), "uncertainty")
    for prior, (value, std) in known.get("priors", {}).items():
        out = out.with_prior(prior, value, std)
    out.check_scale_fits()
    return out


def analyze(
    log: str | PathLike[str],
    airframe: str | PathLike[str] | Airframe,
    *,
    vehicle: tuple[int, int | None] | None = None,
    start: float = 0.0,
    end: float = float("inf"),
    offline: bool = False,
    history: bool = False,
    **known: Unpack[Known],
) -> Result:
    """Identify from a recorded flight, with the numbers of `gcs-sysid analyze`.

    Args:
        log: its file.
        airframe: as for `load_airframe`.
        vehicle: system and perhaps component; None: the first autopilot in the log.
        start: s after the first record; earlier records are not used.
        end: s after the first record; later ones are not used.
        offline: whether to estimate once more from all samples, see `docs/method/offline.md`.
        history: whether to keep estimates and predicted acceleration over time, for
            `Result.plot`; takes longer.
        known: scale, arm and priors, see `Known`. Without a scale values are per kg of the mass,
            and of a built-in layout without `arm` per m of that too, as their units say.

    Raises:
        InputError: the log or the airframe cannot be used.

    Example:
        >>> import gcs_sysid
        >>> result = gcs_sysid.analyze("logs/sample.tlog", "paper", mass=1.5)
        >>> result.verdict, result.parameters["Izz"].status
        ('identified', 'identified')
        >>> low, high = result.parameters["Izz"].ci95
        >>> low < 0.0294 < high  # kg m^2, see logs/sample.truth.json
        True
    """
    from gcs_sysid.session.analysis import analyze_log

    interval = HISTORY_INTERVAL if history else None
    options = ChainOptions(history_interval=interval, start=start, end=end, offline=offline)
    whole = _as_known(airframe, known)
    if not history:
        return analyze_log(Path(log), whole, vehicle, options)
    with closing(FlightRecorder()) as recorder:
        result = analyze_log(Path(log), whole, vehicle, options, observers=[recorder])
        return replace(
            result, history=recorder.history, prediction=_prediction(recorder, result, whole)
        )


def _prediction(
    recorder: FlightRecorder, result: Result, airframe: Airframe
) -> Acceleration | None:
    """Angular acceleration of the part that the validation held out; None: none was."""
    if recorder.validation is None:
        return None
    rows = predicted(result, recorder, airframe)
    if rows is None:
        return None
    part = rows.held_out
    return Acceleration(rows.t[part], rows.measured[part], rows.predicted[part])


def fly_twin(
    result: Result,
    log: str | PathLike[str],
    airframe: str | PathLike[str] | Airframe | None = None,
    *,
    vehicle: tuple[int, int | None] | None = None,
    seed: int = 0,
    **known: Unpack[Known],
) -> TwinFlight:
    """Fly a result along a log's held-out stretches, with the numbers of `gcs-sysid twin`.

    Args:
        result: of this flight (the model is then refitted to its first part) or of another.
        log: its file.
        airframe: as for `load_airframe`; None: that of the result.
        vehicle: system and perhaps component; None: the first autopilot in the log.
        seed: of the vehicles drawn from the covariance.
        known: scale, arm and priors, see `Known`.

    Raises:
        InputError: the log cannot be used, or does not fit the result.

    Example:
        >>> import gcs_sysid
        >>> result = gcs_sysid.analyze("logs/sample.tlog", "paper", mass=1.5)
        >>> twin = gcs_sysid.fly_twin(result, "logs/sample.tlog")
        >>> twin.same_flight, twin.accuracy[1.0]["rates"].r_squared > 0.9
        (True, True)
    """
    from gcs_sysid.twin.held_out_flight import fly_held_out

    if airframe is None and known:
        raise InputError(f"{', '.join(sorted(known))}: give the airframe too")
    whole = None if airframe is None else load_airframe(airframe, **known)
    return fly_held_out(result, Path(log), whole, vehicle, seed=seed)


def identify(
    signals: Signals,
    airframe: str | PathLike[str] | Airframe,
    *,
    offline: bool = False,
    **known: Unpack[Known],
) -> Result:
    """Identify from arrays, by the chain that logs and links go through.

    Args:
        signals: of one vehicle.
        airframe: as for `load_airframe`.
        offline: whether to estimate once more from all samples, see `docs/method/offline.md`.
        known: scale, arm and priors, see `Known`.

    Raises:
        InputError: arrays do not fit, or the airframe cannot be used.

    Example:
        A hover without rotation identifies thrust over mass, but no inertia:

        >>> import numpy as np
        >>> import gcs_sysid
        >>> t, rng = np.arange(0.0, 20.0, 0.02), np.random.default_rng(1)
        >>> noise = rng.normal(size=(len(t), 3))
        >>> signals = gcs_sysid.Signals(
        ...     t=t,
        ...     gyro=0.01 * noise,
        ...     force=[0.0, 0.0, -9.81] + 0.1 * noise,
        ...     attitude=np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)),
        ...     speeds=134.0 + rng.normal(size=(len(t), 4)),
        ... )
        >>> result = gcs_sysid.identify(signals, "paper", mass=1.5)
        >>> result.verdict, result.parameters["k_T"].status, result.parameters["Ixx"].status
        ('refused', 'weak', 'unobservable')
    """
    whole = load_airframe(airframe, **known)
    chain = Chain(whole, ChainOptions(offline=offline))
    tracks = [track for track in signals.tracks(len(whole.rotors)) if len(track.t)]
    if not tracks:
        raise InputError("all values are NaN")
    for window in in_order(tracks).windows(WINDOW):
        chain.take(window)
    return replace(chain.finish(), source="arrays")


def _without_gaps(track: Track) -> Track:
    """The track without samples in which nothing is known; the chain sees a gap there."""
    known = np.isfinite(track.values).any(axis=1)
    return replace(track, t=track.t[known], values=track.values[known])
