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

What is averaged over a cell is the response over a reference's, whose slope is then no error.
"""

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri, stdtrit

from gcs_sysid.arrays import Array, Mask, complete_rows, runs
from gcs_sysid.control.loop_margins import HoverDynamics, Margins, margins_of
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


@dataclass(frozen=True)
class FlownSignals:
    """Gapless stretches of flight.

    Attributes:
        stretches: each (n, 9): normalized torques, body rates and rate set-points, rad/s; NaN where
            no set-point is logged.
        dt: s.
        highest: rad/s, up to which commands and rates are sampled well enough.
    """

    stretches: tuple[Array, ...]
    dt: float
    highest: float

    @property
    def has_setpoints(self) -> bool:
        """Whether set-points are logged all along."""
        return all(np.isfinite(x[:, 6:]).all() for x in self.stretches)


def flown_signals(blocks: Iterable[SampleBlock], loop: RateLoop) -> FlownSignals | None:
    """What a log holds of commands and rates; None: no flight with commands.

    Args:
        blocks: of the log, with commands for rotors.
        loop: whose mixer and thrust curve make commands of normalized torques.
    """
    gap = np.full((1, 9), np.nan, np.float32)
    kept: list[Array] = []
    dt = interval = 0.0
    inverse = np.linalg.pinv(np.column_stack([loop.mixer, np.ones(len(loop.mixer))]))[:3]
    for block in blocks:
        if block.rotors is None or not block.rotors.kind.motors:
            continue
        if block.dt != dt:  # estimates are of the last grid, too
            kept, dt = [], block.dt
        interval = max(block.dt, block.rotors.interval)
        s = block.samples
        thrust = (1.0 - loop.curve) * s.speeds + loop.curve * s.speeds**2
        rows = np.column_stack([thrust @ inverse.T, s.gyro, s.setpoint]).astype(np.float32)
        kept += [gap, rows] if block.fresh else [rows]
    if not kept:
        return None
    whole = np.concatenate(kept)
    parts = tuple(whole[part] for part, there in runs(complete_rows(whole[:, :6])) if there)
    return FlownSignals(parts, dt, 2.0 * np.pi * RULES.sampled / interval) if parts else None


@dataclass(frozen=True)
class FrequencyResponse:
    """Measured response at frequencies whose errors are independent.

    Attributes:
        omega: (w,) rad/s.
        values: (w,) complex.
        std: (w,) sqrt(E|error|^2) of these.
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
    """

    torque: FrequencyResponse
    setpoint: FrequencyResponse | None
    model: Array

    def model_json(self) -> dict[str, list[float]]:
        """Arrays of the model, with the 95 % band of its draws."""
        size, nominal = np.abs(self.model), self.model[0]
        turn = np.degrees(np.angle(self.model / nominal))
        phase = np.degrees(np.unwrap(np.angle(nominal)))
        columns = {"magnitude": (size[0], size), "phase": (phase, phase + turn)}
        out = {}
        for name, (value, drawn) in columns.items():
            low, high = np.percentile(drawn, (2.5, 97.5), axis=0)
            for part, numbers in (("", value), ("_low", low), ("_high", high)):
                out[f"model_{name}{part}"] = numbers.tolist()
        return out


def measured_axes(
    flight: FlownSignals,
    dynamics: HoverDynamics,
    loop: RateLoop,
    gyro: Callable[[Array], Array] = np.ones_like,
) -> dict[str, MeasuredAxis]:
    """Roll, pitch and yaw, as far as the flight shows them.

    Args:
        flight: signals.
        dynamics: identified.
        loop: that flew.
        gyro: as of `measured_response`.
    """
    found = {}
    for axis, name in enumerate(AXES):
        model = functools.partial(_response, dynamics, loop, axis)
        own = flight, axis, loop.gains[axis].attitude, gyro
        torque = measured_response(*own, reference=model)
        if torque is not None:
            found[name] = MeasuredAxis(
                torque, measured_response(*own, of="setpoint"), model(torque.omega)
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
    T = next((T for T in RULES.pieces if _held(flight, T) > 0.5 * _held(flight, flight.dt)), 0.0)
    # Lines of a piece's Fourier transform, the tapers' bandwidth apart.
    apart = round(2.0 * RULES.bandwidth)
    lines = apart * np.arange(1, int(flight.highest * T / (2.0 * np.pi * apart)) + 1)
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
    y = y * flight.dt / (1.0 - np.exp(-1j * omega * flight.dt)) / gyro(omega)
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
    claimed = (coherence.real > RULES.coherence) & (centers > attitude_gain) & bool(instrument)
    return FrequencyResponse(
        centers,
        at * relative,
        np.abs(at) * std.real,
        2.0 * (count.real - 1.0),
        coherence.real,
        claimed,
        instrument,
    )


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
    shared = (np.abs(p) ** 2 / (z_z * np.vdot(x, x).real) for p, x in ((z_u, u), (z_y, y)))
    return ratio, float(np.sqrt(variance)), n, float(min(shared))


class SmoothRatio:
    """Measured over modeled response as exp(a + b x + c x^2), x the logarithm of frequency.

    Complex coefficients by weighted least squares: what parts a vehicle from its model is smooth.

    Args:
        one: of an axis.
    """

    FEWEST = 6
    """Frequencies for three coefficients."""

    def __init__(self, one: MeasuredAxis) -> None:
        found, at = one.torque, one.torque.claimed
        self._from, self._to = found.omega[at][[0, -1]]
        self.omega = np.geomspace(self._from, self._to, 100)
        weight = np.abs(found.values[at]) / found.std[at]
        X = self._powers(found.omega[at]) * weight[:, None]
        solve = np.linalg.pinv(X) * weight
        ratios = np.concatenate([found.values[None, at], one.model[1:, at]]) / one.model[0, at]
        logs = np.log(np.abs(ratios)) + 1j * np.unwrap(np.angle(ratios), axis=1)
        self._coefficients, *draws = (solve @ row for row in logs)
        own = np.linalg.inv(X.T @ X)
        self._root = np.linalg.cholesky(0.5 * own)
        self._covariance = np.kron(np.eye(2), 0.5 * own)
        if len(draws) > 1:
            self._covariance += np.cov(np.hstack([np.real(draws), np.imag(draws)]).T)

    def _powers(self, omega: Array) -> Array:
        return np.vander(np.log(omega / self._from), 3)

    def drawn(self, count: int, seed: int) -> Array:
        """(1 + count, w) ratios at `omega`, the estimate first, then with errors of the measured.

        Args:
            count: of draws.
            seed: of these.
        """
        normal = np.random.default_rng(seed).standard_normal((2, 3, count))
        errors = np.hstack([np.zeros((3, 1)), self._root @ (normal[0] + 1j * normal[1])])
        return np.exp(self._powers(self.omega) @ (self._coefficients[:, None] + errors)).T

    def departure(self) -> tuple[float, float, float]:
        """By how much measured and modeled response part, as a share, where that is surest.

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
        at = int(np.argmax(least))
        return float(size[at]), float(least[at]), float(self.omega[at])


def smooth_ratio(one: MeasuredAxis) -> SmoothRatio | None:
    """That of an axis; None where too little is claimed."""
    return SmoothRatio(one) if one.torque.claimed.sum() >= SmoothRatio.FEWEST else None


def measured_margins(
    one: MeasuredAxis, dynamics: HoverDynamics, loop: RateLoop, axis: int, seed: int = 1
) -> Margins | None:
    """Margins of an axis by its measured response: the estimate, then draws of its errors.

    Args:
        one: of the axis.
        dynamics: the model, whose response times the smooth ratio is taken.
        loop: whose controllers are around the vehicle.
        axis: 0 roll, 1 pitch, 2 yaw.
        seed: of the draws.

    Returns:
        None where what is claimed does not reach the crossover.
    """
    smooth = smooth_ratio(one)
    if smooth is None:
        return None
    rate, angle, _ = loop.controllers(smooth.omega)
    own = (rate + angle / (1j * smooth.omega[:, None]))[:, axis]
    own = own * dynamics.first(1).response(smooth.omega, loop.period)[0, :, axis, axis]
    margins = margins_of(smooth.omega, own * smooth.drawn(100, seed))
    return margins if np.isfinite(margins.crossover[0]) else None
