"""Vibration at the frequency of each rotor, from the accelerometer and measured speeds.

An unbalanced or bent propeller shakes at the rotor's own frequency. Over short stretches the
specific force is correlated with exp(-j phi), phi the integral of the rotor's speed: what hangs
together with the rotor's phase stays, and what other rotors and the air do averages out to the
level of neighboring frequencies, which is taken off.
"""

import math

import numpy as np

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
        squares = []
        for center in windows.t[::1]:
            first, last = np.searchsorted(t, (center - 0.5 * _STRETCH, center + 0.5 * _STRETCH))
            force = imu[first:last, 3:6]
            if last - first < 0.8 * _STRETCH * rate or not np.isfinite(force).all():
                continue
            turned = phase[first:last]
            own = (turned[-1] - turned[0]) / (t[last - 1] - t[first]) / (2.0 * math.pi)
            if not 5.0 < own < 0.5 * _NYQUIST * rate - _BESIDE[-1]:
                continue
            taper = np.hanning(last - first)[:, None]
            force = (force - force.mean(axis=0)) * taper
            moment = t[first:last] - t[first]
            level = [
                float(
                    (
                        np.abs(
                            (
                                force
                                * np.exp(-1j * (turned + 2.0 * math.pi * off * moment))[:, None]
                            ).sum(axis=0)
                        )
                        ** 2
                    ).sum()
                )
                for off in (0.0, *_BESIDE)
            ]
            scale = 4.0 / float(taper.sum()) ** 2
            squares.append(scale * (level[0] - float(np.median(level[1:]))))
        if len(squares) < _FEWEST:
            found.append(None)
            continue
        mean = float(np.mean(squares))
        std = float(np.std(squares)) / math.sqrt(len(squares))
        amplitude = math.sqrt(max(mean, 0.0))
        found.append(Quantity(amplitude, std / (2.0 * max(amplitude, math.sqrt(std))), "m/s^2"))
    return tuple(found)
