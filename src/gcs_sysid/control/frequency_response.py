"""Frequency response measured on a flight, no sweep needed: command to rate, set-point to rate.

Gapless pieces of flight are tapered by discrete prolate spheroidal sequences of time-bandwidth NW
(Thomson 1982, Proc. IEEE 70, 1055-1096): 2 NW - 1 spectra of each piece that are nearly
uncorrelated, and so are frequencies 2 W apart. The products of all pieces, tapers and frequencies
of a cell are n independent ones. Rotors answer to gusts, so S_yu / S_uu lies between the vehicle
and the inverse of its controller (Soderstrom and Stoica, System Identification, ch. 10). With an
instrument z that is independent of gusts (ch. 8 there, in the frequency domain)

    G = S_yz / S_uz ,   e = y - G u ,   var G = S_ee S_zz / ((n - 1) |S_uz|^2)

and 2 (n - 1) degrees of freedom are left to e (Bendat and Piersol, Random Data, ch. 9, where the
input is its own instrument). Where e grows with z, by nonlinearity, the sandwich
sum |e|^2 |z|^2 / |sum u z*|^2 is larger, and counts.

Instruments are rate set-points; those that ArduPilot's system identification, Betaflight's chirp
and PX4's autotune inject are part of what is logged. An attitude loop of gain k answers to gusts
through them, r = w - k y / s, hence z = r + k y / s is taken. Below the frequency k outer loops act
on w too, and nothing is claimed.

A controller makes torques of set-points and rates without noise of its own, u = F r - H y. Both
terms, each with a gain and a delay of its own, are fitted to all frequencies at once: what of it
is late of H is a filter or a delay that the law lacks. Where set-points are logged slowly, their
errors decide what rates show that do little but follow them: such cells are left out then.

What is averaged over a cell is the response over a reference's, whose slope is then no error.
"""

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri, stdtrit

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.control.loop_margins import HoverDynamics, Margins, closed_loops, margins_of
from gcs_sysid.control.rate_loops import RateLoop
from gcs_sysid.model.parameters import AXES
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.significance import FALSE_ALARM_RATE


@dataclass(frozen=True)
class SpectralRules:
    """How a flight is cut, and what is claimed of it.

    Attributes:
        pieces: s; the longest of which gapless flight holds most.
        bandwidth: NW of the tapers.
        width: of a cell over its frequency.
        products: least n of a cell.
        coherence: least of an instrument with command and rate, for a response to be claimed.
        sampled: frequencies over the slower of both sampling rates, up to which interpolation
            between samples does not count.
        passed: least that the gyro's filters must leave of a rate.
    """

    pieces: tuple[float, ...] = (20.0, 10.0, 5.0)
    bandwidth: float = 2.0
    width: float = 0.15
    products: int = 16
    coherence: float = 0.6
    sampled: float = 0.2
    passed: float = 0.1


RULES = SpectralRules()
BAND = (2.5, 97.5)
"""Percentiles of the draws, shown as the band."""


@dataclass(frozen=True)
class FlownSignals:
    """Gapless stretches of flight.

    Attributes:
        stretches: each (n, 9) or more: normalized torques, body rates and rate set-points, rad/s;
            NaN where no set-point is logged. Then the rotors' thrust commands, where known.
        dt: s.
        highest: rad/s, up to which commands and rates are sampled well enough.
        held: s, that a set-point stands until the next is logged; 0: no longer than `dt`.
    """

    stretches: tuple[Array, ...]
    dt: float
    highest: float
    held: float = 0.0

    @property
    def has_setpoints(self) -> bool:
        """Whether set-points are logged all along."""
        return all(np.isfinite(x[:, 6:9]).all() for x in self.stretches)

    def hold(self, omega: Array) -> Array:
        """(w,) response of that to the set-point itself, at (w,) rad/s."""
        half = 0.5 * max(self.held - self.dt, 0.0) * omega  # samples are at the grid's times
        # Beyond half the rate of logging nothing is known; no division by zero there.
        return np.exp(-1j * half) * np.sinc(np.minimum(half / np.pi, 0.5))


def flown_signals(blocks: Iterable[SampleBlock], loop: RateLoop) -> FlownSignals | None:
    """What a log holds of commands and rates; None: no flight.

    Args:
        blocks: of the log; where none has commands for rotors, torques are NaN.
        loop: whose mixer and thrust curve make commands of normalized torques.
    """
    gap = np.full((1, 9 + len(loop.mixer)), np.nan, np.float32)
    kept: list[Array] = []
    dt = interval = 0.0
    inverse = np.linalg.pinv(np.column_stack([loop.mixer, np.ones(len(loop.mixer))]))[:3]
    blocks = [*blocks]
    commanded = [each for each in blocks if each.rotors is not None and each.rotors.kind.motors]
    for block in commanded or blocks:
        if block.dt != dt:  # estimates are of the last grid, too
            kept, dt = [], block.dt
        interval = max(block.dt, block.rotors.interval if commanded and block.rotors else 0.0)
        s = block.samples
        thrust = (1.0 - loop.curve) * s.speeds + loop.curve * s.speeds**2
        thrust = thrust if commanded else np.full_like(thrust, np.nan)
        rows = np.column_stack([thrust @ inverse.T, s.gyro, s.setpoint, thrust]).astype(np.float32)
        kept += [gap, rows] if block.fresh else [rows]
    if not kept:
        return None
    whole = np.concatenate(kept)
    needed = complete_rows(whole[:, :6] if commanded else whole[:, 3:6])
    parts = tuple(whole[part] for part, there in runs(needed) if there)
    changes = [np.diff(np.flatnonzero((np.diff(x[:, 6:9], axis=0) != 0.0).any(1))) for x in parts]
    apart = float(np.median(np.concatenate(changes))) if sum(map(len, changes)) else 1.0
    held = apart * dt if apart > 1.0 else 0.0
    return FlownSignals(parts, dt, 2.0 * np.pi * RULES.sampled / interval, held) if parts else None


@dataclass(frozen=True)
class FrequencyResponse:
    """Measured response at frequencies whose errors are independent.

    Attributes:
        omega: (w,) rad/s.
        values: (w,) complex.
        std: (w,) sqrt(E|error|^2) of these; infinite where they are not free of feedback.
        freedom: (w,) degrees of freedom of `std`.
        coherence: (w,) of the instrument with input and output, the lower.
        claimed: (w,) whether the values are free of feedback, and coherent.
        instrument: in words; empty: none, and values are biased by feedback.
    """

    omega: Array
    values: Array
    std: Array
    freedom: Array
    coherence: Array
    claimed: Mask
    instrument: str

    @property
    def half_width(self) -> Array:
        """(w,) of the 95 % interval of the magnitude, over it; of the phase it is the arcsine."""
        t = stdtrit(self.freedom, 0.975)
        return t * self.std / np.sqrt(2.0) / np.abs(self.values)

    def as_control(self) -> object:
        """What is claimed, as a `control.FrequencyResponseData`.

        Raises:
            ImportError: python-control is not installed (`pip install gcs-sysid[control]`).
        """
        import control

        return control.frd(self.values[self.claimed], self.omega[self.claimed])

    def as_json(self) -> dict[str, Any]:
        """Arrays, with the 95 % band of what is claimed."""
        size, phase = np.abs(self.values), np.degrees(np.unwrap(np.angle(self.values)))
        relative = np.where(self.claimed, self.half_width, np.nan)
        turn = np.degrees(np.arcsin(np.minimum(relative, 1.0)))
        columns = {
            "omega_rad_s": self.omega, "magnitude": size, "magnitude_low": size * (1.0 - relative),
            "magnitude_high": size * (1.0 + relative), "phase_deg": phase,
            "phase_low": phase - turn, "phase_high": phase + turn, "coherence": self.coherence,
        }  # fmt: skip
        arrays = {
            name: [float(v) if np.isfinite(v) else None for v in column]
            for name, column in columns.items()
        }
        return {"instrument": self.instrument or None, **arrays}


@dataclass(frozen=True)
class MeasuredAxis:
    """What a flight shows of one axis, beside the model.

    Attributes:
        torque: response of the rate to the normalized torque.
        setpoint: the same to the rate set-point; None: none is logged.
        model: (N, w) of the identified vehicle at the frequencies of `torque`, then draws.
        late: s by which torques follow rates later than the loop's law says, and the standard
            deviation, infinite where that is not seen; None: filters act before the logged gyro.
    """

    torque: FrequencyResponse
    setpoint: FrequencyResponse | None
    model: Array
    late: tuple[float, float] | None = None

    def model_json(self) -> dict[str, list[float]]:
        """Arrays of the model, with the 95 % band of its draws."""
        size, nominal = np.abs(self.model), self.model[0]
        turn = np.degrees(np.angle(self.model / nominal))
        phase = np.degrees(np.unwrap(np.angle(nominal)))
        columns = {"magnitude": (size[0], size), "phase": (phase, phase + turn)}
        out = {}
        for name, (value, drawn) in columns.items():
            low, high = np.percentile(drawn, BAND, axis=0)
            for part, numbers in (("", value), ("_low", low), ("_high", high)):
                out[f"model_{name}{part}"] = numbers.tolist()
        return out


def measured_axes(
    flight: FlownSignals, dynamics: HoverDynamics, loop: RateLoop
) -> dict[str, MeasuredAxis]:
    """Roll, pitch and yaw, as far as the flight shows them."""
    found = {}
    for axis, name in enumerate(AXES):
        model = functools.partial(_response, dynamics, loop, axis)
        own = flight, axis, loop.gains[axis].attitude, loop.logged_gyro
        torque = measured_response(*own, reference=model)
        if torque is not None:
            found[name] = MeasuredAxis(
                torque,
                measured_response(*own, of="setpoint"),
                model(torque.omega),
                controller_delay(flight, loop, axis) if loop.logs_raw_gyro else None,
            )
    return found


def _response(dynamics: HoverDynamics, loop: RateLoop, axis: int, omega: Array) -> Array:
    """(N, w) of an axis."""
    return dynamics.response(omega, loop.period)[:, :, axis, axis]


def measured_response(
    flight: FlownSignals,
    axis: int,
    attitude_gain: float = 0.0,
    gyro: Callable[[Array], Array] = np.ones_like,
    *,
    reference: Callable[[Array], Array] = np.ones_like,
    of: str = "torque",
) -> FrequencyResponse | None:
    """Response of a body rate to the normalized torque, or to its set-point.

    Args:
        flight: signals.
        axis: 0 roll, 1 pitch, 2 yaw.
        attitude_gain: 1/s, of the attitude loop that makes set-points; 0: pilot's rates (Acro).
        gyro: response of the filters that the logged gyro has passed, which are taken off.
        reference: (w,) or (N, w) response of about the same slope at (w,) rad/s, such as a
            model's (of several vehicles the first).
        of: "torque" or "setpoint".

    Returns:
        None where gapless flight is too short, or nothing was asked.
    """
    T, lines = _lines(flight)
    input_ = axis if of == "torque" else 6 + axis
    asked = any(np.nan_to_num(x[:, input_]).any() for x in flight.stretches)
    if len(lines) < 2 or not asked or (of == "setpoint" and not flight.has_setpoints):
        return None
    omega = 2.0 * np.pi * lines / T
    # Where a notch leaves next to nothing, nothing is known of the rate.
    passed = np.abs(np.broadcast_to(gyro(omega), omega.shape)) > RULES.passed
    lines, omega = lines[passed], omega[passed]
    usual = np.atleast_2d(reference(omega))[0]
    late = max(-float(np.angle(usual[0] * usual[1].conj())) / (omega[0] - omega[1]), 0.0)
    shift = round(late / flight.dt)
    spectra = np.concatenate([*_spectra(flight, (input_, 3 + axis, 6 + axis), T, lines, shift)])
    u, y, z = np.moveaxis(spectra, -1, 0)
    u = u * np.exp(1j * omega * shift * flight.dt)
    y = y * _of_slope(omega, flight.dt) / gyro(omega)
    z = z / flight.hold(omega)
    u = u / flight.hold(omega) if of == "setpoint" else u
    instrument = "rate set-points" if flight.has_setpoints else ""
    if instrument and attitude_gain:
        instrument += " without the attitude loop's answer"
        z = z + attitude_gain / (1j * omega) * y
    cells = [*_cells(omega, len(spectra))]
    centers = np.array([np.exp(np.log(omega[cell]).mean()) for cell in cells])
    relative, std, count, coherence = np.array(
        [
            _ratio(*(x[:, cell].ravel() for x in (u, y / usual, z if instrument else u)))
            for cell in cells
        ]
    ).T
    at = np.atleast_2d(reference(centers))[0]
    free = (centers > attitude_gain) & bool(instrument)
    if of == "setpoint":
        free &= centers * flight.held < 2.0 * np.pi * RULES.sampled
    return FrequencyResponse(
        centers,
        at * relative,
        np.where(free, np.abs(at) * std.real, np.inf),
        2.0 * (count.real - 1.0),
        coherence.real,
        free & (coherence.real > RULES.coherence),
        instrument,
    )


def _lines(flight: FlownSignals) -> tuple[float, Array]:
    """S of pieces, and lines of their Fourier transform, the tapers' bandwidth apart."""
    T, apart = _piece(flight), round(2.0 * RULES.bandwidth)
    return T, apart * np.arange(1, int(flight.highest * T / (2.0 * np.pi * apart)) + 1)


def _of_slope(omega: Array, dt: float) -> Array:
    """(w,) a signal over its difference from the sample before, per s."""
    response: Array = dt / (1.0 - np.exp(-1j * omega * dt))
    return response


def controller_delay(flight: FlownSignals, loop: RateLoop, axis: int) -> tuple[float, float]:
    """By how much torques follow the rates of an axis later than by the law of the loop given.

    Least squares, each cell by what it leaves unexplained; errors by their scatter over cells. The
    gyro's filters are behind the log.

    Returns:
        S, and its standard deviation; infinite where it is not seen.
    """
    T, lines = _lines(flight)
    omega = 2.0 * np.pi * lines / max(T, flight.dt)
    law, _, reference = (each[:, axis] for each in loop.controllers(omega))
    unseen = 0.0, np.inf
    if not (len(lines) and loop.gains_known and flight.has_setpoints):
        return unseen
    spectra = np.concatenate([*_spectra(flight, (axis, 3 + axis, 6 + axis), T, lines, 0)])
    u, y, z = np.moveaxis(spectra, -1, 0)
    cells = [
        cell
        for cell in _cells(omega, len(spectra))
        if not flight.held or _coherence(z[:, cell], y[:, cell]) < RULES.coherence
    ]
    if len(cells) < SmoothRatio.FEWEST:
        return unseen
    parts = reference * z / flight.hold(omega), -law * _of_slope(omega, flight.dt) * y
    radian = 1.0 / omega[cells[-1].stop - 1]  # s, at most at once, for delays are linearized
    seconds, left = np.zeros(2), u
    for count in (*range(SmoothRatio.FEWEST, len(cells)), *8 * (len(cells),)):
        moved = [x * np.exp(-1j * omega * late) for x, late in zip(parts, seconds, strict=True)]
        terms = np.stack([*moved, *(-1j * omega * x for x in moved), u], -1)
        rows = []
        for cell in cells[:count]:  # the lowest first, where a long delay is no whole turn
            noise = np.mean(np.abs(left[:, cell]) ** 2) + 1e-9 * np.mean(np.abs(u[:, cell]) ** 2)
            row = terms[:, cell].reshape(-1, 5) / np.sqrt(noise or 1.0)
            rows.append(np.vstack([row.real, row.imag]))
        whole = np.vstack(rows)
        solution = np.linalg.lstsq(whole[:, :4], whole[:, 4], rcond=None)[0]
        if not (solution[0] and solution[1] > 0.0):
            return unseen
        step = np.clip(solution[2:] / solution[:2], -radian, radian)
        seconds, left = seconds + step, u - terms[..., :4] @ solution
    pulls = [row[:, :4].T @ (row[:, 4] - row[:, :4] @ solution) for row in rows]
    inverse = np.linalg.pinv(whole[:, :4].T @ whole[:, :4])
    std = float(np.linalg.norm(inverse[3] @ np.array(pulls).T) / solution[1])
    unexplained = [np.sum(np.abs(left[:, i]) ** 2) / np.sum(np.abs(u[:, i]) ** 2) for i in cells]
    # A controller has no noise of its own: what it leaves may be all of one sign.
    alike = radian * np.sqrt(np.median(unexplained))
    settled = abs(step[1]) < min(std, radian)
    late = float(seconds[1]) + 0.5 * loop.averaged
    return (late, float(np.hypot(std, alike))) if settled else unseen


def lateness(measured: Iterable[tuple[FrequencyResponse, Array, float]]) -> tuple[float, float]:
    """By how much measured responses are later than modeled, by their phase: one delay for all.

    Generalized least squares, errors of measurement and of the models together. One number of all
    frequencies needs half the coherence of each.

    Args:
        measured: with (N, w) models, the nominal one first, and 1/s: gain of an attitude loop by
            which set-points may have answered to what is not coherent, beyond what is taken out.

    Returns:
        S, and its standard deviation; infinite where too little is there.
    """
    columns = []
    for found, model, answering in measured:
        at = np.isfinite(found.std) & (found.coherence > 0.5 * RULES.coherence)
        turned = np.unwrap(np.angle(found.values[at] / model[:, at]), axis=1)
        std = found.std[at] / np.abs(found.values[at]) / np.sqrt(2.0)
        omega, biased = found.omega[at], answering * (1.0 - found.coherence[at]) / found.omega[at]
        columns.append(np.vstack([omega, std, biased, turned]))
    omega, std, biased, phase, *drawn = np.hstack(columns) if columns else np.zeros((4, 0))
    if len(omega) < SmoothRatio.FEWEST:
        return 0.0, np.inf
    errors = np.diag(std**2) + np.outer(biased, biased)
    errors += np.cov(np.array(drawn).T) if len(drawn) > 1 else 0.0
    weight = np.linalg.solve(errors, omega)
    late = -float(weight @ phase) / float(weight @ omega)
    left = phase + late * omega
    scatter = max(float(left @ np.linalg.solve(errors, left)) / (len(omega) - 1), 1.0)
    return late, float(np.sqrt(scatter / (weight @ omega)))


def _piece(flight: FlownSignals) -> float:
    """S of the longest pieces that hold most of a flight; 0: none does."""
    whole = _held(flight, flight.dt)
    return next((T for T in RULES.pieces if _held(flight, T) > 0.5 * whole), 0.0)


def _held(flight: FlownSignals, T: float) -> float:
    """S of flight in whole pieces of T s."""
    return sum(T * int(len(x) * flight.dt / T) for x in flight.stretches)


def _spectra(
    flight: FlownSignals, columns: tuple[int, int, int], T: float, lines: Array, shift: int
) -> Iterator[Array]:
    """(tapers, lines, 3) of each piece: input, slope of the rate, instrument.

    The input is `shift` samples early, so that output and input are of one time in a piece.
    """
    length = round(T / flight.dt)
    from scipy.signal.windows import dpss  # which loads much else

    tapers = dpss(length, RULES.bandwidth, round(2.0 * RULES.bandwidth) - 1)
    for stretch in flight.stretches:
        u, y, z = stretch[:, columns].astype(np.float64).T
        rows = np.stack([u[1 : len(u) - shift], np.diff(y)[shift:] / flight.dt, z[1 + shift :]], 1)
        for first in range(0, len(rows) - length + 1, length):
            piece = rows[first : first + length]
            piece = np.nan_to_num(piece - piece.mean(axis=0))
            yield np.fft.rfft(tapers[:, :, None] * piece, axis=1)[:, lines]


def _cells(omega: Array, rows: int) -> Iterator[slice]:
    """Neighboring frequencies that are averaged, from the lowest."""
    first = 0
    while first < len(omega):
        wide = round(RULES.width * omega[first] / omega[0])
        last = first + max(wide, -(-RULES.products // rows), 1)
        if last <= len(omega):
            yield slice(first, last)
        first = last


def _ratio(u: Array, y: Array, z: Array) -> tuple[complex, float, int, float]:
    """Ratio of (n,) y to u by an instrument, its standard deviation, n, and coherence."""
    n, z_u, z_y, z_z = len(z), np.vdot(z, u), np.vdot(z, y), np.vdot(z, z).real
    if not z_u or not z_y:
        return 0.0, np.inf, n, 0.0
    ratio = z_y / z_u
    e = y - ratio * u
    # A product that decides the ratio has little left in e.
    leverage = np.minimum(np.abs(z * u / z_u), 0.5)
    sandwich = np.sum(np.abs(e * z) ** 2 / (1.0 - leverage))
    variance = max(np.vdot(e, e).real / (n - 1) * z_z, sandwich) / np.abs(z_u) ** 2
    return ratio, float(np.sqrt(variance)), n, min(_coherence(z, u), _coherence(z, y))


def _coherence(x: Array, y: Array) -> float:
    """Of products of one shape."""
    return float(np.abs(np.vdot(x, y)) ** 2 / (np.vdot(x, x).real * np.vdot(y, y).real or 1.0))


class SmoothRatio:
    """Measured over modeled response as exp(a + b x + c x^2), x the logarithm of frequency.

    Complex coefficients by weighted least squares: what parts a vehicle from its model is smooth.

    Args:
        found: measured.
        model: (N, w) of that, the nominal one first.
    """

    FEWEST = 6
    """Frequencies for three coefficients."""

    def __init__(self, found: FrequencyResponse, model: Array) -> None:
        at = found.claimed
        self._from, self._to = found.omega[at][[0, -1]]
        self.omega = np.geomspace(self._from, self._to, 100)
        weight = np.abs(found.values[at]) / found.std[at]
        X = self._powers(found.omega[at]) * weight[:, None]
        solve = np.linalg.pinv(X) * weight
        ratios = np.concatenate([found.values[None, at], model[1:, at]]) / model[0, at]
        logs = np.log(np.abs(ratios)) + 1j * np.unwrap(np.angle(ratios), axis=1)
        self._coefficients, *draws = (solve @ row for row in logs)
        own = np.linalg.inv(X.T @ X)
        self._root = np.linalg.cholesky(0.5 * own)
        self._covariance = np.kron(np.eye(2), 0.5 * own)
        if len(draws) > 1:
            self._covariance += np.cov(np.hstack([np.real(draws), np.imag(draws)]).T)

    def _powers(self, omega: Array) -> Array:
        return np.vander(np.log(omega / self._from), 3)

    def drawn(self, count: int) -> Array:
        """(1 + count, w) ratios at `omega`, the estimate first, then with errors of that."""
        normal = np.random.default_rng(1).standard_normal((2, 3, count))
        errors = np.hstack([np.zeros((3, 1)), self._root @ (normal[0] + 1j * normal[1])])
        return np.exp(self._powers(self.omega) @ (self._coefficients[:, None] + errors)).T

    def departure(self, of: Array | float = 1.0) -> tuple[float, float, float]:
        """By how much measured and modeled response part, as a share, where that is surest.

        Args:
            of: the modeled response at `omega`, for a share of the input; 1: of the response.

        Errors of both count; the band holds at all frequencies of all axes together (Scheffe 1959,
        The Analysis of Variance, ch. 3), but for the false-alarm rate.

        Returns:
            The share, its lower bound (below 0: they may agree), and the frequency, rad/s.
        """
        powers = self._powers(self.omega)
        off = powers @ self._coefficients
        size = np.abs(off)
        towards = off / np.maximum(size, 1e-12)
        combined = np.hstack([powers * towards.real[:, None], powers * towards.imag[:, None]])
        std = np.sqrt(np.sum(combined @ self._covariance * combined, axis=1))
        least = size - np.sqrt(chdtri(6, FALSE_ALARM_RATE / len(AXES))) * std
        size, least = size * np.abs(of), least * np.abs(of)
        at = int(np.argmax(least))
        return float(size[at]), float(least[at]), float(self.omega[at])


def smooth_ratio(found: FrequencyResponse | None, model: Array | None) -> SmoothRatio | None:
    """That of an axis; None where too little is claimed."""
    if found is None or model is None or found.claimed.sum() < SmoothRatio.FEWEST:
        return None
    return SmoothRatio(found, model)


def measured_margins(
    one: MeasuredAxis, dynamics: HoverDynamics, loop: RateLoop, axis: int
) -> Margins | None:
    """Margins of an axis by its measured response: the estimate, then draws of its errors.

    The smooth ratio is taken times the model's response, with the loop's controllers.

    Returns:
        None where what is claimed does not reach the crossover.
    """
    smooth = smooth_ratio(one.torque, one.model)
    if smooth is None:
        return None
    own = loop.feedback(smooth.omega)[:, axis]
    own = own * dynamics.first(1).response(smooth.omega, loop.period)[0, :, axis, axis]
    margins = margins_of(smooth.omega, own * smooth.drawn(100))
    return margins if np.isfinite(margins.crossover[0]) else None


@dataclass(frozen=True)
class Replay:
    """A flight's rate set-points through the loop that flew and through another, of N vehicles.

    What the loop that flew does not answer to set-points, as in gusts, comes once more: behind the
    other loop it is larger by the ratio of their sensitivities.

    Attributes:
        seconds: of flight.
        highest: rad/s, up to which.
        error: "flown", "now", "then" -> (N, 3) rms of set-points less body rates, rad/s: measured,
            by the loop that flew without anything but set-points, and by the other. "left": rms
            of the rates measured less those by the loop that flew.
        limit: (2, N) share of time with a rotor's command at 0 or full, flown and then; None: the
            log has no commands.
        t: (k,) s, of the liveliest piece.
        shown: "setpoint", "flown", "now" -> (k, 3) rad/s of that; "then" -> (N, k, 3).
    """

    seconds: float
    highest: float
    error: dict[str, Array]
    limit: Array | None
    t: Array
    shown: dict[str, Array]

    def lines(self, axis: int) -> dict[str, Array]:
        """What is shown of an axis by name, each (k,): "then" of the nominal vehicle, and its
        band, "then_low" and "then_high".
        """
        lines = {name: values[..., axis] for name, values in self.shown.items()}
        low, high = np.percentile(lines["then"], BAND, axis=0)
        return lines | {"then": lines["then"][0], "then_low": low, "then_high": high}


def replay(
    flight: FlownSignals,
    now: tuple[HoverDynamics, RateLoop],
    then: tuple[HoverDynamics, RateLoop],
    highest: float,
) -> Replay | None:
    """Fly the log's rate set-points, disturbed as it was, with another loop or vehicle.

    Args:
        flight: signals, with set-points.
        now: vehicles and loop that flew.
        then: the same vehicles, changed, and the loop to try.
        highest: rad/s, up to which motion counts.

    Returns:
        None where gapless flight is too short.
    """
    T, dt = _piece(flight), flight.dt
    highest = min(highest, flight.highest, 2.0 * np.pi * RULES.sampled / max(flight.held, dt))
    count = int(highest * T / (2.0 * np.pi))
    if not count:
        return None
    omega = 2.0 * np.pi / T * np.arange(1, count + 1)
    n, points, size = round(T / dt), 4 * len(omega), len(omega) + 1
    starts = ((x, i) for x in flight.stretches for i in range(0, len(x) - n + 1, n // 2))
    pieces = np.array([x[i : i + n] for x, i in starts])
    # What a piece's Fourier series has before its begin is its end: the middle is free of that.
    middle = slice(points // 4, 3 * points // 4)

    def in_time(lines: Array) -> Array:
        whole = np.fft.irfft(np.insert(lines, 0, 0.0, axis=-2), points, axis=-2)
        return whole[..., middle, :] * (points / n)

    spectra = np.fft.rfft(pieces[:, :, 3:9].astype(np.float64), axis=1)[:, 1:size]
    passed = now[1].logged_gyro(omega)[:, None]
    spectra[:, np.abs(passed[:, 0]) < RULES.passed] = 0.0  # a notch leaves next to nothing
    Y, R = spectra[..., :3] / passed, spectra[..., 3:] / flight.hold(omega)[:, None]
    (T0, S0), (T1, S1) = (closed_loops(*each, omega) for each in (now, then))
    worse = S1 @ np.linalg.inv(S0)
    (H0, _, F0), (H1, _, F1) = (loop.controllers(omega) for _, loop in (now, then))
    places = (np.arange(points)[middle] * n) // points
    thrust = pieces[:, places, 9:] if pieces.shape[-1] > 9 else np.full((1, 1, 1), np.nan)
    wanted, flown = in_time(R), in_time(Y)
    lively = int(np.argmax(np.sum((wanted / (wanted.std((0, 1)) + 1e-9)) ** 2, axis=(1, 2))))
    # What another weight or battery takes besides, in proportion to the lift at that time.
    load = (then[0].hover - now[0].hover) / now[0].hover.mean(axis=1, keepdims=True)
    lift = thrust.mean(axis=-1, keepdims=True)
    rows, limits, answers, others = [], [], [], []
    for i in range(len(load)):
        answer = np.einsum("wij,pwj->pwi", T0[i], R)
        other = np.einsum("wij,pwj->pwi", T1[i], R)
        other = other + np.einsum("wij,pwj->pwi", worse[i], Y - answer)
        more = in_time(F1 * R - H1 * other - F0 * R + H0 * Y) @ then[1].mixer.T
        first, second = in_time(answer), in_time(other)
        parts = (wanted - flown, wanted - first, wanted - second, flown - first)
        rows.append([np.sqrt(np.mean(each**2, axis=(0, 1))) for each in parts])
        limits.append([_limited(thrust), _limited(thrust + lift * load[i] + more)])
        answers.append(first[lively])
        others.append(second[lively])
    error = dict(
        zip(("flown", "now", "then", "left"), np.moveaxis(np.array(rows), 1, 0), strict=True)
    )
    limit = np.array(limits).T if np.isfinite(thrust).all() else None
    picture = {"setpoint": wanted[lively], "flown": flown[lively], "now": answers[0]}
    t = T / points * np.arange(wanted.shape[1])
    seconds = len(pieces) * 0.5 * T
    return Replay(seconds, highest, error, limit, t, picture | {"then": np.array(others)})


def _limited(thrust: Array) -> float:
    """Share of time with any of (..., rotors) thrust commands at an end, to rounding."""
    return float(np.mean(np.any(np.abs(thrust - 0.5) > 0.498, axis=-1)))
