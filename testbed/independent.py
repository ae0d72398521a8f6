"""Flights on physics that is none of ours: rotorpy's with aerodynamics, and MuJoCo's in air.

Both fly closed loop under the emulator's controller and talk through its PX4, so that the program
reads what a vehicle would send. Only the equations of motion and of the air are theirs. They come
with the development extra `exports`; without them these scenarios are left out.

rotorpy (Folk, Paulos and Kumar, 2023): wrench and first-order rotor speeds of `Multirotor`, rotor
drag, inflow, translational lift and quadratic drag in proportion to its own Hummingbird's.
MuJoCo: a free body in air of 1.2 kg/m^3, whose drag is that of the box of equal inertia.
"""

import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.dynamics import CALM, State
from sim_bridge.missions import Mission
from sim_bridge.physics import IDEAL
from sim_bridge.simulated_vehicle import Value, Vehicle, hover_thrusts
from sim_bridge.simulation import Simulation, trim
from testbed.emulated import Recording, describe, write
from testbed.scenarios import known_exactly, measured
from testbed.vehicles import LAYOUTS, Drawn, draw

STEP_US = 2000
"""us a step of theirs."""
FLIP = np.array([1.0, -1.0, -1.0])
"""Forward, right, down to forward, left, up, and back."""
_JUDGED = (
    "mass", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M", "moment_ratio",
)  # fmt: skip
"""Drag and damping are theirs and no one number."""


class Plant(Protocol):
    """Equations of motion of an outside simulator, in our axes."""

    def advance(self, targets: list[Value], seconds: float) -> None:
        """Go on by a step with these rotor-speed targets, rad/s."""
        ...

    @property
    def state(self) -> State:
        """Where the vehicle is."""
        ...

    def force(self) -> list[float]:
        """Specific force at the CG, body axes, m/s^2."""
        ...


class OtherSimulation(Simulation):
    """The emulator's controller and messages around an outside simulator's physics."""

    def __init__(self, vehicle: Vehicle, mission: Mission, plant: Plant) -> None:
        super().__init__(
            vehicle,
            mission,
            np.random.SeedSequence(0),
            0.0,
            step_us=STEP_US,
            control_steps=2,
        )
        self._plant = plant
        self.disturbance = CALM

    def step(self) -> None:
        """Advance by one step; the controller acts on the state reached."""
        self._plant.advance(self.targets, self.step_size)
        self.state = self._plant.state
        self.tick += 1
        if self.tick % self._control_steps == 0:
            self._control()

    def imu(self) -> tuple[list[Value], list[Value]]:
        """What perfect inertial sensors at the CG read."""
        return list(self.state.rates), self._plant.force()


def _turned(J: Array) -> Array:
    """A matrix in the other axes."""
    flipped: Array = FLIP[:, None] * J * FLIP
    return flipped


def _inertia(v: Vehicle) -> Array:
    return np.array([[v.Ixx, v.Ixy, v.Ixz], [v.Ixy, v.Iyy, v.Iyz], [v.Ixz, v.Iyz, v.Izz]])


def _hover(v: Vehicle) -> Array:
    return np.array([(thrust / v.k_T) ** 0.5 for thrust in hover_thrusts(v)])


class RotorPy:
    """rotorpy's `Multirotor`, stepped by RK4."""

    def __init__(self, vehicle: Vehicle, start: State) -> None:
        from rotorpy.vehicles.multirotor import Multirotor

        v = vehicle
        hover = _hover(v)
        J = _turned(_inertia(v))
        air = v.mass / hover.sum()
        parameters = {
            "mass": v.mass,
            "Ixx": J[0, 0],
            "Iyy": J[1, 1],
            "Izz": J[2, 2],
            "Ixy": J[0, 1],
            "Iyz": J[1, 2],
            "Ixz": J[0, 2],
            "num_rotors": len(v.rotors),
            "rotor_pos": {
                f"r{i}": np.array([r.x - v.cg_x, -(r.y - v.cg_y), 0.0])
                for i, r in enumerate(v.rotors)
            },
            "rotor_directions": np.array([-r.spin for r in v.rotors]),
            "k_eta": v.k_T,
            "k_m": v.k_M,
            "tau_m": v.motor_lag,
            "rotor_speed_min": 0.0,
            "rotor_speed_max": 10.0 * hover.max(),
            # Its Hummingbird's: 0.5 kg, 470 rad/s in hover.
            "k_d": 0.45 * air,
            "k_z": 0.87 * air,
            "k_h": 0.0028 * v.mass * GRAVITY / len(v.rotors),
            "c_Dx": 0.010 * v.mass,
            "c_Dy": 0.010 * v.mass,
            "c_Dz": 0.020 * v.mass,
        }
        self._v = v
        self._body = Multirotor(parameters, aero=True)
        self._body.weight = np.array([0.0, 0.0, -v.mass * GRAVITY])
        place, velocity = np.array(start.position) * FLIP, np.array(start.velocity) * FLIP
        upright = [0.0, 0.0, 0.0, 1.0]
        self._s = np.concatenate([place, velocity, upright, np.zeros(6), hover])

    def advance(self, targets: list[Value], seconds: float) -> None:
        """Runge and Kutta's rule of fourth order on rotorpy's derivative."""
        slope, s, u = self._body._s_dot_fn, self._s, np.array(targets)
        a = slope(0.0, s, u)
        b = slope(0.0, s + 0.5 * seconds * a, u)
        c = slope(0.0, s + 0.5 * seconds * b, u)
        d = slope(0.0, s + seconds * c, u)
        s = s + seconds / 6.0 * (a + 2.0 * (b + c) + d)
        s[6:10] /= np.linalg.norm(s[6:10])
        self._s = s

    @property
    def state(self) -> State:
        """Turned into our axes: rotorpy's quaternions end with the real part."""
        s = self._s
        x, y, z, w = s[6:10]
        body = [*(s[0:3] * FLIP), *(s[3:6] * FLIP), w, x, -y, -z, *(s[10:13] * FLIP)]
        return State([float(u) for u in body], s[16:].tolist())

    def force(self) -> list[float]:
        """Specific force."""
        from scipy.spatial.transform import Rotation

        s = self._s
        air = Rotation.from_quat(s[6:10]).inv().apply(s[3:6])
        force, _ = self._body.compute_body_wrench(s[10:13], s[16:], air)
        felt: list[float] = (force / self._v.mass * FLIP).tolist()
        return felt


class MuJoCo:
    """A free body in MuJoCo's air, pulled by rotors with first-order speeds."""

    def __init__(self, vehicle: Vehicle, start: State) -> None:
        import mujoco

        v = vehicle
        J = _turned(_inertia(v))
        six = " ".join(f"{x:.17g}" for x in (*np.diag(J), J[0, 1], J[0, 2], J[1, 2]))
        self._mj = mujoco
        self._model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><option timestep="{1e-6 * STEP_US}" integrator="RK4" density="1.2"
            viscosity="1.8e-5" gravity="0 0 {-GRAVITY}"/><worldbody><body name="base">
            <freejoint/><inertial pos="0 0 0" mass="{v.mass:.17g}" fullinertia="{six}"/>
            </body></worldbody></mujoco>"""
        )
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:3] = np.array(start.position) * FLIP
        self._v = v
        self._speeds = _hover(v)
        x = np.array([r.x - v.cg_x for r in v.rotors])
        y = -np.array([r.y - v.cg_y for r in v.rotors])
        spins = np.array([r.spin for r in v.rotors])
        # Force up, torques about forward, left and up, of each rotor's speed squared.
        self._mix = np.array([v.k_T + 0.0 * x, v.k_T * y, -v.k_T * x, -v.k_M * spins])

    def advance(self, targets: list[Value], seconds: float) -> None:
        """One step; the rotors' force is that of the middle of it."""
        u, tau = np.array(targets), self._v.motor_lag
        keep = float(np.exp(-0.5 * seconds / tau))
        middle = u + (self._speeds - u) * keep
        self._pull(middle)
        self._mj.mj_step(self._model, self._data)
        self._speeds = u + (middle - u) * keep

    def _pull(self, speeds: Array) -> None:
        R = self._rotation()
        up, *moments = self._mix @ speeds**2
        self._data.xfrc_applied[1, :3] = R[:, 2] * up
        self._data.xfrc_applied[1, 3:] = R @ np.array(moments)

    def _rotation(self) -> Array:
        R = np.empty(9)
        self._mj.mju_quat2Mat(R, self._data.qpos[3:7])
        return R.reshape(3, 3)

    @property
    def state(self) -> State:
        """Turned into our axes."""
        q, v = self._data.qpos, self._data.qvel
        w, x, y, z = q[3:7]
        body = [*(q[:3] * FLIP), *(v[:3] * FLIP), w, x, -y, -z, *(v[3:] * FLIP)]
        return State([float(u) for u in body], self._speeds.tolist())

    def force(self) -> list[float]:
        """Specific force with the rotors as they are now."""
        self._pull(self._speeds)
        self._mj.mj_forward(self._model, self._data)
        felt = self._data.qacc[:3] + np.array([0.0, 0.0, GRAVITY])
        told: list[float] = (self._rotation().T @ felt * FLIP).tolist()
        return told


PLANTS: dict[str, tuple[str, Any, tuple[str, ...], str]] = {
    "rotorpy": (
        "rotorpy",
        RotorPy,
        ("quad-x", "quad-plus", "quad-h"),
        "rotorpy's physics, aerodynamics on",
    ),
    "mujoco": ("mujoco", MuJoCo, LAYOUTS, "MuJoCo's physics, in air"),
}
"""Scenario to package, plant, layouts it can fly, and what it is."""


def available() -> list[str]:
    """Those whose package is installed."""
    return [name for name, (package, *_) in PLANTS.items() if importlib.util.find_spec(package)]


def record(name: str, number: int, folder: Path, seconds: float | None = None) -> Recording:
    """Fly one vehicle.

    Args:
        name: of `PLANTS`.
        number: of the vehicle.
        folder: for the file.
        seconds: of flight; None for the whole mission.
    """
    _, plant_of, layouts, _ = PLANTS[name]
    drawn: Drawn = draw(number, layouts)
    vehicle = plain(drawn.vehicle)
    simulation = OtherSimulation(
        vehicle, drawn.mission("doublets", 2.0, 1.5), plant_of(vehicle, trim(vehicle))
    )
    log = folder / f"{name}_{number}.tlog"
    write(simulation, log, number, 250.0, seconds)
    truth = {key: value for key, value in vehicle.truth().items() if key in _JUDGED}
    errors = np.random.default_rng([number, *name.encode()])
    user, exact = measured(drawn.airframe, errors), known_exactly(drawn.airframe, IDEAL)
    return Recording(log, user, exact, truth, describe(drawn))


def plain(vehicle: Vehicle) -> Vehicle:
    """Without what the others' physics lacks: rotor inertia, linear drag, damping."""
    return replace(vehicle, rotor_inertia=0.0, linear_drag=0.0, rotational_damping=0.0)
