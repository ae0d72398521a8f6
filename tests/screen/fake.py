"""A session that is not one: fixed, realistic snapshots of the paper's quadrotor.

No test module: the tests get it through the fixtures in conftest.py, and `tools/screenshot.py`
loads `source` and `TRUTH` from here.
"""

import math
from dataclasses import replace

import numpy as np

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate, Status
from gcs_sysid.results.history import Acceleration, History
from gcs_sysid.results.result import Result
from gcs_sysid.results.snapshot import (
    Advice,
    Event,
    FoundVehicle,
    Gain,
    LinkState,
    LinkStatus,
    Playback,
    Snapshot,
)
from tests.known_results import result_of
from tests.known_theta import TABLE_1

TRUTH = {
    **TABLE_1,
    "moment_ratio": 6.14e-6 / 2.05e-4,
    "rotational_damping": 0.0,
    "rotor_inertia": 0.0,
}
PLAYING = Playback(position=45.0, duration=180.0, speed=1.0)

# name: value over truth, std over truth, status
_STATE: dict[str, tuple[float, float, Status]] = {
    "mass": (1.0, 0.0, "given"),
    "Ixx": (1.0032, 0.0025, "identified"),
    "Iyy": (0.9971, 0.0031, "identified"),
    "Izz": (1.024, 0.041, "weak"),
    "Ixy": (0.988, 0.011, "identified"),
    "Iyz": (1.019, 0.052, "weak"),
    "Ixz": (1.006, 0.014, "identified"),
    "cg_x": (1.0004, 0.0006, "identified"),
    "cg_y": (0.9993, 0.0008, "identified"),
    "k_T": (1.0006, 0.0004, "identified"),
    "k_M": (0.93, 0.9, "unobservable"),
    "moment_ratio": (0.93, 0.9, "unobservable"),
}

_UNITS = {"mass": "kg", "cg_x": "m", "cg_y": "m", "k_T": "N s^2", "k_M": "N m s^2"}
_UNITS |= {"moment_ratio": "m", "rotational_damping": "N m s", "rotor_inertia": "kg m^2"}


def estimates() -> dict[str, Estimate]:
    """Parameters of every status, one of them without any value."""
    found = {
        name: Estimate(
            TRUTH[name] * factor, abs(TRUTH[name]) * std, _UNITS.get(name, "kg m^2"), status
        )
        for name, (factor, std, status) in _STATE.items()
    }
    found["rotational_damping"] = Estimate(2.1e-3, 3.4e-3, "N m s", "weak")
    found["rotor_inertia"] = Estimate(None, None, "kg m^2", "unobservable")
    return found


def result() -> Result:
    """A result half way through the flight."""
    return result_of(
        estimates(),
        verdict="partial",
        reasons=("Izz, Iyz: fly more yaw", "k_M: unobservable without yaw acceleration"),
        source="udpin:0.0.0.0:14550",
        timing={"rotor_delay": Estimate(0.0118, 0.0004, "s", "identified")},
    )


def history(duration: float = 42.0) -> History:
    """A decaying oscillation onto the final values, with a band that narrows."""
    t = np.arange(0.5, duration, 0.1)
    values, stds = {}, {}
    for index, (name, estimate) in enumerate(estimates().items()):
        if estimate.value is None or estimate.std is None:
            continue
        shape = np.exp(-t / 4.0) * np.cos(0.9 * t + index)
        values[name] = estimate.value * (1.0 + 0.25 * shape * (estimate.status != "given"))
        stds[name] = estimate.std * np.sqrt(duration / t) * (1.0 + 6.0 * np.exp(-t / 6.0))
        values[name][:5] = np.nan
        stds[name][:5] = np.nan
    return History(t=t, value=values, std=stds)


def link(state: LinkState = LinkState.CONNECTED, **changes: object) -> LinkStatus:
    """A link with one message that comes too slowly."""
    return replace(
        LinkStatus(
            state=state,
            url="udpin:0.0.0.0:14550",
            vehicle="PX4 quadrotor 1:1",
            rates={
                "HEARTBEAT": 1.0,
                "HIGHRES_IMU": 249.8,
                "ATTITUDE_QUATERNION": 49.9,
                "ESC_STATUS": 99.7,
                "ACTUATOR_OUTPUT_STATUS": 38.2,
                "LOCAL_POSITION_NED": 30.0,
                "SERVO_OUTPUT_RAW": 0.0,
            },
            asked={
                "HIGHRES_IMU": 250.0,
                "ATTITUDE_QUATERNION": 50.0,
                "ESC_STATUS": 100.0,
                "ACTUATOR_OUTPUT_STATUS": 50.0,
            },
            received=18_934,
            rejected=3,
            unknown=0,
            lost_percent=0.2,
            lost=38,
            gaps=2,
            last_gap=0.31,
            clock_ppm=12.4,
            vehicles=(FoundVehicle((1, 1), "PX4 quadrotor 1:1", True),),
            recording="logs/2025-06-01_101502.tlog",
            bytes_per_second=38_420.0,
        ),
        **changes,  # type: ignore[arg-type]
    )


def acceleration() -> Acceleration:
    """Doublets about all axes, foretold well but about yaw."""
    t = np.linspace(32.4, 42.3, 412)
    motion = np.column_stack(
        [18.0 * np.sin(6.0 * t), 9.0 * np.sin(5.0 * t + 1.0), 3.0 * np.sin(3.0 * t)]
    )
    motion[200:240] *= 0.1
    return Acceleration(t, motion, motion * np.array([1.0, 0.98, 0.7]))


def advice() -> Advice:
    """Half way through what the coach would have flown."""
    return Advice(
        manoeuvre="roll-yaw",
        text="roll and yaw together, ±20°, about 1 Hz, 10 s",
        seconds=10.0,
        progress=0.4,
        gains=(Gain("k_M", None, 0.05), Gain("Iyz", 0.1, 0.04), Gain("Izz", 0.079, 0.03)),
        axes=("roll ±20° 1 Hz", "yaw ±20° 1 Hz"),
    )


def two_vehicles() -> Snapshot:
    """A second vehicle speaks on the same link."""
    vehicles = (*link().vehicles, FoundVehicle((2, 1), "ArduPilot quadrotor 2:1"))
    return replace(snapshot(), link=link(vehicles=vehicles))


def earlier() -> Result:
    """A result of the vehicle before something was hung on its left side."""
    before = estimates()
    before["Ixx"] = replace(before["Ixx"], value=0.0138)
    return replace(result(), source="logs/2025-05-30_091200.tlog", parameters=before)


def snapshot() -> Snapshot:
    """The vehicle in flight, 42 s after the first record."""
    return Snapshot(
        t=42.3,
        used_seconds=31.0,
        flying=True,
        result=result(),
        history=history(),
        link=link(),
        attitude=(math.radians(12.4), math.radians(-5.1), math.radians(87.0)),
        rates=(0.41, -0.22, 0.05),
        rotor_speeds=(101.3, 71.9, 94.4, 118.0),
        acceleration=acceleration(),
        events=(
            Event(0.0, "first message from PX4 quadrotor 1:1"),
            Event(0.4, "asked for HIGHRES_IMU at 250 Hz"),
            Event(6.2, "took off"),
            Event(31.2, "Ixx identified"),
            Event(38.0, "gap of 0.3 s in ESC_STATUS"),
        ),
        health=HEALTH,
    )


def _quantity(value: float, std: float, given: float = 0.0) -> dict[str, object]:
    ci95 = [value - 1.96 * std, value + 1.96 * std]
    return {"value": value, "std": std, "ci95": ci95, "unit": "1", "std_given": given}


def health() -> dict[str, object]:
    """What its hover shows: the CG aft and to the left, rotor 4 at full command at times."""
    shares, gains = (0.236, 0.268, 0.224, 0.272), (1.01, 0.998, 0.995, 0.902)
    return {
        "verdict": "available",
        "reasons": [],
        "objections": [],
        "source": "udpin:0.0.0.0:14550",
        "airframe": load_airframe("px4-quad-x").as_json(),
        "seconds_of_hover": 41.5,
        "rotor_input": "speed",
        "cg": {"x": _quantity(-0.0242, 0.0041, 0.004), "y": _quantity(-0.0013, 0.0037, 0.0036)},
        "yaw_imbalance": _quantity(0.0212, 0.0021),
        "hover_throttle": _quantity(0.483, 0.002),
        "thrust_to_weight": _quantity(2.41, 0.02),
        "drift_per_minute": _quantity(-0.006, 0.002),
        "weakened": None,
        "rotors": [
            {
                "thrust_share": _quantity(share, 0.006),
                "motor_gain": _quantity(gain, 0.004),
                "headroom": _quantity(0.55 - share, 0.01),
                "saturated": 0.012 if number == 3 else 0.0,
                "vibration": _quantity(0.12 * number, 0.01) if number else None,
            }
            for number, (share, gain) in enumerate(zip(shares, gains, strict=True))
        ],
        "advice": [
            "shift the CG 24.2 ± 8.0 mm forward. Battery travel = shift × vehicle mass / battery "
            "mass (computed with --mass and --battery-mass)",
            "motor or ESC 4 turns its rotor with 10 % less speed squared for its command than the "
            "others: look at it",
        ],
    }


HEALTH = health()


def waiting() -> Snapshot:
    """A link on which nobody has spoken."""
    return Snapshot(
        t=0.0,
        used_seconds=0.0,
        flying=False,
        result=replace(result(), verdict="refused", reasons=(), parameters={}, timing={}),
        history=History(np.array([]), {}, {}),
        link=LinkStatus(state=LinkState.WAITING, url="udpin:0.0.0.0:14550"),
    )


def bare() -> Snapshot:
    """A vehicle that speaks, but of which nothing is known yet: no values, no history."""
    nothing = {n: Estimate(None, None, e.unit, "unobservable") for n, e in estimates().items()}
    return replace(
        snapshot(),
        flying=False,
        used_seconds=0.0,
        result=replace(result(), parameters=nothing, timing={}, verdict="refused"),
        history=History(np.array([]), {}, {}),
        attitude=None,
        rates=None,
        rotor_speeds=(),
        acceleration=None,
        events=(),
    )


TARGETS = ("px4-sih", "gazebo-sdf", "urdf", "mjcf", "rotorpy")


class FakeSource:
    """A source that serves one snapshot and notes what is asked of it."""

    def __init__(self, first: Snapshot | None) -> None:
        self.snapshot = first
        self.calls: list[str] = []
        self.recording = True
        self.broken = False

    def latest(self) -> Snapshot | None:
        return self.snapshot

    def mark(self, text: str) -> None:
        self._note(f"mark {text!r}")
        if self.snapshot is not None:
            events = (*self.snapshot.events, Event(self.snapshot.t, text))
            self.snapshot = replace(self.snapshot, events=events)

    def reset(self) -> None:
        self._note("reset")

    def toggle_recording(self) -> str:
        self._note("record")
        self.recording = not self.recording
        return "recording to logs/next.tlog" if self.recording else "recording stopped"

    def set_anchor(self, kind: str, value: float) -> str:
        self._note(f"anchor {kind} {value:g}")
        return f"scale from {kind} = {value:g}"

    def choose_vehicle(self, address: tuple[int, int]) -> str:
        self._note("vehicle {}:{}".format(*address))
        return "restarting on ArduPilot quadrotor 2:1"

    def export(self, target: str, result: Result) -> str:
        self._note(f"export {target} {result.verdict}")
        return f"written: paper.{target}"

    def report(self) -> str:
        self._note("report")
        return "written: flight.html"

    def stop(self) -> None:
        self._note("stop")

    def _note(self, call: str) -> None:
        if self.broken:
            raise InputError("the disk is full")
        self.calls.append(call)


def source() -> FakeSource:
    """What `tools/screenshot.py` shows."""
    return FakeSource(snapshot())
