"""Pressure that a barometer reads for the rotors' thrust, with the accelerometer for the height.

Of P = P_0 - rho g h + k u, u the thrust of all rotors over full thrust, second differences over S,
x(t + S) - 2 x(t) + x(t - S), of the height are S^2 times the mean of h'' with the triangle that is
2 S wide. An accelerometer's bias is their constant, the air's density is known within errors, and
what delays or climb rates do goes with the derivative of h''. Heights of an EKF are no reference:
they follow the barometer. ArduPilot takes k u off the pressure (AP_Baro, BARO1_THST_SCALE), PX4
adds its height (VehicleAirData, SENS_BARO_K_T).
"""

from dataclasses import dataclass

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.health.balance import robust_fit
from gcs_sysid.health.command_curve import gentle_of, thrust_of
from gcs_sysid.health.hover import Windows, windowed_means
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.log_streams import Streams
from gcs_sysid.model.estimate import Quantity
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.records import Stream
from gcs_sysid.significance import normal_limit


@dataclass(frozen=True)
class ThrustPressure:
    """What thrust does to a barometer.

    Attributes:
        full: k, Pa at full thrust.
        meter: Pa, of a meter of the standard atmosphere at this pressure.
    """

    full: Quantity
    meter: float


def thrust_pressure(streams: Streams, windows: Windows, c: float) -> ThrustPressure | None:
    """By climbs and descents; None without pressure, attitude, or thrust that changes.

    Args:
        streams: of the log.
        windows: all those in flight.
        c: of the thrust curve that the autopilot inverts.
    """
    if "pressure" not in streams.extras or Stream.ATTITUDE not in streams.tracks:
        return None

    def means(t: Array, values: Array) -> Array:
        return windowed_means(t, values, windows.t, windows.half)

    def extra(name: str) -> Array:
        t, first = np.unique(streams.extras[name][0] - streams.flight.start, return_index=True)
        return means(t, streams.extras[name][1].reshape(-1, 1)[first])[:, 0]

    t, (w, x, y, z) = streams.tracks[Stream.ATTITUDE][0], streams.tracks[Stream.ATTITUDE][1].T
    down = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    up = -np.sum(means(t, down) * windows.force, axis=1) - GRAVITY
    thrust = thrust_of(windows, c).mean(axis=1)
    thrust = extra("throttle") if "throttle" in streams.extras else thrust
    signals = np.column_stack([extra("pressure"), up, thrust])
    of_air = (signals[:, 0] > TUNING.air_pressure[0]) & (signals[:, 0] < TUNING.air_pressure[1])
    signals[windows.idle | ~gentle_of(windows) | ~of_air] = np.nan
    there = complete_rows(signals)
    if not there.any() or np.std(signals[there, 2]) < TUNING.least_throttle_motion:
        return None
    # Windows lie at multiples of half their width; those on the ground are left out.
    places = np.round(windows.t / windows.half).astype(int)
    even = np.full((places.max() + 1, 3), np.nan)
    even[places] = signals
    pressure = float(signals[there, 0].mean())
    meter = GRAVITY * pressure / (287.05 * 288.15 * (pressure / 101325.0) ** 0.190263)
    found = [_fitted(even, meter, windows.half, span) for span in TUNING.pressure_spans]
    if None in found:
        return None
    long, short = (each for each in found if each is not None)
    # Air takes its time: what acts at once is not all of it.
    doubt = np.hypot(long.value - short.value, TUNING.pressure_floor)
    return ThrustPressure(long.off_by(given=float(doubt)), meter)


def _fitted(even: Array, meter: float, half: float, span: float) -> Quantity | None:
    """Of (n, 3) pressure, vertical acceleration and thrust, half s apart; None: not shown."""
    m = max(round(span / half), 1)
    # Differences are of means: the triangle of these once more, by its second moment.
    weights = np.convolve(m - np.abs(np.arange(1 - m, m)), (1.0, 10.0, 1.0)) / (12.0 * m**2)
    if len(even) <= 2 * m:
        return None
    pressure, _, thrust = ((even[2 * m :] - 2 * even[m:-m] + even[: -2 * m]) / (m * half) ** 2).T
    rising = meter * np.convolve(even[:, 1], weights, "valid")
    faster = np.gradient(rising, half)
    columns = np.column_stack([thrust, np.ones(len(thrust)), rising, faster])
    rows = complete_rows(np.column_stack([columns, pressure]))
    if np.count_nonzero(rows) < 4 * TUNING.fewest_windows:
        return None
    prior = np.array([np.inf, np.inf, *TUNING.unknown_pressure])
    fit = robust_fit(columns[rows], (pressure + rising)[rows], ridge=prior, between=half)
    if abs(fit.value[2]) > normal_limit() * prior[2]:  # it hardly follows the height
        return None
    return Quantity(float(fit.value[0]), float(np.sqrt(fit.covariance[0, 0])), "Pa")
