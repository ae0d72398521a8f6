"""Recorded flights thinned to 50 Hz: errors over many thinnings, and the least they can be.

    python -m benchmarks.thinned FOLDER [--thinnings N]

thins every .tlog with a .truth.json to a fifth, each time at another phase and with another 5 % of
all messages lost, and prints mean, root-mean-square and largest error of each parameter, the mean
half width of its interval, and how many of them hold the truth. Products of inertia are in
1e-4 kg m^2, all else is in %.

Where commands are the input, a bound stands beside it. What was commanded between two samples is
not known; what it does to the angular acceleration is found from the whole log, and taken for
noise of that spectrum, as is the gyro's noise, sampled at 50 Hz. Cramér-Rao's bound in noise of
known spectra (Whittle's form) is what no unbiased estimator beats that has one stream of commands,
even with no message lost. PX4 sends two, and both are used.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt, welch

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.intervals import Z95
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock
from testbed.recordings import airframe_of, thinned, truth_of
from testbed.study import arguments

PRODUCTS = ("Ixy", "Iyz", "Ixz")
SHOWN = (
    "Ixx", "Iyy", "Izz", *PRODUCTS, "moment_ratio", "rotational_damping", "T_max", "motor_lag",
)  # fmt: skip
FIFTH = 5
_BAND = (0.05, 20.0)
"""Hz, band in which the flight has information."""
_MOTION = 12.0
"""Hz; the vehicle moves below, and what the gyro shows above is noise."""


class Watched:
    """Keeps the samples of an analysis."""

    def __init__(self) -> None:
        self.blocks: list[SampleBlock] = []

    def begin(self) -> None:
        """A reading of the log begins."""
        self.blocks.clear()

    def take(self, block: SampleBlock) -> None:
        """The next block."""
        self.blocks.append(block)

    def end(self, chain: Chain) -> None:
        """All is read."""

    def longest(self) -> tuple[Array, Array, float]:
        """(n, 3) gyro in rad/s and (n, rotors) commands while it flew, and the step in s."""
        gyro, commands, flying = (
            np.concatenate(parts)
            for parts in zip(
                *((b.samples.gyro, b.samples.speeds, b.flying) for b in self.blocks), strict=True
            )
        )
        there = complete_rows(np.column_stack([gyro, commands])) & flying
        edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]])))
        begin, end = max(edges.reshape(-1, 2), key=lambda run: run[1] - run[0])
        return gyro[begin:end], commands[begin:end], self.blocks[0].dt


def true_theta(truth: dict[str, float]) -> Array:
    """(N_THETA,) relative to T_max."""
    return rb.theta_of({**truth, "rotor_inertia": 0.0}, truth["T_max"])


def acceleration(
    theta: Array, lag: float, rates: Array, commands: Array, geometry: Array, dt: float
) -> Array:
    """(n, 3) rad/s^2 of a linear thrust curve behind a motor of first order."""
    a = np.exp(-dt / lag)
    w = lfilter([1.0 - a], [1.0, -a], commands - commands[0], axis=0) + commands[0]
    H = np.sqrt(np.clip(w, 0.0, None)) @ geometry[2]
    turning = [rates[:, 1] * H, rates[:, 0] * H, np.gradient(H, dt)]
    x = np.column_stack([w @ rb.mixer(geometry), rb.rate_signals(rates), *turning])
    out: Array = x @ rb.forward_matrix(theta).T
    return out


def bound(
    gyro: Array, commands: Array, dt: float, geometry: Array, truth: dict[str, float]
) -> Array:
    """(N_THETA + 1,) least standard deviations of theta and the lag at a fifth of the rate."""
    theta, lag = true_theta(truth), truth["motor_lag"]
    low_pass = butter(4, _MOTION, fs=1.0 / dt, output="sos")
    rates = sosfiltfilt(low_pass, gyro, axis=0)
    n = len(rates)
    # The gyro's noise sampled at a fifth of the rate folds into its band: its variance counts.
    gyro_power = 2.0 * np.var(gyro - rates, axis=0) * FIFTH * dt
    known = np.column_stack(
        [np.interp(np.arange(n), np.arange(0, n, FIFTH), u) for u in commands[::FIFTH].T]
    )
    still = np.zeros_like(rates)
    made = (acceleration(theta, lag, still, u, geometry, dt) for u in (commands, known))
    missed = np.subtract(*made)
    f_missed, missed_power = welch(missed - missed.mean(axis=0), 1.0 / dt, nperseg=1024, axis=0)
    steps = np.append(1e-3 * np.maximum(np.abs(theta), 1e-3), 1e-3 * lag)
    slopes = []
    for i, step in enumerate(steps):
        move = step * (np.arange(len(steps)) == i)
        more, less = (
            acceleration(theta + s * move[:-1], lag + s * move[-1], rates, commands, geometry, dt)
            for s in (0.5, -0.5)
        )
        slopes.append((more - less) / step)
    f = np.fft.rfftfreq(n, dt)
    spectra = np.fft.rfft(np.array(slopes) - np.mean(slopes, axis=1, keepdims=True), axis=1) * dt
    inside = (f > _BAND[0]) & (f < _BAND[1])
    information = np.zeros((len(steps), len(steps)))
    for axis in range(3):
        noise = np.interp(f, f_missed, missed_power[:, axis])
        noise += gyro_power[axis] * (2.0 * np.pi * f) ** 2
        part = spectra[:, inside, axis]
        # One-sided spectra: twice for the other side, and half of the density is on each.
        information += 4.0 / (n * dt) * ((part / noise[inside]) @ part.conj().T).real
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    least: Array = np.sqrt(np.diag(covariance))
    return least


def main() -> None:
    """Thin and analyse a folder."""
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--thinnings", type=int, default=20, metavar="N")
    options = parser.parse_args()
    logs = [
        p for p in sorted(options.folder.glob("*.tlog")) if p.with_suffix(".truth.json").exists()
    ]
    if not logs:
        sys.exit(f"{options.folder}: no .tlog with a .truth.json beside it")
    for log in logs:
        truth = truth_of(log)
        airframe = airframe_of(log).with_anchor("mass", truth["mass"])
        watched = Watched()
        whole = analyze_log(log, airframe, observer=watched)
        least: dict[str, float] = {}
        if whole.rotor_input.motors:
            std = bound(*watched.longest(), airframe.geometry, truth)
            true = np.append(true_theta(truth), truth["motor_lag"])
            shares = 100.0 * std / np.maximum(np.abs(true), 1e-12)
            least = dict(zip((*rb.THETA, "motor_lag"), shares.tolist(), strict=True))
        errors: dict[str, list[tuple[float, float]]] = {}
        with tempfile.TemporaryDirectory() as folder:
            for seed in range(1, options.thinnings + 1):
                result = analyze_log(thinned(log, Path(folder) / log.name, seed), airframe)
                for name, found in {**result.parameters, **result.timing}.items():
                    if name in SHOWN and name in truth and found.value and found.std:
                        share = 1e4 if name in PRODUCTS else 100.0 / truth[name]
                        told = share * (found.value - truth[name]), Z95 * share * found.std
                        errors.setdefault(name, []).append(told)
        print(f"{log.name}: rotors by {whole.rotor_input}, {options.thinnings} thinnings")
        columns = "".join(f"{column:>8}" for column in ("mean", "rms", "worst", "+-95 %", "hold"))
        print(f"  {'':<20}{columns}   Cramer-Rao std")
        for name, pairs in errors.items():
            error, half = np.array(pairs).T
            rms, hold = np.sqrt(np.mean(error**2)), np.mean(np.abs(error) <= half)
            known = f"{least[name]:8.2f}" if name in least and name not in PRODUCTS else ""
            row = f"{error.mean():8.2f}{rms:8.2f}{np.abs(error).max():8.2f}{half.mean():8.2f}"
            print(f"  {name:<20}{row}{100 * hold:7.0f} %   {known}", flush=True)


if __name__ == "__main__":
    main()
