"""How far the identified model flies from the vehicle, and how far it may.

From the measured state at the start of every stretch the model is flown with the log's inputs, and
its error at the end is compared with a 95 % band:

    sigma^2 = var(ensemble drawn from the covariance) + s^2

with s the error that the twin had over stretches of the same length in a part of the flight that is
not judged. It contains what no parameter covers: noise of the sensors in the state at the start and
the end, noise of the rotors' stream, and whatever disturbs the vehicle.

Unmodeled moments are known up to the start of a stretch and extrapolated from there. Wind, a CG
that the whiteners cannot distinguish from it, and unequal rotors leave a lasting angular
acceleration. The residual of one step of the model, averaged over the past with a memory m,

    d_k = (1 - a) sum_i a^i (w - w_model)_(k-i) / dt ,   a = exp(-dt / m),

is added to the model's at the start of a stretch and fades, d(t) = d exp(-t / tau): the forecast of
an Ornstein-Uhlenbeck moment. Memory and fading of each axis are those that predict best in a part
of the flight that is not judged; an axis without anything that lasts has none.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.model import attitude
from gcs_sysid.model.flight_model import FlightModel, MotionState, Trajectory
from gcs_sysid.model.parameters import AXES, THETA
from gcs_sysid.signals.recursions import lfilter
from gcs_sysid.significance import Z95
from gcs_sysid.twin.measured_flight import MeasuredFlight

_MEMORIES = (0.03, 0.1, 0.3, 1.0)
"""s."""
_AHEAD = (0.3, 1.0)
"""s ahead at which they are compared."""
_LEAST = 0.3
"""Nats over these lengths, by which the power of the errors must fall: of noise alone nothing is
carried (20 draws of 12 s in the tests)."""


@dataclass(frozen=True)
class Carried:
    """How a disturbance is carried on, by axis.

    Attributes:
        memory: (3,) s, of the average before the start; 0: nothing is carried on.
        fading: (3,) s.
        rms: (3,) rad/s^2 of what is carried on.
    """

    memory: Array
    fading: Array
    rms: Array

    @property
    def any(self) -> bool:
        """Whether there is any."""
        return bool(self.memory.any())

    @property
    def says(self) -> str:
        """In words, what is carried on."""
        return ", ".join(
            f"{axis} {self.rms[i]:.2g} rad/s^2 rms, fading over {self.fading[i]:g} s"
            for i, axis in enumerate(AXES)
            if self.memory[i]
        )

    def at(self, left: Array, dt: float) -> Array:
        """(n, 3) rad/s^2 known at each sample of a gapless part.

        Args:
            left: (n, 3) sums of what one step leaves, as of `MeasuredFlight.one_step`.
            dt: s.
        """
        out = np.zeros_like(left)
        for axis in np.flatnonzero(self.memory):
            out[:, axis] = _averaged(left[:, axis], dt, float(self.memory[axis]))
        return out

    def forecast(self, now: Array, steps: int, dt: float) -> Array:
        """(k, steps, 3) rad/s^2 of every step after k instants, at which (k, 3) is known."""
        middle = dt * (np.arange(steps) + 0.5)
        fading = np.where(self.memory > 0.0, self.fading, 1.0)
        return now[:, None, :] * np.exp(-middle[:, None] / fading)


NOTHING_CARRIED = Carried(np.zeros(3), np.zeros(3), np.zeros(3))


def choose_carried(lefts: Sequence[Array], dt: float) -> Carried:
    """The memory and fading of each axis that predict best.

    Args:
        lefts: (n, 3) sums of what one step leaves, of every gapless part.
        dt: s.
    """
    memory, fading, rms = np.zeros(3), np.zeros(3), np.zeros(3)
    ahead = [round(seconds / dt) for seconds in _AHEAD]
    # Compared every 20 ms.
    stride, first = max(1, round(0.02 / dt)), round(max(_MEMORIES) / dt)
    there = [left for left in lefts if len(left) > first + ahead[-1] + stride]
    if not there:
        return NOTHING_CARRIED
    for axis in range(3):
        columns = [left[:, axis] for left in there]
        at = [np.arange(first, len(c) - ahead[-1], stride) for c in columns]
        rise = [
            np.concatenate([c[i + n] - c[i] for c, i in zip(columns, at, strict=True)])
            for n in ahead
        ]
        alone = sum(math.log(max(float((r**2).mean()), 1e-300)) for r in rise)
        best = alone - _LEAST
        for m in _MEMORIES:
            d = np.concatenate([_averaged(c, dt, m)[i] for c, i in zip(columns, at, strict=True)])
            for tau in (0.1, 0.3, 1.0, 3.0, 10.0):
                gains = [tau * (1.0 - math.exp(-n * dt / tau)) for n in ahead]
                score = sum(
                    math.log(max(float(((r - g * d) ** 2).mean()), 1e-300))
                    for r, g in zip(rise, gains, strict=True)
                )
                if score < best:
                    best, memory[axis], fading[axis] = score, m, tau
                    rms[axis] = math.sqrt(float((d**2).mean()))
    return Carried(memory, fading, rms)


def _averaged(left: Array, dt: float, memory: float) -> Array:
    """(n,) rad/s^2, leaky average of the past of (n,) sums."""
    a = math.exp(-dt / memory)
    steps = np.diff(left, prepend=left[:1])[:, None] / dt
    out, _ = lfilter([1.0 - a], [1.0, -a], steps)
    return np.asarray(out)[:, 0]


HORIZONS = (0.1, 0.3, 1.0, 3.0)
"""s, lengths of the stretches."""
QUANTITIES = ("rates", "attitude", "velocity")
"""In rad/s, rad and m/s."""
_ROTATION = tuple(f.name for f in fields(FlightModel) if f.name in THETA)
"""Fields of the flight model that turn it and are not of the basic one."""
_OVERLAP = 4
"""Stretches of the part that gives the noise begin this often in a length."""


@dataclass(frozen=True)
class Accuracy:
    """Errors of one quantity over stretches of one length.

    Attributes:
        rms: of the three axes, at the end of the stretch; unit: `QUANTITIES`.
        band: rms of the half width of the 95 % band.
        band_parameters: rms of 1.96 standard deviations by the covariance alone.
        inside: share of the errors inside the band.
        r_squared: 1 - error power over the variance of what was measured, at the end.
        guess: rms error at the end of the guess that rates, and velocity, stay as they are.
        basic: rms error of `basic_model` at the end.
        count: stretches.
    """

    rms: float
    band: float
    band_parameters: float
    inside: float
    r_squared: float
    guess: float
    basic: float
    count: int

    def as_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {name: value if np.isfinite(value) else None for name, value in vars(self).items()}


@dataclass(frozen=True)
class Growth:
    """Errors over the longest stretches that there are, as a picture shows them.

    Attributes:
        t: (n,) s since the start of the stretch.
        rms: quantity -> (n,) of the model.
        guess: quantity -> (n,) of the constant guess.
    """

    t: Array
    rms: dict[str, Array]
    guess: dict[str, Array]


FlightPart = tuple[float, float]
"""Begin and end in s of a part of a flight: to be judged, or to estimate the noise."""


@dataclass(frozen=True)
class _Errors:
    """Of stretches of one length.

    Attributes:
        error: quantity -> (stretches, n, 3), NaN where it was not measured.
        guess: the same of the constant guess.
        measured: the same as measured; the attitude as a turn from its mean.
        parameters: quantity -> (stretches, 3) standard deviation at the end by the ensemble.
        basic: quantity -> (stretches, 3) error of `basic_model` at the end.
    """

    error: dict[str, Array]
    guess: dict[str, Array]
    measured: dict[str, Array]
    parameters: dict[str, Array]
    basic: dict[str, Array]


class Twin:
    """Flies a model and its ensemble along a record.

    `ensemble` is (samples, 1), drawn from the model's covariance.
    """

    def __init__(self, model: FlightModel, ensemble: FlightModel, record: MeasuredFlight) -> None:
        self._model, self._ensemble, self._record = model, ensemble, record
        self._basic = basic_model(model)
        self.averaged = 1
        """Samples of the past that the rates at the start are averaged over."""
        self.carried = NOTHING_CARRIED
        """Of a disturbance known at the start."""
        self._left: dict[tuple[int, int], Array] = {}

    def choose_average(self, part: FlightPart) -> None:
        """Take the average of the past that predicts best over a tenth of a second."""
        record = self._record
        span = 0.1  # s ahead at which it is chosen, and of the past at most
        ahead, most = max(1, round(span / record.dt)), max(1, int(span / record.dt))
        candidates = [2**k for k in range(int(np.log2(most)) + 1)]
        power = np.zeros(len(candidates))
        for run in record.runs(*part):
            if run.stop - run.start < most + ahead + 2:
                continue
            left = self._one_step(run)
            total = np.concatenate([np.zeros((1, 3)), np.cumsum(left, axis=0)])
            at = np.arange(most, len(left) - ahead)
            for i, m in enumerate(candidates):
                mean = (total[at + 1] - total[at + 1 - m]) / m
                power[i] += ((left[at + ahead] - mean) ** 2).sum()
        self.averaged = candidates[int(np.argmin(power))]

    def choose_carried(self, part: FlightPart) -> None:
        """Carry a disturbance on as predicts best in a part of the flight."""
        runs = self._record.runs(*part)
        self.carried = choose_carried(
            [self._one_step(run) for run in runs if run.stop - run.start > 1], self._record.dt
        )

    def _one_step(self, run: slice) -> Array:
        """(n, 3) sums of what one step leaves of the rates."""
        key = run.start, run.stop
        if key not in self._left:
            self._left[key] = self._record.one_step(self._model, run)
        return self._left[key]

    def starts(self, part: FlightPart, seconds: float, overlap: int = 1) -> tuple[Array, int]:
        """First samples of the stretches of a length in a part of the flight, and their steps."""
        record = self._record
        steps = max(1, round(seconds / record.dt))
        room = int(np.ceil(record.settling / record.dt)) + self.averaged
        found = [
            np.arange(run.start + room, run.stop - steps, max(1, steps // overlap))
            for run in record.runs(*part)
        ]
        return np.concatenate([np.empty(0, np.int64), *found]).astype(np.int64), steps

    def errors(self, part: FlightPart, seconds: float, overlap: int = 1) -> _Errors | None:
        """Fly every stretch of a length, if there is any; for the noise no ensemble is flown."""
        record = self._record
        starts, steps = self.starts(part, seconds, overlap)
        rows = starts[:, None] + np.arange(steps + 1)
        measured = {
            "rates": record.rates[rows],
            "attitude": record.attitude[rows],
            "velocity": record.velocity[rows],
        }
        if not len(starts):
            return None
        rates = self._averaged_rates(starts)
        velocity = np.where(np.isfinite(measured["velocity"]), measured["velocity"], 0.0)[:, 0]
        start = MotionState(rates, measured["attitude"][:, 0], velocity)
        t = record.dt * np.arange(steps + 1)
        carried = self._forecast(starts, steps)
        flown = self._fly(self._model, t, starts, rows, start, carried)
        error = _difference(flown, measured)
        spread = {name: np.zeros((len(starts), 3)) for name in QUANTITIES}
        basic = {name: e[:, -1] for name, e in error.items()}
        if overlap == 1:
            without = _difference(self._fly(self._basic, t, starts, rows, start), measured)
            basic = {name: e[:, -1] for name, e in without.items()}
            with np.errstate(over="ignore", invalid="ignore"):  # some that are drawn tumble
                each = self._fly(self._ensemble, t, starts, rows, start, carried)
                for name, turned in _difference(each, measured).items():
                    end = turned[..., -1, :] - error[name][:, -1]
                    spread[name] = np.sqrt((end**2).mean(axis=0))
        return _Errors(
            {name: e[:, 1:] for name, e in error.items()},
            {name: e[:, 1:] for name, e in _difference(_held(t, start), measured).items()},
            {name: e[:, 1:] for name, e in _as_vectors(measured).items()},
            spread,
            basic,
        )

    def _fly(
        self,
        model: FlightModel,
        t: Array,
        starts: Array,
        rows: Array,
        start: MotionState,
        carried: Array | None = None,
    ) -> Trajectory:
        record = self._record
        if record.rotor_input.motors:
            room = int(np.ceil(record.settling / record.dt))
            before = starts[:, None] + np.arange(-room, 1)
            lagged = model.lagged(record.dt * np.arange(room + 1), record.rotors[before])
            start = replace(start, rotors=lagged[..., -1, :])
        return model.simulate(t, record.rotors[rows], start, angular_disturbance=carried)

    def _forecast(self, starts: Array, steps: int) -> Array | None:
        """(stretches, steps, 3) rad/s^2 of what is carried on; None: nothing is."""
        if not self.carried.any:
            return None
        dt, known = self._record.dt, np.zeros((len(starts), 3))
        for inside, at, left in self._before(starts):
            known[inside] = self.carried.at(left, dt)[at]
        return self.carried.forecast(known, steps, dt)

    def _before(self, starts: Array) -> Iterator[tuple[Mask, Array, Array]]:
        """Which starts are in a gapless part, where in it, and what one step leaves there."""
        for run in self._record.runs():
            inside = (starts >= run.start) & (starts < run.stop)
            if inside.any():
                yield inside, starts[inside] - run.start, self._one_step(run)

    def _averaged_rates(self, starts: Array) -> Array:
        """(stretches, 3) rates at the start, by those of the past carried on by the model."""
        rates, m = self._record.rates[starts], self.averaged
        for inside, at, left in self._before(starts) if m > 1 else ():
            mean = left[at[:, None] + np.arange(-m + 1, 1)].mean(axis=1)
            rates[inside] -= left[at] - mean
        return rates


def basic_model(model: FlightModel) -> FlightModel:
    """The same without drag, damping, rotor inertia and what makes one rotor unlike another."""

    def alike(values: Array) -> Array:
        mean = values.mean(axis=-1, keepdims=True)
        return np.broadcast_to(mean, values.shape)

    return replace(
        model,
        thrust=alike(model.thrust),
        torque=alike(model.torque),
        **{name: np.zeros_like(getattr(model, name)) for name in ("damping", "drag", *_ROTATION)},
    )


def judge(
    twin: Twin, judged: Sequence[tuple[FlightPart, FlightPart]], has_velocity: bool
) -> tuple[dict[float, dict[str, Accuracy]], Growth | None]:
    """Compare the twin's errors with their bands.

    `judged` are parts to judge, each with the part that gives its noise.

    Returns:
        Length in s -> quantity -> accuracy, of lengths that there are stretches of; growth of the
        errors over the longest of them.
    """
    names = QUANTITIES if has_velocity else QUANTITIES[:2]
    out: dict[float, dict[str, Accuracy]] = {}
    growth = None
    for seconds in HORIZONS:
        found = []
        for part, noise in judged:
            twin.choose_average(noise)
            twin.choose_carried(noise)
            errors = twin.errors(part, seconds)
            predicted = twin.errors(noise, seconds, _OVERLAP)
            if errors is not None and predicted is not None:
                found.append((errors, predicted))
        if not found:
            continue
        out[seconds] = {name: _accuracy(name, found) for name in names}
        t = seconds / found[0][0].error["rates"].shape[1]
        growth = Growth(
            t * np.arange(1, found[0][0].error["rates"].shape[1] + 1),
            *(
                {
                    name: _rms(np.concatenate([getattr(e, kind)[name] for e, _ in found]), (0, 2))
                    for name in names
                }
                for kind in ("error", "guess")
            ),
        )
    return out, growth


def _accuracy(name: str, found: Sequence[tuple[_Errors, _Errors]]) -> Accuracy:
    ends, bands, own, guesses, basics = [], [], [], [], []
    for errors, predicted in found:
        end, noise = errors.error[name][:, -1], predicted.error[name][:, -1]
        noise = noise[np.isfinite(noise).all(axis=1)]
        independent = max(2.0, len(noise) / _OVERLAP)
        spread = errors.parameters[name]
        sigma = np.sqrt(spread**2 + (noise**2).mean(axis=0) if len(noise) else np.nan)
        bands.append(float(stdtrit(independent, 0.975)) * np.broadcast_to(sigma, end.shape))
        ends.append(end)
        own.append(spread)
        guesses.append(errors.guess[name][:, -1])
        basics.append(errors.basic[name])
    end, band = np.concatenate(ends), np.concatenate(bands)
    there = np.isfinite(end).all(axis=1) & np.isfinite(band).all(axis=1)
    measured = np.concatenate([e.measured[name][:, -1] for e, _ in found])
    nan = float("nan")
    if not there.any():
        return Accuracy(nan, nan, nan, nan, nan, nan, nan, 0)
    return Accuracy(
        rms=float(_rms(end[there])),
        band=float(_rms(band[there])),
        band_parameters=Z95 * float(_rms(np.concatenate(own)[there])),
        inside=float((np.abs(end[there]) <= band[there]).mean()),
        r_squared=_r_squared(end[there], measured[there]),
        guess=float(_rms(np.concatenate(guesses)[there])),
        basic=float(_rms(np.concatenate(basics)[there])),
        count=int(there.sum()),
    )


def _r_squared(error: Array, measured: Array) -> float:
    """1 - sum |e|^2 / sum |x - mean|^2."""
    power = float(np.nansum((measured - np.nanmean(measured, axis=0)) ** 2))
    return 1.0 - float(np.nansum(error**2)) / power if power > 0.0 else float("nan")


def _rms(values: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    count = np.isfinite(values).sum(axis=axis)
    # Of runs that end early nothing is left in the last steps.
    return np.sqrt(np.nansum(values**2, axis=axis) / np.where(count > 0, count, np.nan))


def _difference(flown: Trajectory, measured: dict[str, Array]) -> dict[str, Array]:
    """Measured less flown; of attitudes the turn between them, in body axes."""
    turn = attitude.multiply(attitude.conjugate(flown.attitude), measured["attitude"])
    return {
        "rates": measured["rates"] - flown.rates,
        "attitude": attitude.to_rotation_vector(turn),
        "velocity": measured["velocity"] - flown.velocity,
    }


def _as_vectors(measured: dict[str, Array]) -> dict[str, Array]:
    """The same with attitudes as turns from their mean."""
    q = measured["attitude"]
    flat = q.reshape(-1, 4)
    _, axes = np.linalg.eigh(flat.T @ flat)
    turn = attitude.multiply(attitude.conjugate(axes[:, -1]), q)
    return measured | {"attitude": attitude.to_rotation_vector(turn)}


def _held(t: Array, start: MotionState) -> Trajectory:
    """The guess that body rates and velocity stay as they are."""
    rates, q, v = (
        np.asarray(part)[:, None] for part in (start.rates, start.attitude, start.velocity)
    )
    turned = attitude.multiply(q, attitude.from_rotation_vector(rates * t[:, None]))
    ones = np.ones((len(t), 1))
    return Trajectory(t, rates * ones, turned, v * ones, v * t[:, None])
