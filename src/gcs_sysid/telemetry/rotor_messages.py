"""Payloads of the rotor messages to speeds in rad/s and commands in the autopilot's own unit."""

import math
from collections.abc import Callable

import numpy as np

from gcs_sysid.arrays import Array, Mask
from gcs_sysid.telemetry.messages import picker

RPM = 2.0 * math.pi / 60.0
"""rad/s per revolution a minute."""
MOST_ROTORS = 64
"""As many as the definition of ESC_STATUS allows; its index could tell of more."""
ESC_TELEMETRY = {
    f"ESC_TELEMETRY_{first}_TO_{first + 3}": first - 1 for first in (1, 5, 9, 13, 17, 21, 25, 29)
}
"""Message name -> index of its first rotor."""

_esc_status = picker("ESC_STATUS", "time_usec", "index", "rpm")
_rpm = picker("RPM", "rpm1", "rpm2")
_outputs = picker("ACTUATOR_OUTPUT_STATUS", "time_usec", "active", "actuator")
_SERVOS = [f"servo{i}_raw" for i in range(1, 17)]
_servos = picker("SERVO_OUTPUT_RAW", "time_usec", "port", *_SERVOS)


def esc_status(payload: bytes) -> tuple[int, int, tuple[float, ...]]:
    """Time in us, index of the first rotor, speeds of ESC_STATUS."""
    time_usec, index, *rpm = _esc_status(payload)
    # The sign only tells the sense of rotation, which the airframe gives.
    return time_usec, index, tuple(abs(value) * RPM for value in rpm)


def esc_telemetry(name: str) -> Callable[[bytes], tuple[float, ...]]:
    """Make the function from a payload of one ESC_TELEMETRY message to speeds."""
    pick = picker(name, "rpm")
    return lambda payload: tuple(value * RPM for value in pick(payload))


def rpm_sensors(payload: bytes) -> tuple[float, ...]:
    """Speeds of RPM's sensors; those that are not there (-1) are left out."""
    rpm1, rpm2 = _rpm(payload)
    if rpm1 < 0.0:
        return ()
    return tuple(value * RPM for value in ((rpm1, rpm2) if rpm2 >= 0.0 else (rpm1,)))


def actuator_outputs(payload: bytes) -> tuple[int, tuple[float, ...]]:
    """Time in us and commands of ACTUATOR_OUTPUT_STATUS."""
    time_usec, active, *outputs = _outputs(payload)
    # By the definition a mask, from PX4 a count; either way outputs beyond it are unused.
    count = active if active <= len(outputs) else min(active.bit_length(), len(outputs))
    used = outputs[: count or None]
    while len(used) > 4 and not math.isfinite(used[-1]):
        used.pop()
    return time_usec, tuple(used)


def servo_outputs(payload: bytes) -> tuple[int, int, tuple[float, ...]]:
    """Time in us, port and commands of SERVO_OUTPUT_RAW."""
    time_usec, port, *servos = _servos(payload)
    while len(servos) > 4 and servos[-1] == 0:  # 0 is: not there
        servos.pop()
    return time_usec, port, tuple(float(servo) for servo in servos)


def actuator_outputs_block(messages: Array) -> tuple[Array, Array]:
    """(n, 32) commands of n ACTUATOR_OUTPUT_STATUS, and how many of each row are used."""
    outputs = messages["actuator"].astype(float)
    most = outputs.shape[1]
    active = messages["active"].astype(float)
    bit_length = np.frexp(active)[1]
    count = np.where(active <= most, active, np.minimum(bit_length, most)).astype(int)
    count[count == 0] = most
    there = np.isfinite(outputs) & (np.arange(most) < count[:, None])
    return outputs, np.maximum(_to_last(there), np.minimum(count, 4))


def servo_outputs_block(messages: Array) -> tuple[Array, Array]:
    """(n, 16) commands of n SERVO_OUTPUT_RAW, and how many of each row are there."""
    servos = np.column_stack([messages[name] for name in _SERVOS]).astype(float)
    return servos, np.maximum(_to_last(servos != 0.0), 4)


def _to_last(there: Mask) -> Array:
    """(n,) how many entries of each row there are up to the last true one."""
    count = there.shape[1] - np.argmax(there[:, ::-1], axis=1)
    return np.where(there.any(axis=1), count, 0)
