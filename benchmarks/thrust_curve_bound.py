"""How well commands and an accelerometer can show the thrust curve at all.

Thrust over mass of a vehicle is a u + b u^2, summed over its rotors, with a drift of the battery
and drag of the climb beside; the curve is c = b / (a + b). What the accelerometer shows besides is
gusts and its own noise. With the true parameters the residual is that disturbance: a Gaussian
autoregression of order 5 describes it, and its innovations' Fisher information bounds c (Ljung,
System Identification, 7.4, which holds in a closed loop too, where commands answer gusts).
"""

import math

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.health.hover import Windows, windowed_means
from gcs_sysid.health.log_streams import Streams
from gcs_sysid.signals.records import Stream
from sim_bridge.simulated_vehicle import Vehicle

_STEP = 0.1
"""s, of commands at 10 Hz."""
_ORDER = 5


def curve_bound(streams: Streams, flown: Windows, vehicle: Vehicle) -> float:
    """The least standard deviation of c that an unbiased estimator has by this flight.

    Args:
        streams: of the log.
        flown: its windows in flight.
        vehicle: as it is in truth.
    """
    assert streams.commands is not None
    t = np.arange(flown.t[0], flown.t[-1], _STEP)
    imu_t, imu = streams.tracks[Stream.IMU]
    told = -windowed_means(imu_t, imu[:, 5], t, _STEP)[:, 0]
    velocity_t, velocity = streams.tracks[Stream.VELOCITY]
    sink = windowed_means(velocity_t, velocity[:, 2], t, _STEP)[:, 0]
    late = t - vehicle.motor_lag
    u, squares = np.sum(
        [
            windowed_means(times, np.column_stack([v, v**2]), late, _STEP)
            for times, v in streams.commands.samples
        ],
        axis=0,
    ).T
    drift = (t - t.mean()) / np.abs(t - t.mean()).max()
    columns = np.column_stack([u, squares, u * drift, sink])
    there = complete_rows(np.column_stack([columns, told]))
    columns, told = columns[there], told[there]
    full = vehicle.T_max / vehicle.mass
    a, b = (1.0 - vehicle.thrust_curve) * full, vehicle.thrust_curve * full
    residual = told - columns[:, :2] @ (a, b)
    # Battery, drag and the accelerometer's bias are unknown to the bound as well.
    beside = np.column_stack([np.ones(len(told)), columns[:, 2:]])
    residual = residual - beside @ np.linalg.lstsq(beside, residual, rcond=None)[0]
    past = np.column_stack([residual[_ORDER - k : -k] for k in range(1, _ORDER + 1)])
    weights = np.linalg.lstsq(past, residual[_ORDER:], rcond=None)[0]

    def innovations(values: Array) -> Array:
        out: Array = values[_ORDER:] - sum(
            weight * values[_ORDER - k : -k] for k, weight in enumerate(weights, 1)
        )
        return out

    noise = float(np.var(innovations(residual)))
    rows = innovations(columns)
    covariance = noise * np.linalg.inv(rows.T @ rows)
    slope = np.array([-b, a]) / full**2
    return math.sqrt(float(slope @ covariance[:2, :2] @ slope))
