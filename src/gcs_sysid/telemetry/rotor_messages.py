"""What the rotor messages leave out: units, and how many of their values are there."""

import math

import numpy as np

from gcs_sysid.arrays import Array, Mask

RPM = 2.0 * math.pi / 60.0
"""rad/s per revolution a minute."""
MOST_ROTORS = 64
"""As many as the definition of ESC_STATUS allows; its index could be higher."""


def used_sensors(_messages: Array, rpm: Array) -> Array:
    """(n,) how many sensors n messages RPM report; absent ones are -1."""
    return np.where(rpm[:, 0] < 0.0, 0, np.where(rpm[:, 1] >= 0.0, 2, 1))


def used_outputs(messages: Array, outputs: Array) -> Array:
    """(n,) how many outputs n messages ACTUATOR_OUTPUT_STATUS report, at least four.

    `active` is by the definition a mask, from PX4 a count; either way outputs beyond it are unused.
    """
    most = outputs.shape[1]
    active = messages["active"].astype(float)
    bit_length = np.frexp(active)[1]
    count = np.where(active <= most, active, np.minimum(bit_length, most)).astype(int)
    count[count == 0] = most
    there = np.isfinite(outputs) & (np.arange(most) < count[:, None])
    used: Array = np.maximum(_to_last(there), np.minimum(count, 4))
    return used


def used_servos(_messages: Array, servos: Array) -> Array:
    """(n,) how many servos n messages SERVO_OUTPUT_RAW report, at least four; 0: not there."""
    used: Array = np.maximum(_to_last(servos != 0.0), 4)
    return used


def _to_last(there: Mask) -> Array:
    """(n,) how many entries of each row there are up to the last true one."""
    count = there.shape[1] - np.argmax(there[:, ::-1], axis=1)
    return np.where(there.any(axis=1), count, 0)
