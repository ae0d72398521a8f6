"""Vibration at the frequency of each rotor, from the accelerometer and measured speeds.

An unbalanced or bent propeller shakes at the rotor's own frequency. Over short stretches the
specific force is correlated with exp(-j phi), phi the integral of the rotor's speed: what hangs
together with the rotor's phase stays, and what other rotors and the air do averages out to the
level of neighboring frequencies, which is taken off.
"""

import math

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.health.balance import Quantity
from gcs_sysid.health.hover import Windows
from gcs_sysid.health.log_streams import Streams
from gcs_sysid.signals.records import Stream

_STRETCH = 0.5
"""s; a speed off by 0.1 % turns the phase of 100 Hz by 0.3 rad meanwhile."""
_BESIDE = (-12.0, -8.0, 8.0, 12.0)
"""Hz off the rotor's frequency, where the floor is taken."""
_NYQUIST = 0.9
"""Share of half of the IMU's rate below which a rotor's frequency is seen."""
_FEWEST = 10
_AT_ONCE = 64
"""Stretches worked on together."""


def vibration_of(streams: Streams, windows: Windows) -> tuple[Quantity | None, ...]:
    """Amplitude of specific force at each rotor's frequency in hover, m/s^2, rms over the axes.

    None for rotors whose frequency the IMU's rate does not show, or without measured speeds.

    Args:
        streams: of the log.
        windows: of hover.
    """
    if streams.speeds is None or Stream.IMU not in streams.tracks:
        return tuple([None] * windows.speeds.shape[1])
    t, imu = streams.tracks[Stream.IMU]
    rate = streams.rate(Stream.IMU)
    found: list[Quantity | None] = []
    for times, speeds in streams.speeds.samples:
        phase = np.interp(
            t,
            times,
            np.concatenate([[0.0], np.cumsum(0.5 * np.diff(times) * (speeds[1:] + speeds[:-1]))]),
        )
        squares = _squares_of(t, imu[:, 3:6], phase, windows.t, rate)
        if len(squares) < _FEWEST:
            found.append(None)
            continue
        mean = float(np.mean(squares))
        std = float(np.std(squares)) / math.sqrt(len(squares))
        amplitude = math.sqrt(max(mean, 0.0))
        found.append(Quantity(amplitude, std / (2.0 * max(amplitude, math.sqrt(std))), "m/s^2"))
    return tuple(found)


def _squares_of(t: Array, force: Array, phase: Array, centers: Array, rate: float) -> list[float]:
    """Squared amplitudes at a rotor's frequency above the floor, of stretches that show it.

    Args:
        t: (n,) s, of the IMU.
        force: (n, 3) m/s^2.
        phase: (n,) rad, of the rotor.
        centers: s, of stretches.
        rate: Hz, of the IMU.
    """
    firsts = np.searchsorted(t, centers - 0.5 * _STRETCH)
    counts = np.searchsorted(t, centers + 0.5 * _STRETCH) - firsts
    out = np.full(len(centers), np.nan)
    offsets = np.array((0.0, *_BESIDE))[:, None]
    for count in np.unique(counts[counts >= max(0.8 * _STRETCH * rate, 3)]).tolist():
        taper = np.hanning(count)
        scale = 4.0 / float(taper.sum()) ** 2
        alike = np.flatnonzero(counts == count)
        for start in range(0, len(alike), _AT_ONCE):
            some = alike[start : start + _AT_ONCE]
            rows = firsts[some, None] + np.arange(count)
            parts, turned, times = force[rows], phase[rows], t[rows]
            own = (turned[:, -1] - turned[:, 0]) / (times[:, -1] - times[:, 0]) / (2.0 * math.pi)
            seen = np.isfinite(parts).all(axis=(1, 2))
            seen &= (own > 5.0) & (own < 0.5 * _NYQUIST * rate - _BESIDE[-1])
            some, parts, turned, times = some[seen], parts[seen], turned[seen], times[seen]
            parts = (parts - parts.mean(axis=1, keepdims=True)) * taper[:, None]
            moment = times - times[:, :1]
            turns = turned[:, None] + 2.0 * math.pi * offsets * moment[:, None]
            carrier = np.exp(-1j * turns)  # (some, offsets, count)
            swung = (parts[:, None] * carrier[..., None]).sum(axis=2)
            level = (np.abs(swung) ** 2).sum(axis=2)
            out[some] = scale * (level[:, 0] - np.median(level[:, 1:], axis=1))
    found: list[float] = out[np.isfinite(out)].tolist()
    return found
