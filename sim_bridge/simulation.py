"""A flight: physics, controller and mission tied together on one 1 kHz clock."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim_bridge.controller import Controller
from sim_bridge.dynamics import CALM, STEP, Disturbance, Dynamics, State
from sim_bridge.missions import HEIGHT, Mission
from sim_bridge.vehicle import Value, Vehicle, hover_thrusts

CONTROL_STEPS = 4
"""Physics steps a control period: 250 Hz."""


@dataclass(frozen=True)
class Change:
    """A change of the vehicle in flight.

    Attributes:
        time: s after the start.
        kind: as in a result's events.
        apply: makes the vehicle after it from the one before. It may change anything, inertia and
            CG included; the state goes on unchanged, so a CG that moves leaves the velocity of
            the new CG off by w x (shift), millimetres a second.
    """

    time: float
    kind: str
    apply: Callable[[Vehicle], Vehicle]


def mass_step(time: float, factor: float) -> Change:
    """The mass multiplied at a time; inertia and CG stay."""
    return Change(time, "mass_change", lambda vehicle: vehicle.with_mass_factor(factor))


class Turbulence:
    """Gentle random forces and torques: first-order coloured noise, held over a control period.

    Attributes:
        wobble: body rates it makes under the controller, rad/s rms, roughly.
    """

    CORNER = 3.0
    """rad/s, corner of the gusts."""
    TORQUE_GAIN = 14.0
    """rad/s^2 of torque over inertia for 1 rad/s of wobble: the rate loop pushes back with this."""
    FORCE_GAIN = 5.0
    """m/s^2 of force over mass for 1 rad/s of wobble."""

    def __init__(self, vehicle: Vehicle, wobble: float, seed: np.random.SeedSequence) -> None:
        self.wobble = wobble
        self._random = np.random.default_rng(seed)
        self._keep = float(np.exp(-self.CORNER * STEP * CONTROL_STEPS))
        self._fresh = float(np.sqrt(1.0 - self._keep**2))
        self._gust = [0.0] * 6
        force = self.FORCE_GAIN * wobble * vehicle.mass
        torque = self.TORQUE_GAIN * wobble
        self._scale = (
            force,
            force,
            force,
            torque * vehicle.Ixx,
            torque * vehicle.Iyy,
            # A quarter in yaw: gusts turn a multirotor least about its upright axis.
            0.25 * torque * vehicle.Izz,
        )

    def next(self) -> Disturbance:
        """The disturbance for the next control period."""
        if self.wobble == 0.0:
            return CALM
        keep, fresh = self._keep, self._fresh
        self._gust = [
            keep * g + fresh * n
            for g, n in zip(self._gust, self._random.standard_normal(6).tolist(), strict=True)
        ]
        f_x, f_y, f_z, t_x, t_y, t_z = (s * g for s, g in zip(self._scale, self._gust, strict=True))
        return Disturbance((f_x, f_y, f_z), (t_x, t_y, t_z))


class Simulation:
    """One vehicle, or an ensemble, flying a mission from trim.

    Attributes:
        dynamics: the physics with the parameters in force.
        state: at time `tick` * 1 ms.
        targets: rotor-speed targets in force, rad/s.
        disturbance: in force.
        tick: physics steps since the start.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        mission: Mission,
        seed: np.random.SeedSequence,
        turbulence: float | None = None,
        changes: Sequence[Change] = (),
    ) -> None:
        self.dynamics = Dynamics(vehicle)
        self.mission = mission
        self.tick = 0
        self.done: list[tuple[Change, Vehicle, Vehicle]] = []
        self._changes = sorted(changes, key=lambda change: change.time)
        self._controller = Controller(vehicle, CONTROL_STEPS * STEP)
        wobble = mission.turbulence if turbulence is None else turbulence
        self._turbulence = Turbulence(vehicle, wobble, seed)
        self.state = trim(vehicle)
        self.targets: list[Value] = list(self.state.speeds)
        self.disturbance = CALM
        self._control()

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.tick * STEP

    @property
    def vehicle(self) -> Vehicle:
        """The parameters in force."""
        return self.dynamics.vehicle

    def step(self) -> None:
        """Advance by one physics step; the controller acts on the state reached."""
        self.state = self.dynamics.step(self.state, self.targets, self.disturbance)
        self.tick += 1
        while self._changes and self._changes[0].time <= self.time:
            change = self._changes.pop(0)
            before = self.vehicle
            self.dynamics.use(change.apply(before))
            self.done.append((change, before, self.vehicle))
        if self.tick % CONTROL_STEPS == 0:
            self._control()

    def _control(self) -> None:
        self.targets = self._controller.update(self.state, self.mission.reference(self.time))
        self.disturbance = self._turbulence.next()


def trim(vehicle: Vehicle) -> State:
    """Steady hover, level, heading north, at mission height."""
    speeds = [(thrust / vehicle.k_T) ** 0.5 for thrust in hover_thrusts(vehicle)]
    zero = 0.0 * speeds[0]
    body = [zero, zero, zero - HEIGHT, zero, zero, zero, zero + 1.0, *[zero] * 6]
    return State(body, speeds)
