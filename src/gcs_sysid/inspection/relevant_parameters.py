"""Which of an autopilot's hundreds of parameters matter for identification."""

import re
from collections.abc import Mapping

GROUPS = {
    "frame": r"FRAME|FRAME_(CLASS|TYPE)|SYS_AUTOSTART|CA_AIRFRAME|CA_ROTOR_COUNT|SCHED_LOOP_RATE",
    "filters": r"INS_(GYRO|ACCEL)_FILTER|IMU_(GYRO|ACCEL)_CUTOFF|IMU_GYRO_RATEMAX|IMU_INTEG_RATE",
    "motors": r"MOT_PWM_(MIN|MAX)|MOT_SPIN_(ARM|ARMED|MIN|MAX)|MOT_THST_EXPO|THR_MDL_FAC"
    r"|PWM_MAIN_(MIN|MAX)[1-8]",
    "IMU place": r"INS_POS1_[XYZ]|IMU_POS_[XYZ]",
    "simulator": r"SIH_(MASS|I[XYZ][XYZ]|T_MAX|Q_MAX|L_ROLL|L_PITCH|KDV|KDW|T_TAU)",
}
"""Group -> pattern of whole names."""

_PATTERNS = {group: re.compile(pattern) for group, pattern in GROUPS.items()}


def group_of(name: str) -> str | None:
    """The group that a parameter belongs to; None when it does not matter."""
    for group, pattern in _PATTERNS.items():
        if pattern.fullmatch(name):
            return group
    return None


def that_matter(parameters: Mapping[str, float]) -> dict[str, float]:
    """Those that matter, by group, then by name."""
    order = list(GROUPS)
    names = [(order.index(group), name) for name in parameters if (group := group_of(name))]
    return {name: parameters[name] for _, name in sorted(names)}
