"""Reads the parameters that describe the vehicle and its filters, a few a second.

Those of the layout come first and faster: a wrong airframe is to be reported before take-off. They
are read by name, never written. What arrives is recorded like everything else, so that a recording
holds them too. There is no clock in here: the caller says what time it is.
"""

from collections import deque
from collections.abc import Collection, Mapping

from gcs_sysid.signals.motor_order import MotorOrder, is_function, motor_outputs
from gcs_sysid.telemetry.outgoing import Gate
from gcs_sysid.telemetry.vehicles import MavlinkSystem

_PX4_LAYOUT = ("CA_AIRFRAME", "CA_ROTOR_COUNT", "SYS_AUTOSTART")
_PX4 = (
    "SYS_HITL",
    "THR_MDL_FAC",
    "IMU_GYRO_CUTOFF",
    "IMU_ACCEL_CUTOFF",
    "IMU_GYRO_RATEMAX",
    "IMU_INTEG_RATE",
    "IMU_POS_X",
    "IMU_POS_Y",
    "IMU_POS_Z",
    "SIH_MASS",
    "SIM_GZ_EN",
)
_PX4_PER_ROTOR = ("CA_ROTOR{0}_PX", "CA_ROTOR{0}_PY", "CA_ROTOR{0}_KM")
_PX4_PER_OUTPUT = ("PWM_MAIN_FUNC{0}",)
_PX4_RANGES = ("PWM_MAIN_MIN{0}", "PWM_MAIN_MAX{0}")
# The simulator inside PX4: its own values are the truth.
_SIH = (
    "SIH_IXX",
    "SIH_IYY",
    "SIH_IZZ",
    "SIH_IXY",
    "SIH_IXZ",
    "SIH_IYZ",
    "SIH_T_MAX",
    "SIH_Q_MAX",
    "SIH_L_ROLL",
    "SIH_L_PITCH",
    "SIH_KDV",
    "SIH_KDW",
    "SIH_T_TAU",
)
# The loop's rate before the rates have settled.
_ARDUPILOT_LAYOUT = ("SCHED_LOOP_RATE", "FRAME_CLASS", "FRAME_TYPE")
_ARDUPILOT = (
    "INS_GYRO_FILTER",
    "INS_ACCEL_FILTER",
    "INS_POS1_X",
    "INS_POS1_Y",
    "INS_POS1_Z",
    "MOT_THST_EXPO",
    "MOT_SPIN_MIN",
    "MOT_SPIN_MAX",
    "MOT_SPIN_ARM",
    "MOT_PWM_MIN",
    "MOT_PWM_MAX",
    "MOT_THST_HOVER",
    "MOT_PWM_TYPE",
    "SERVO_BLH_POLES",
    "SIM_SPEEDUP",
)
_ARDUPILOT_PER_OUTPUT = ("SERVO{0}_FUNCTION",)
_FURTHER_OUTPUTS = {
    "ardupilot": tuple(f"SERVO{n}_FUNCTION" for n in range(1, 33)),
    "px4": (
        "SYS_HITL",
        "UAVCAN_ENABLE",
        *[f"{driver}_FUNC{n}" for n in range(1, 17) for driver in ("PWM_MAIN", "PWM_AUX")],
        *[f"{driver}_FUNC{n}" for n in range(1, 13) for driver in ("UAVCAN_EC", "SIM_GZ_EC")],
    ),
}
"""Where motors may be that are not on the first outputs."""

MOST_ROTORS = 12
"""PX4 has no parameters for more."""
FOLLOW_UPS = {"SIH_MASS": _SIH}
"""What the answer to one makes worth asking."""


def wanted_parameters(autopilot: str, rotors: int) -> tuple[str, ...]:
    """Names of the parameters to read; none of an unknown autopilot."""
    layout = layout_parameters(autopilot, rotors)
    if autopilot == "px4":
        return (*layout, *_PX4, *[n.format(i + 1) for i in range(rotors) for n in _PX4_RANGES])
    return (*layout, *_ARDUPILOT) if autopilot == "ardupilot" else ()


def layout_parameters(autopilot: str, rotors: int) -> tuple[str, ...]:
    """Those of `wanted_parameters` that define the layout: places, spins, outputs."""
    if autopilot == "px4":
        per_rotor = [n.format(i) for i in range(rotors) for n in _PX4_PER_ROTOR]
        per_output = [n.format(i + 1) for i in range(rotors) for n in _PX4_PER_OUTPUT]
        return (*_PX4_LAYOUT, *per_rotor, *per_output)
    if autopilot == "ardupilot":
        per_output = [n.format(i + 1) for i in range(rotors) for n in _ARDUPILOT_PER_OUTPUT]
        return (*_ARDUPILOT_LAYOUT, *per_output)
    return ()


class ParameterRequests:
    """Asks for each parameter until it has arrived or was asked for often enough.

    Attributes:
        missing: names given up.
    """

    ASK_EVERY = 0.25
    """s between two requests: a slow radio carries that beside the streams."""
    LAYOUT_AT_ONCE = 3
    """Requests at a time while the layout is unknown."""
    ROUNDS = 5
    """Requests for a parameter that is not answered; the vehicle may not have it."""
    ROUND_EVERY = 3.0
    """s at least between two requests for the same one."""

    def __init__(self, gate: Gate, rotors: int = 4) -> None:
        self.missing: list[str] = []
        self._gate = gate
        self._rotors = rotors
        self._address: tuple[int, int] | None = None
        self._queue: deque[str] = deque()
        self._asks: dict[str, int] = {}
        self._asked_at: dict[str, float] = {}
        self._followed_up: set[str] = set()
        self._layout: set[str] = set()
        self._further: set[str] = set()
        self._last = -self.ASK_EVERY

    def tick(self, now: float, vehicle: MavlinkSystem | None, arrived: Mapping[str, float]) -> None:
        """Ask for one where that is due.

        Args:
            now: any steady clock, s. Call it a few times a second.
            vehicle: the chosen vehicle, None while there is none.
            arrived: name -> value of the vehicle's parameters that have arrived.
        """
        if vehicle is None:
            return
        if vehicle.address != self._address:
            self._address = vehicle.address
            self._begin(vehicle)
        for trigger, names in FOLLOW_UPS.items():
            if trigger in arrived and trigger not in self._followed_up:
                self._followed_up.add(trigger)
                self._queue.extend(names)
        self._follow_count(vehicle, arrived)
        self._follow_motors(now, vehicle, arrived)
        if now - self._last < self.ASK_EVERY:
            return
        for _ in range(self.LAYOUT_AT_ONCE):
            name = self._next(now, arrived)
            if name is None:
                return
            self._last = self._asked_at[name] = now
            self._asks[name] = self._asks.get(name, 0) + 1
            self._gate.read_parameter(vehicle.address, name)
            if name not in self._layout:
                return

    def _follow_count(self, vehicle: MavlinkSystem, arrived: Mapping[str, float]) -> None:
        """Ask for the rotors that the vehicle has beyond those of the airframe."""
        count = arrived.get("CA_ROTOR_COUNT", 0.0)
        if not self._rotors < count <= MOST_ROTORS:
            return
        known = set(wanted_parameters(vehicle.key, self._rotors))
        self._rotors = round(count)
        more = [n for n in layout_parameters(vehicle.key, self._rotors) if n not in known]
        self._layout.update(more)
        self._queue.extendleft(reversed(more))

    def _follow_motors(
        self, now: float, vehicle: MavlinkSystem, arrived: Mapping[str, float]
    ) -> None:
        """Ask for further outputs where the first do not drive all motors, and for ranges."""
        if not arrived or any(
            name not in arrived and now - self._asked_at.get(name, now) < self.ROUND_EVERY
            for name in self._layout
        ):
            return
        order = MotorOrder.of(vehicle.key, arrived, self._rotors)
        more: list[str] = []
        if not order.orders and not order.split:
            more += _FURTHER_OUTPUTS.get(vehicle.key, ())
        elif vehicle.key == "px4":
            for driver, outputs in motor_outputs(vehicle.key, arrived).items():
                more += [f"{driver}_{end}{outputs.get(0, -1) + 1}" for end in ("MIN", "MAX")]
                more += [f"{driver}_TIM{group}" for group in range(3)]  # DShot is a rate there
            more += ("DSHOT_MIN", "DSHOT_3D_ENABLE", "CA_R_REV", "MOT_POLE_COUNT", "DSHOT_MOT_POL1")
        elif arrived.get("MOT_PWM_MIN") == 0.0:  # then the throttle's channel has the range
            more += ("RCMAP_THROTTLE", "RC3_MIN", "RC3_MAX")
        more = [n for n in more if n not in arrived and n not in self._further]
        self._further.update(more)
        self._layout.update(n for n in more if is_function(n))
        self._queue.extend(n for n in more if n not in self._asks)

    def _begin(self, vehicle: MavlinkSystem) -> None:
        self.missing = []
        self._queue = deque(wanted_parameters(vehicle.key, self._rotors))
        self._layout = set(layout_parameters(vehicle.key, self._rotors))
        self._asks.clear()
        self._asked_at.clear()
        self._followed_up.clear()
        self._further.clear()

    def _next(self, now: float, arrived: Collection[str]) -> str | None:
        """The next name to ask for; it goes to the end of the queue."""
        for _ in range(len(self._queue)):
            name = self._queue.popleft()
            if name in arrived:
                continue
            waited = now - self._asked_at.get(name, now - self.ROUND_EVERY) >= self.ROUND_EVERY
            if waited and self._asks.get(name, 0) >= self.ROUNDS:
                self.missing.append(name)
                continue
            self._queue.append(name)
            if waited:
                return name
        return None

    def again(self) -> None:
        """Give those given up another chance: the link was away for a while."""
        self._queue.extend(self.missing)
        for name in self._queue:
            self._asks.pop(name, None)
            self._asked_at.pop(name, None)
        self.missing = []
