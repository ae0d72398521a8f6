"""Drag over mass from legs of a flight, the wind as one of its unknowns.

PX4's and ArduPilot's wind estimates take the specific force in the rotors' plane as

    f = -M v - rho / (2 B) |v| v ,    v the velocity through the air along body x and y

(drag_fusion.cpp of EKF2; EKF3 alike), M the momentum drag of the propellers (MCOEF,
1/s at sea level), B the ballistic coefficient of the body (BCOEF, kg/m^2). A steady wind, a bias of
the accelerometer and both drags are separated by legs of other speeds and headings alone.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.health.balance import robust_values
from gcs_sysid.health.command_curve import gentle_of
from gcs_sysid.health.hover import Windows, windowed_means
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.log_streams import Streams
from gcs_sysid.model.estimate import Quantity
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.records import Stream
from gcs_sysid.significance import Z95


@dataclass(frozen=True)
class Drag:
    """Drag over mass.

    Attributes:
        linear: M, 1/s, at the flight's density of air.
        square: rho / (2 B), 1/m, likewise.
        fastest: m/s through the air, of the legs.
    """

    linear: Quantity
    square: Quantity
    fastest: float


def drag_of(streams: Streams, windows: Windows) -> Drag | None:
    """Drag by the specific force of a flight; None where attitude or velocity is not there.

    Args:
        streams: of the log.
        windows: all those in flight.
    """
    if not {Stream.ATTITUDE, Stream.VELOCITY} <= streams.tracks.keys():
        return None
    t, q = streams.tracks[Stream.ATTITUDE]
    w, x, y, z = q.T
    # Body x and y in the north and east of the earth.
    axes = np.column_stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * y - w * z), 1 - 2 * (x * x + z * z)]
    )
    axes = windowed_means(t, axes, windows.t, windows.half).reshape(-1, 2, 2)
    t, velocity = streams.tracks[Stream.VELOCITY]
    flown = windowed_means(t, velocity[:, :2], windows.t, windows.half)
    there = complete_rows(np.column_stack([flown, axes.reshape(-1, 4), windows.force[:, :2]]))
    there &= gentle_of(windows) | (windows.speed > TUNING.most_speed)
    there &= ~windows.idle
    if np.count_nonzero(there) < 4 * TUNING.fewest_windows:
        return None
    return _fitted(axes[there], flown[there], windows.force[there, :2])


def _fitted(axes: Array, flown: Array, force: Array) -> Drag | None:
    """Of (n, 2, 2) axes, (n, 2) velocities in m/s and (n, 2) specific forces in m/s^2.

    None where what the legs make of the force is less than what is left: a hover that gusts move.
    The covariance is that of the jackknife over parts of the flight, by Student's t for as many:
    few legs hold most of what there is, and winds last longer than one.
    """
    start = np.zeros(6)
    start[0] = 0.1
    value, residual = _solved(start, axes, flown, force)
    through = np.linalg.norm(flown - value[2:4], axis=1)
    slope = value[0] + value[1] * through
    # By its own motion: a wind and a bias alone explain much of what a turn shows, and no drag.
    motion = float(np.std(slope[:, None] * (axes @ flown[:, :, None])[:, :, 0]))
    if motion <= residual:
        return None
    parts = np.array_split(np.arange(len(flown)), TUNING.parts_of_flight)
    others = [np.setdiff1d(np.arange(len(flown)), part, assume_unique=True) for part in parts]
    without = np.array(
        [_solved(value, axes[some], flown[some], force[some])[0][:2] for some in others]
    )
    free = len(parts) - 1
    spread = math.sqrt(free) * without.std(axis=0)
    # Gusts that the vehicle drifts with hide part of what they do, as of `command_curve`.
    gusts = TUNING.gust_bias * (residual / motion) ** 2
    std = np.hypot(spread * float(stdtrit(free, 0.975)) / Z95, gusts * np.abs(value[:2]))
    linear, square = (
        Quantity(float(v), float(s), unit)
        for v, s, unit in zip(value[:2], std, ("1/s", "1/m"), strict=True)
    )
    return Drag(linear, square, float(np.percentile(through, 95.0)))


def _solved(start: Array, axes: Array, flown: Array, force: Array) -> tuple[Array, float]:
    """(6,) M, K, wind and bias by Gauss-Newton of half steps, and what is left, m/s^2."""
    target, level = force.T.ravel(), GRAVITY * math.radians(1.0)
    ridge = np.array([np.inf, *TUNING.unknown_drag, level, level])
    value, near = start, start
    for _ in range(TUNING.drag_rounds):
        columns, model = _linearized(near, axes, flown)
        wanted = (target - model + columns @ near)[:, None]
        value = robust_values(columns, wanted, ridge)[:, 0]
        near = 0.5 * (near + value)
    off = target - _linearized(value, axes, flown)[1]
    return value, 1.4826 * float(np.median(np.abs(off - np.median(off))))


def _linearized(value: Array, axes: Array, flown: Array) -> tuple[Array, Array]:
    """(2n, 6) slopes of the specific force over M, K, wind and bias, and (2n,) the force."""
    linear, square, wind, bias = value[0], value[1], value[2:4], value[4:6]
    through = flown - wind
    speed = np.linalg.norm(through, axis=1)
    parts, forces = [], []
    for axis in (0, 1):
        along = (axes[:, axis] * through).sum(axis=1)
        by_wind = (linear + square * speed)[:, None] * axes[:, axis]
        by_wind += (square * along / np.maximum(speed, 1e-3))[:, None] * through
        ones = np.zeros((len(speed), 2))
        ones[:, axis] = 1.0
        parts.append(np.column_stack([-along, -speed * along, by_wind, ones]))
        forces.append(-(linear + square * speed) * along + bias[axis])
    return np.vstack(parts), np.concatenate(forces)
