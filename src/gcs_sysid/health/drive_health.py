"""Motors and margins by commands: gains, throttle, headroom, drift, idle, battery.

Vibration at the frequency of each rotor, from the accelerometer and measured speeds.

An unbalanced or bent propeller shakes at the rotor's own frequency. Over short stretches the
specific force is correlated with exp(-j phi), phi the integral of the rotor's speed: what hangs
together with the rotor's phase stays, and what other rotors and the air do averages out to the
level of neighboring frequencies, which is taken off.
"""

import math
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array, complete_rows
from gcs_sysid.health import balance
from gcs_sysid.health.command_curve import Commanded, Curve, gentle_of, thrust_of
from gcs_sysid.health.hover import Windows, variations_of_lift, windowed_means
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.log_streams import Streams
from gcs_sysid.health.vehicle_health import Health, HoverCommand, MotorCurrent
from gcs_sysid.model.estimate import Estimate, Quantity
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.signals.records import Stream


def motor_gains(hover: Windows, commanded: Commanded | None) -> tuple[Quantity | None, ...]:
    """Speed squared for the command over that of the mean rotor."""
    # A rotor that turns without a command is no motor at work.
    rows = complete_rows(hover.speeds) & (hover.commands > 0.0).all(axis=1)
    if commanded is None or np.count_nonzero(rows) < TUNING.fewest_windows:
        return tuple([None] * hover.speeds.shape[1])

    def gains(thrust: Array) -> Array:
        ratio: Array = hover.speeds[rows] / thrust[rows]
        return ratio / ratio.mean(axis=1, keepdims=True)

    # All rotors by the same curve; it matters by the difference of their commands alone.
    own, given = commanded.doubt(lambda thrust: gains(thrust).mean(axis=0))
    out = []
    for column, *doubts in zip(gains(commanded.thrust).T, own, given, strict=True):
        fit = balance.robust_fit(np.ones((len(column), 1)), column)
        found = Quantity(float(fit.value[0]), math.sqrt(float(fit.covariance[0, 0])), "1")
        out.append(found.off_by(*map(float, doubts)))
    return tuple(out)


def with_throttle(
    health: Health, streams: Streams, hover: Windows, thrust: Array, commanded: Commanded | None
) -> Health:
    """Throttle, thrust to weight, headroom, saturation and drift.

    Args:
        health: without them.
        streams: of the log.
        hover: windows.
        thrust: (n, rotors) of them.
        commanded: the same by commands; None without any.
    """
    lift = balance.lift_of(hover)
    minutes = (hover.t - hover.t.mean()) / 60.0
    effort = np.log(thrust.sum(axis=1) / lift)
    # Thrust for the same command: what falls with the battery.
    if commanded is not None:
        asked = commanded.thrust.sum(axis=1)
        if np.isfinite(asked).all() and (asked > 0.0).all():
            effort = np.log(asked / lift)
    fit = balance.robust_fit(np.column_stack([np.ones(len(minutes)), minutes]), effort)
    drift = Estimate(-float(fit.value[1]), math.sqrt(float(fit.covariance[1, 1])), "1/min")
    if float(np.ptp(minutes)) < TUNING.shortest_drift / 60.0:
        drift = Estimate(None, None, "1/min")
    health = replace(health, drift=drift)
    if (turning := complete_rows(hover.speeds)).any():
        squares = hover.speeds[turning].mean(axis=1) * GRAVITY / lift[turning]
        hertz = balance.mean_of(np.sqrt(squares) / (2.0 * math.pi), hover.half)
        health = replace(health, hover_frequency=replace(hertz, unit="Hz"))
    rows = complete_rows(hover.commands)
    if streams.commands is None or commanded is None or not rows.any():
        return health
    u, unit = hover.commands[rows], GRAVITY / lift[rows]

    def of_full(thrust: Array) -> Array:
        share: Array = thrust[rows].mean(axis=1) * unit
        return share

    throttle = balance.mean_of(u.mean(axis=1), hover.half)
    hover_thrust = balance.mean_of(of_full(commanded.thrust), hover.half)
    command = HoverCommand(
        balance.usual_of(u.mean(axis=1) * unit),
        balance.usual_of(hover.squares[rows].mean(axis=1) * unit),
        hover_thrust.std / hover_thrust.value,
        _logged(streams, "throttle", hover.part(rows), unit),
        _logged(streams, "share of the full voltage", hover.part(rows)),
    )
    doubts = commanded.doubt(lambda thrust: of_full(thrust).mean())
    hover_thrust = hover_thrust.off_by(*map(float, doubts))
    rotors = []
    for i, rotor in enumerate(health.rotors):
        used = balance.mean_of(u[:, i], hover.half)
        _, samples = streams.commands.samples[i]
        turning = samples[samples > 0.0]
        full = float(np.mean(turning >= TUNING.full_command)) if len(turning) else None
        rotors.append(
            replace(rotor, headroom=Quantity(1.0 - used.value, used.std, "1"), saturated=full)
        )
    return replace(
        health,
        hover_throttle=throttle,
        hover_thrust=hover_thrust,
        hover_command=command,
        thrust_to_weight=hover_thrust.under(1.0, "1"),
        rotors=tuple(rotors),
    )


def _logged(streams: Streams, name: str, hover: Windows, unit: Array | float = 1.0) -> float | None:
    """Mean over hover of what an autopilot logs of its motors; None where it does not."""
    if name not in streams.extras:
        return None
    t, values = streams.extras[name]
    t, first = np.unique(t - streams.flight.start, return_index=True)
    means = windowed_means(t, values.reshape(len(values), -1)[first], hover.t, hover.half)
    found = (means[:, 0] * unit)[np.isfinite(means[:, 0])]
    return balance.usual_of(found) if len(found) > 1 else None


def power_of_voltage(streams: Streams, windows: Windows, curve: Curve | None) -> Quantity | None:
    """Power a of the voltage in thrust that is f(u (V / V_0)^a), f the curve over commands.

    It is that of the speeds where they are measured, else of what lifts the vehicle, by which the
    battery's slow fall over a flight is seen: f(u v^a) = f(u) + a u f'(u) ln v.

    Args:
        streams: of the log.
        windows: all those in flight.
        curve: of thrust over commands.
    """
    if Stream.VOLTAGE not in streams.tracks or curve is None:
        return None
    volts = windowed_means(*streams.tracks[Stream.VOLTAGE], windows.t, windows.half)[:, 0]
    u, squares = windows.commands.mean(axis=1), windows.squares.mean(axis=1)
    measured = bool(np.isfinite(windows.speeds).any())
    thrust = (
        windows.speeds.mean(axis=1) if measured else variations_of_lift(windows.lift, windows.force)
    )
    there = gentle_of(windows) & ~windows.idle & (volts > 0.0)
    there &= complete_rows(np.column_stack([u, squares, thrust]))
    if np.count_nonzero(there) < 2 * TUNING.fewest_windows or not thrust[there].any():
        return None
    c, fall = curve.c.value, np.log(volts[there] / np.median(volts[there]))
    slope = (1.0 - c) * u[there] + 2.0 * c * squares[there]
    columns = [u[there], squares[there], slope * fall]
    if not measured:
        columns.append(np.nan_to_num(windows.sink[there]))
    fit = balance.robust_fit(np.column_stack(columns), thrust[there], between=windows.half)
    full = float(fit.value[:2].sum())
    std = math.sqrt(max(float(fit.covariance[2, 2]), 0.0)) / abs(full) if full else 0.0
    return Quantity(float(fit.value[2]) / full, std, "1") if std > 0.0 else None


def motor_current(streams: Streams, windows: Windows, c: float) -> MotorCurrent | None:
    """The motors' current over their thrust as commanded, by climbs and descents.

    Args:
        streams: of the log.
        windows: all those in flight.
        c: of the thrust curve that the autopilot inverts.
    """
    t, currents = streams.extras.get("motor currents", (np.empty(0), np.empty((0, 0))))
    if currents.shape[1] != windows.commands.shape[1]:
        return None
    amperes = windowed_means(t - streams.flight.start, currents, windows.t, windows.half).mean(
        axis=1
    )
    thrust = thrust_of(windows, c).mean(axis=1)
    there = complete_rows(np.column_stack([amperes, thrust])) & ~windows.idle & (amperes > 0.0)
    amperes, thrust = amperes[there], thrust[there]
    if len(thrust) < 2 * TUNING.fewest_windows or np.std(thrust) < TUNING.least_throttle_motion:
        return None
    mean = float(thrust.mean())
    columns = np.column_stack([thrust - mean, np.ones(len(thrust))])
    fit = balance.robust_fit(columns, amperes, between=windows.half)
    # The battery's charge differs from flight to flight.
    slope, level = (
        Quantity(float(v), math.hypot(std, TUNING.common_command * abs(float(v))), "A")
        for v, std in zip(fit.value, np.sqrt(np.diag(fit.covariance)), strict=True)
    )
    return MotorCurrent(slope, level, mean)


def idle_output(streams: Streams) -> float | None:
    """Least output, in the autopilot's unit, at which all rotors turned for a second by measure.

    What is measured turning beside a stopped output is a rotor that runs out: an output must stand
    still for a second.
    """
    if streams.speeds is None or streams.commands is None or not streams.commands.outputs:
        return None
    lowest = []
    for (t, output), (speed_t, speed) in zip(
        streams.commands.outputs, streams.speeds.samples, strict=True
    ):
        last = np.maximum(np.searchsorted(speed_t, t, side="right") - 1, 0)
        turning = (speed[last] > 0.0) & (np.abs(t - speed_t[last]) < 0.5)
        later = np.searchsorted(t, t - 1.0)
        stays = (output == output[later]) & (t - t[0] > 1.0) & (output > output.min())
        run = np.append(0.0, np.cumsum(~turning | (output != np.roll(output, 1))))
        whole = stays & (run[1:] - run[later + 1] == 0.0)
        if not whole.any():
            return None
        lowest.append(float(output[whole].min()))
    return max(lowest)


def battery_of(streams: Streams) -> tuple[float, float, float] | None:
    """Highest, lowest and median voltage; None where it is not logged."""
    found = streams.extras.get("battery voltage")
    if found is None:
        return None
    volts = found[1][np.isfinite(found[1]) & (found[1] > 1.0)]
    if not len(volts):
        return None
    return float(volts.max()), float(volts.min()), float(np.median(volts))


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
        if len(squares) < TUNING.fewest_stretches:
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
    firsts = np.searchsorted(t, centers - 0.5 * TUNING.phase_stretch)
    counts = np.searchsorted(t, centers + 0.5 * TUNING.phase_stretch) - firsts
    out = np.full(len(centers), np.nan)
    offsets = np.array((0.0, *TUNING.floor_beside))[:, None]
    for count in np.unique(counts[counts >= max(0.8 * TUNING.phase_stretch * rate, 3)]).tolist():
        taper = np.hanning(count)
        scale = 4.0 / float(taper.sum()) ** 2
        alike = np.flatnonzero(counts == count)
        for start in range(0, len(alike), TUNING.stretches_at_once):
            some = alike[start : start + TUNING.stretches_at_once]
            rows = firsts[some, None] + np.arange(count)
            parts, turned, times = force[rows], phase[rows], t[rows]
            own = (turned[:, -1] - turned[:, 0]) / (times[:, -1] - times[:, 0]) / (2.0 * math.pi)
            seen = np.isfinite(parts).all(axis=(1, 2))
            seen &= (own > 5.0) & (
                own < 0.5 * TUNING.nyquist_share * rate - TUNING.floor_beside[-1]
            )
            some, parts, turned, times = some[seen], parts[seen], turned[seen], times[seen]
            parts = (parts - parts.mean(axis=1, keepdims=True)) * taper[:, None]
            moment = times - times[:, :1]
            turns = turned[:, None] + 2.0 * math.pi * offsets * moment[:, None]
            # |sum f e^(-i turns)|^2, of each offset over the axes: (some, offsets).
            level = ((np.cos(turns) @ parts) ** 2 + (np.sin(turns) @ parts) ** 2).sum(axis=2)
            out[some] = scale * (level[:, 0] - np.median(level[:, 1:], axis=1))
    found: list[float] = out[np.isfinite(out)].tolist()
    return found
