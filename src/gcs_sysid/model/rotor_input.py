"""What a rotor stream holds, and what follows from it for everything that reads it.

Another kind (throttle of DShot, motor current) is another member: nothing else compares kinds.
"""

from enum import StrEnum
from typing import Literal

import numpy as np

from gcs_sysid.arrays import Array

ThrustName = Literal["k_T", "T_max"]


class RotorInput(StrEnum):
    """Kind of rotor stream; its value is the word in files and options.

    Attributes:
        words: for people.
        unit: of its values as the estimator takes them.
        thrust: name of its thrust coefficient, of which everything identified is a multiple.
        torque: name of the rotor torque that a complete identification includes.
        motors: whether lag and thrust curve of the motors lie between it and the thrust, and are
            identified with the rest; else it is the motion of the rotors itself.
    """

    words: str
    unit: str
    thrust: ThrustName
    torque: str
    motors: bool

    SPEED = "speed", "measured speeds", "rad/s", "k_T", "k_M", False
    COMMAND = "command", "commands", "1", "T_max", "moment_ratio", True

    def __new__(
        cls,
        word: str,
        words: str = "",
        unit: str = "",
        thrust: ThrustName = "k_T",
        torque: str = "",
        motors: bool = False,
    ) -> "RotorInput":
        """A kind with its attributes."""
        kind = str.__new__(cls, word)
        kind._value_ = word
        kind.words, kind.unit, kind.thrust = words, unit, thrust
        kind.torque, kind.motors = torque, motors
        return kind

    @classmethod
    def scaled_by(cls, reference: str | None) -> "RotorInput | None":
        """The one kind whose scale this reference sets; None: it sets that of any, as mass does."""
        return next((kind for kind in cls if kind.thrust == reference), None)

    def fits(self, reference: str | None) -> bool:
        """Whether the scale reference of this name sets its scale."""
        return RotorInput.scaled_by(reference) in (None, self)

    def shown(self, value: float) -> str:
        """A rotor's value with its unit."""
        return f"{100.0 * value:.0f} %" if self.unit == "1" else f"{value:.0f} {self.unit}"

    def load(self, value: Array, curve: Array) -> Array:
        """Thrust over the thrust coefficient: Omega^2, or (1 - c) u + c u^2 of thrust curve c."""
        return (1.0 - curve) * value + curve * value * value if self.motors else value * value

    def at_load(self, load: Array, curve: Array) -> Array:
        """The value with this load."""
        if not self.motors:
            return np.sqrt(load)
        # In the form that holds at c = 0; above the top of an odd curve, the command there.
        root = np.sqrt(np.maximum((1.0 - curve) ** 2 + 4.0 * curve * load, 0.0))
        return 2.0 * load / np.maximum(1.0 - curve + root, 1e-6)

    def turning(self, value: Array, curve: Array) -> Array:
        """What the rotors' angular momentum grows with.

        A rotor's speed goes with the root of its thrust: sqrt(u) at one end of the curves, u at
        the other; between them a straight line will do.
        """
        if not self.motors:
            return value
        return (1.0 - curve) * np.sqrt(np.clip(value, 0.0, None)) + curve * value


MEASURED = tuple(kind for kind in RotorInput if not kind.motors)
"""Kinds that are the motion of the rotors itself."""
THROUGH_MOTORS = tuple(kind for kind in RotorInput if kind.motors)
"""Kinds that reach the thrust through motors."""
