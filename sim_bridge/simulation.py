"""A flight: physics, controller and mission tied together on one clock."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gcs_sysid.model.attitude import from_euler
from sim_bridge.battery import voltage
from sim_bridge.controller import Controller
from sim_bridge.dynamics import CALM, STEP_US, Disturbance, Dynamics, State, rotate_to_body
from sim_bridge.ground_cycle import GroundCycle
from sim_bridge.missions import HEIGHT, Mission
from sim_bridge.physics import IDEAL, Physics
from sim_bridge.set_points import SetPoints
from sim_bridge.simulated_vehicle import Value, Vehicle, hover_thrusts
from sim_bridge.surroundings import Surroundings

CONTROL_STEPS = 4
"""Usual physics steps a control period: 250 Hz."""

_PHYSICS = 0x9457
"""Sets the randomness of the physics apart from that of the flight."""


@dataclass(frozen=True)
class Change:
    """A change of the vehicle in flight.

    Attributes:
        time: s after the start.
        kind: as in a result's events.
        apply: makes the vehicle after it from the one before. It may change anything, inertia and
            CG included; the state goes on unchanged, so a CG that moves leaves the velocity of
            the new CG off by w x (shift), millimeters a second.
    """

    time: float
    kind: str
    apply: Callable[[Vehicle], Vehicle]


def mass_step(time: float, factor: float) -> Change:
    """The mass multiplied at a time; inertia and CG stay."""
    return Change(time, "mass_change", lambda vehicle: vehicle.with_mass_factor(factor))


class Turbulence:
    """Gentle random forces and torques: first-order colored noise, held over a control period.

    Attributes:
        wobble: body rates it makes under the controller, rad/s rms, roughly.
    """

    CORNER = 3.0
    """rad/s, corner of the gusts."""
    TORQUE_GAIN = 14.0
    """rad/s^2 of torque over inertia for 1 rad/s of wobble: the rate loop pushes back with this."""
    FORCE_GAIN = 5.0
    """m/s^2 of force over mass for 1 rad/s of wobble."""

    def __init__(
        self, vehicle: Vehicle, wobble: float, period: float, seed: np.random.SeedSequence
    ) -> None:
        self.wobble = wobble
        self._random = np.random.default_rng(seed)
        self._keep = float(np.exp(-self.CORNER * period))
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
    """One vehicle, or an ensemble, flying a mission from trim; or one on an outing.

    Attributes:
        dynamics: the physics with the parameters in force.
        state: at this step.
        physics: what is switched on.
        targets: rotor-speed targets in force, rad/s, as commanded.
        drives: the same as the battery lets the motors have them.
        disturbance: in force.
        tick: physics steps since the start.
        step_us: us in a physics step; step_size is the same in s.
        grounded: whether the vehicle stands on the ground.
        armed: whether its rotors may turn.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        mission: Mission,
        seed: np.random.SeedSequence,
        turbulence: float | None = None,
        changes: Sequence[Change] = (),
        step_us: int = STEP_US,
        control_steps: int = CONTROL_STEPS,
        physics: Physics = IDEAL,
        controller: Callable[[Vehicle, float], Controller] = Controller,
    ) -> None:
        self.step_us = step_us
        self.step_size = 1e-6 * step_us
        self.physics = physics
        own = _apart(seed)
        vehicle = physics.of_vehicle(vehicle, np.random.default_rng(own.spawn(1)[0]))
        self.dynamics = Dynamics(vehicle, step_size=self.step_size)
        self.mission = mission
        self.tick = 0
        self.done: list[tuple[Change, Vehicle, Vehicle]] = []
        self._changes = sorted(changes, key=lambda change: change.time)
        self._control_steps = control_steps
        self._period = control_steps * self.step_size
        self._set_points = SetPoints(mission, self.step_size, control_steps)
        self._make_controller = controller
        self._controller = controller(vehicle, self._period)
        wobble = mission.turbulence if turbulence is None else turbulence
        self._turbulence = Turbulence(vehicle, wobble, self._period, seed)
        self._surroundings = (
            Surroundings(vehicle, physics, self._period, own) if physics.switched_on else None
        )
        self._whole: Vehicle | None = None
        self._misaligned = any(physics.imu_rotation)
        self._imu_turn = from_euler(*physics.imu_rotation)
        self.state = trim(vehicle)
        self.targets: list[Value] = list(self.state.speeds)
        self.drives = self.targets
        self.disturbance = CALM
        self.armed = True
        self.grounded = False
        self._ground_cycle = mission if isinstance(mission, GroundCycle) else None
        if self._ground_cycle is not None:
            self._stand()
        else:
            self._control()

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.tick * self.step_size

    @property
    def vehicle(self) -> Vehicle:
        """The parameters in force."""
        return self.dynamics.vehicle

    def step(self) -> None:
        """Advance by one physics step; the controller acts on the state reached."""
        state = self.dynamics.step(self.state, self.drives, self.disturbance)
        if self.grounded:
            # The ground holds the body; the rotors are free to turn.
            state.body = self.state.body
        self.state = state
        self._controller.observe(state, self.step_size)
        self.tick += 1
        while self._changes and self._changes[0].time <= self.time:
            change = self._changes.pop(0)
            before = self.vehicle
            self.dynamics.use(change.apply(before))
            self.done.append((change, before, self.vehicle))
        if self.tick % self._control_steps == 0:
            if self._ground_cycle is not None and self._ground_cycle.is_grounded(self.time):
                self._stand()
            else:
                self._control()

    @property
    def voltage(self) -> Value:
        """Of the battery, V."""
        battery = self._surroundings.battery if self._surroundings is not None else None
        return voltage(self.time) if battery is None else battery.voltage

    def rates(self) -> list[Value]:
        """Body rates in the IMU's axes, rad/s."""
        rates = self.state.rates
        return list(rotate_to_body(self._imu_turn, rates)) if self._misaligned else rates

    def imu(self) -> tuple[list[Value], list[Value]]:
        """What perfect inertial sensors read: body rates (rad/s), specific force (m/s^2)."""
        if self.grounded:
            up = (0.0, 0.0, -self.dynamics.gravity)
            gyro, force = [0.0, 0.0, 0.0], list(rotate_to_body(self.state.quaternion, up))
        else:
            gyro, force = self.dynamics.imu(self.state, self.drives, self.disturbance)
        if not self._misaligned:
            return gyro, force
        turn = self._imu_turn
        return list(rotate_to_body(turn, gyro)), list(rotate_to_body(turn, force))

    def _stand(self) -> None:
        """On the ground: rotors stopped, or turning with not quite the thrust to leave it."""
        assert self._ground_cycle is not None
        self.armed = self._ground_cycle.is_armed(self.time)
        idle = trim(self.vehicle).speeds
        if not self.grounded:
            self.grounded = True
            x, y, _ = self.state.position
            if self.tick == 0:
                self.state.speeds = [0.0] * len(idle)
            a, _, _, d = self.state.quaternion
            norm = (a * a + d * d) ** 0.5
            level = [a / norm, 0.0, 0.0, d / norm]
            self.state.body = [x, y, 0.0, 0.0, 0.0, 0.0, *level, 0.0, 0.0, 0.0]
        self.targets = [0.97 * speed if self.armed else 0.0 for speed in idle]
        self.disturbance = CALM
        self._surround()

    def _control(self) -> None:
        if self.grounded:
            self.grounded = False
            # A controller of the last flight has wound up its integrators.
            self._controller = self._make_controller(self.vehicle, self._period)
        physics = self.physics
        self._controller.full_throttle = physics.punch_out is not None and physics.punch_out.holds(
            self.time
        )
        self.targets = self._controller.update(self.state, self._set_points.at(self.tick))
        if physics.throttle_cut is not None and physics.throttle_cut.holds(self.time):
            self.targets = [self.vehicle.speed_of(physics.idle)] * len(self.targets)
        self.disturbance = self._turbulence.next()
        self._surround()

    def _surround(self) -> None:
        """What changes from one control period to the next around the vehicle."""
        self.drives = self.targets
        if self._surroundings is None:
            return
        before = self.vehicle
        self._surroundings.advance(self.dynamics, self.time, self.state.speeds)
        weakening = self.physics.weakening
        if weakening is not None and self.vehicle is not before:
            self._whole = self._whole or before
            if weakening.lost(self.time) == weakening.share:
                change = Change(weakening.start, "rotor_failure", lambda vehicle: vehicle)
                self.done.append((change, self._whole, self.vehicle))
        if self.grounded:
            self._surroundings.rest()
        battery = self._surroundings.battery
        if battery is not None:
            self.drives = [battery.ratio * target for target in self.targets]
        if not self.grounded:
            self.disturbance = self._surroundings.disturbance(
                self.dynamics, self.state, self.disturbance
            )


def _apart(seed: np.random.SeedSequence) -> np.random.SeedSequence:
    """A seed of its own for the physics, so that the gusts' draws stay what they are without."""
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, _PHYSICS))


def trim(vehicle: Vehicle) -> State:
    """Steady hover, level, heading north, at mission height."""
    speeds = [(thrust / vehicle.k_T) ** 0.5 for thrust in hover_thrusts(vehicle)]
    zero = 0.0 * speeds[0]
    body = [zero, zero, zero - HEIGHT, zero, zero, zero, zero + 1.0, *[zero] * 6]
    return State(body, speeds)
