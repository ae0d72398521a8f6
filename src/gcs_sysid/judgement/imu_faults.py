"""What an IMU does not measure: a gyro that reads otherwise than the attitude turns, a limit."""

import math
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.status import reference_values
from gcs_sysid.model import attitude
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.parameters import AXES, GRAVITY, REGISTRY
from gcs_sysid.signals.imu_checks import GyroAgainstAttitude, Saturated
from gcs_sysid.significance import Z95

_SYSTEMATIC = np.array([0.015, 0.015, 0.05])
"""Shares by which sound gyros and attitudes of 40 logs differ beyond their noise: gravity corrects
roll and pitch of an attitude, the compass its yaw."""
_CERTAIN = 3.0
"""Standard deviations."""
_ALIKE = 0.1
"""Share to which axes have one scale, or a scale is that of a unit."""
_MOVED = 0.01
"""rad rms in an interval, below which an axis has hardly turned."""
_GENTLER = "give it a larger range, damp its mount, or fly gentler"
_NO_ACCELEROMETER = 1.0
"""Betaflight's acc_hardware = NONE."""
_DEAD = 0.1
"""Share of a turn that a dead axis reads at most."""
_MOST_BIAS = 0.15
"""rad/s, to which autopilots' filters follow a gyro's bias (EKF2_GYR_B_LIM)."""


def misread_axes(check: GyroAgainstAttitude) -> Mask:
    """(3,) which axes certainly do not read what the attitude turns."""
    wrong = _misscaled(check)
    return wrong if wrong.any() else np.abs(check.bias) > _MOST_BIAS


def _misscaled(check: GyroAgainstAttitude) -> Mask:
    """(3,) which certainly read another multiple of it."""
    std = np.hypot(np.diag(check.std), _SYSTEMATIC)
    scale = np.diag(check.gain)
    moved: Mask = check.turned > _MOVED
    wrong: Mask = moved & (np.abs(scale - 1.0) > _CERTAIN * std)
    # What is wrong with one scale for all is wrong with all, also where that axis cannot show it.
    return moved if wrong.any() and _alike(scale[moved]) else wrong


def _alike(scales: Array) -> bool:
    return float(np.ptp(scales)) < _ALIKE * abs(float(scales.mean()))


def gyro_fault(check: GyroAgainstAttitude) -> tuple[str, str] | None:
    """What the gyro does wrong and what to do; None where nothing is certain."""
    if not (wrong := misread_axes(check)).any():
        return None
    gain = check.gain
    scale = np.diag(gain)
    mean = float(scale[wrong].mean())
    if not _misscaled(check).any():
        words = " and ".join(
            f"{AXES[i]} axis reads {check.bias[i]:+.2f}" for i in np.flatnonzero(wrong)
        )
        return (
            f"the gyro's {words} rad/s beside what the attitude turns",
            "check the IMU, and have the one recorded that the autopilot flies by",
        )
    if (check.turned > _MOVED).all() and (angles := _turned_by(gain)):
        words = " ".join(f"{axis} {angle}" for axis, angle in angles.items())
        return (
            f"the gyro is turned by {words} deg against the attitude's axes: the IMU is logged in "
            "those of its board",
            "log it in the vehicle's axes, or turn it by that "
            f"(SENS_BOARD_ROT, AHRS_ORIENTATION: {'_'.join(words.upper().split())}; align_board)",
        )
    if _alike(scale[wrong]) and abs(math.radians(mean) - 1.0) < _ALIKE:
        return (
            f"the gyro reads {mean:.1f} times what the attitude turns: it is in deg/s, not rad/s",
            "give its unit",
        )
    if wrong.sum() >= 2 and _alike(scale[wrong]):
        return (
            f"the gyro reads {mean:.2f} of what the attitude turns, and inertia would be off by "
            "as much",
            "check its scale and range",
        )
    words = " and ".join(
        f"{AXES[i]} axis reads {'nothing' if abs(scale[i]) < _DEAD else f'{scale[i]:.2f}'}"
        for i in np.flatnonzero(wrong)
    )
    return f"the gyro's {words} of what the attitude turns", "check the IMU"


def _turned_by(gain: Array) -> dict[str, int]:
    """How a board is mounted whose gyro is logged in its own axes, in steps of 45 deg.

    Roll, pitch and yaw in that order turn its axes to the vehicle's (MAV_SENSOR_ORIENTATION).

    Args:
        gain: (3, 3) what the gyro reads over what the attitude turns.

    Returns:
        Those that are not zero; empty where it is no such rotation.
    """
    turn = gain.T
    if np.abs(turn @ turn.T - np.eye(3)).max() > 3.0 * _ALIKE or np.linalg.det(turn) < 0.0:
        return {}
    pitch = math.asin(min(max(-turn[2, 0], -1.0), 1.0))
    roll, yaw = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    if math.cos(pitch) < _ALIKE:  # roll and yaw turn about one axis
        roll, yaw = 0.0, math.atan2(-turn[0, 1], turn[1, 1])
    steps = [round(angle / (0.25 * math.pi)) for angle in (roll, pitch, yaw)]
    mounted = attitude.from_euler(*(0.25 * math.pi * step for step in steps))
    if np.abs(attitude.matrices(np.array([mounted]))[0] - turn).max() > 2.0 * _ALIKE:
        return {}
    return {axis: 45 * step % 360 for axis, step in zip(AXES, steps, strict=True) if step % 8}


def misread_gyro(evidence: Evidence) -> Iterator[Objection]:
    """All that rests on an axis which the gyro does not read as the attitude turns.

    A rate of wrong scale is in the gyroscopic torques of the other two axes. Drag too: the attitude
    that it is found with is filtered with the gyro. A bias tilts it, and so concerns thrust.
    """
    if evidence.gyro is None or (fault := gyro_fault(evidence.gyro)) is None:
        return
    reason, how = fault
    axes = misread_axes(evidence.gyro)
    misscaled = bool(_misscaled(evidence.gyro).any())
    forces = ("translation",) if misscaled else ("translation", "scale")
    yield Objection(
        reason,
        evidence.names(
            lambda p: (
                any(axes[axis] for axis in p.axes)
                or p.fit in forces
                or (misscaled and p.rigid_body)
            )
        ),
        cap="weak",
        verdict="partial",
        evidence=dict(zip(AXES, np.diag(evidence.gyro.gain).tolist(), strict=True)),
        how=how,
    )


def saturation_reason(found: Saturated) -> str:
    """What stood at which limit, in one line."""
    if found.absent:
        return f"there is no {found.sensor}: it reads nothing"
    if found.low:
        return (
            f"the {found.sensor} reads {100.0 * (1.0 - found.share):.0f} % of gravity on average, "
            "which no flight can: its scale is wrong"
        )
    limit = f"{found.limit:.1f} m/s^2 ({found.limit / GRAVITY:.1f} g)"
    if found.sensor == "gyro":
        limit = f"{found.limit:.2f} rad/s ({math.degrees(found.limit):.0f} deg/s)"
    what = "wraps around at" if found.wraps else "stands at its limit of"
    return f"the {found.sensor} {what} {limit} in {100.0 * found.share:.2g} % of its samples"


def saturated_sensors(evidence: Evidence) -> Iterator[Objection]:
    """What is claimed more closely than the share that a sensor did not measure.

    What is cut off is at least as large as what is left, so that a parameter is off by that share
    of its usual size and more; what wraps around is off by any amount.
    """
    sizes = reference_values(evidence.estimates, evidence.airframe.arm)
    for found in evidence.saturated:
        how = _remedy(found, evidence.parameters)
        if found.absent:  # what rests on it is not observed
            yield Objection(saturation_reason(found), verdict="partial", how=how)
            continue
        names = frozenset(
            name
            for name, size in sizes.items()
            if (std := evidence.estimates[name].std) is not None
            and (found.wraps or Z95 * std < found.share * size)
            and (not found.low or REGISTRY[name].scale != "none")
        )
        if names:
            yield Objection(
                saturation_reason(found),
                names,
                cap="weak",
                verdict="partial",
                evidence={"limit": found.limit, "share": found.share},
                how=how,
            )


def of_sensors(
    gyro: GyroAgainstAttitude | None,
    saturated: Iterable[Saturated],
    parameters: Mapping[str, float],
) -> Iterator[Objection]:
    """The same, whatever rests on these sensors.

    Args:
        gyro: as of `Evidence`.
        saturated: likewise.
        parameters: the autopilot's.
    """
    if gyro is not None and (fault := gyro_fault(gyro)) is not None:
        yield Objection(fault[0], verdict="partial", how=fault[1], by="gyro")
    for found in saturated:
        how = _remedy(found, parameters)
        yield Objection(saturation_reason(found), verdict="partial", how=how, by="saturation")


def _remedy(found: Saturated, parameters: Mapping[str, float]) -> str:
    if found.absent:
        return _accelerometer_on(parameters)
    return "calibrate it, and check its range (acc_1G)" if found.low else _GENTLER


def _accelerometer_on(parameters: Mapping[str, float]) -> str:
    """What makes an accelerometer be read and logged, by what Betaflight has in its header."""
    line = ""
    if "acc_hardware" in parameters and "acc_1G" not in parameters:
        return "put acc_1G, which scales it, back into the log's header: the firmware writes it"
    if parameters.get("acc_hardware") == _NO_ACCELEROMETER:
        line = " (in the CLI: set acc_hardware = AUTO, then save)"
    elif "fields_disabled_mask" in parameters:
        line = " (in the CLI: set blackbox_disable_acc = OFF, then save)"
    return f"enable the accelerometer{line} and calibrate it"
