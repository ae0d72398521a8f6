"""What a practitioner would do with the same signals in an afternoon.

Savitzky-Golay filters of 0.1 s smooth the rates and differentiate them; thrust is k_T Omega^2 with
one k_T from the accelerometer and the weighed mass (of commands, u^2 for Omega^2), at once, without
lag; least squares on Euler's equations; intervals as if the residuals were white. It determines Ixx
and Iyy: in yaw, with k_M unknown, the equation's right side is zero and noise pulls Izz there.
"""

import numpy as np
from scipy.signal import savgol_filter

from gcs_sysid.arrays import Array
from gcs_sysid.intervals import Z95
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.session.chain import Chain
from gcs_sysid.signals.sampling import SampleBlock

WINDOW = 0.1
"""s of the filters."""
NAMES = ("Ixx", "Iyy")


class Onlooker:
    """Keeps the aligned samples that the program's own chain makes of a log."""

    def __init__(self) -> None:
        self.blocks: list[SampleBlock] = []

    def begin(self) -> None:
        """Reset: the log is read again."""
        self.blocks = []

    def take(self, block: SampleBlock) -> None:
        """Keep a block."""
        self.blocks.append(block)

    def end(self, chain: Chain) -> None:
        """Nothing more."""


def estimate(blocks: list[SampleBlock], airframe: Airframe) -> dict[str, tuple[float, float]]:
    """Ixx and Iyy with half widths of their 95 % intervals; empty where nothing flew."""
    parts = [
        (b.samples.rates[b.flying], b.samples.speeds[b.flying], b.samples.force[b.flying])
        for b in blocks
        if b.flying.any() and b.samples.speeds.shape[1] == len(airframe.rotors)
    ]
    if not parts or airframe.mass is None:
        return {}
    rates, speeds, force = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    known = np.isfinite(np.column_stack([rates, speeds, force])).all(axis=1)
    rates, speeds, force = rates[known], speeds[known], force[known]
    return fit(rates, speeds, force, blocks[0].dt, airframe.geometry, airframe.mass)


def fit(
    rates: Array, speeds: Array, force: Array, dt: float, geometry: Array, mass: float
) -> dict[str, tuple[float, float]]:
    """The same from arrays.

    Args:
        rates: (n, 3) rad/s.
        speeds: (n, rotors) rad/s, or commands.
        force: (n, 3) specific force, m/s^2.
        dt: s from sample to sample.
        geometry: (3, rotors) x, y, spin.
        mass: kg.
    """
    length = max(5, round(WINDOW / dt) | 1)
    if len(rates) < 10 * length:
        return {}
    rotors, _ = rb.rotor_signals(geometry, speeds)
    smooth = savgol_filter(rates, length, 3, axis=0)
    turning = savgol_filter(rates, length, 3, deriv=1, delta=dt, axis=0)
    rotors = savgol_filter(rotors, length, 3, axis=0)
    total = rotors[:, 2]
    k_T = -mass * float(force[:, 2] @ total) / float(total @ total)
    phi, y = rb.direct_rows(smooth, turning, rotors)
    x = phi.reshape(-1, 9)
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    found, _, rank, _ = np.linalg.lstsq(x / size, y.ravel(), rcond=None)
    if rank < 9:
        return {}
    residual = y.ravel() - x / size @ found
    covariance = np.linalg.inv((x / size).T @ (x / size)) * float(np.mean(residual**2))
    value: Array = k_T * found / size
    half: Array = Z95 * abs(k_T) * np.sqrt(np.diag(covariance)) / size
    return {n: (float(value[i]), float(half[i])) for i, n in enumerate(NAMES)}
