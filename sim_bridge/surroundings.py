"""Everything that acts on the vehicle besides its ideal rotors, drag and damping.

Forces and moments are computed once a control period (4 ms as PX4, 2.5 ms as ArduPilot), on the
state it begins with, and held over it: they are slow beside what `dynamics` integrates by RK4, and
the accelerometer, read at the same instants, has them of that instant. What is fast is not in here
but in `dynamics` and `uneven_rotors`: unequal and canted rotors, damping of each axis, every lag.
"""

from dataclasses import replace

import numpy as np

from sim_bridge.aerodynamics import Aerodynamics
from sim_bridge.battery import Battery
from sim_bridge.dynamics import Disturbance, Dynamics, State, rotate_to_body, rotate_to_world
from sim_bridge.ground_effect import thrust_gain
from sim_bridge.loads import Slosh, Swing
from sim_bridge.physics import Physics
from sim_bridge.random_forces import RandomForces
from sim_bridge.simulated_vehicle import Value, Vehicle, even
from sim_bridge.wind import Wind


class Surroundings:
    """What `Physics` switches on, at work on one vehicle or an ensemble.

    Attributes:
        battery: where it sags; None where it does not.
        wind: None in a calm.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        physics: Physics,
        period: float,
        seed: np.random.SeedSequence,
    ) -> None:
        forces, wind = seed.spawn(2)
        arm = sum(np.hypot(r.x, r.y) for r in vehicle.rotors) / len(vehicle.rotors)
        on = physics
        self._physics = physics
        self._h = period
        self.wind = Wind(on, 2.0 * arm, period, wind) if on.wind[0] or on.gusts else None
        self.battery = Battery(on, vehicle, period) if on.battery[0] or on.battery_drop else None
        self._air = Aerodynamics(vehicle, on) if on.has_air else None
        self._radius = float(on.ground_effect * arm)
        random = RandomForces(on, period, forces)
        self._random = random if random.turns or random.pushes else None
        self._slosh = Slosh(vehicle, *on.slosh, period) if on.slosh[0] else None
        self._swing = Swing(vehicle, *on.swing, period) if on.swing[0] else None
        self._before: State | None = None
        self._lost = 0.0

    def advance(self, dynamics: Dynamics, flown: float, speeds: list[Value]) -> None:
        """Go on by one control period: wind, battery, and a rotor that weakens."""
        if self.wind is not None:
            self.wind.advance()
        if self.battery is not None:
            self.battery.advance(flown, speeds)
        weakening = self._physics.weakening
        if weakening is not None and weakening.rotor <= len(speeds):
            vehicle, rotor = dynamics.vehicle, weakening.rotor - 1
            lost = weakening.lost(flown)
            if lost != self._lost:
                traits = vehicle.traits or even(len(speeds))
                # Of what is left, so that the scatter stays.
                share = 1.0 - (1.0 - lost) / (1.0 - self._lost)
                self._lost = lost
                dynamics.use(replace(vehicle, traits=traits.weakened(rotor, share)))

    def rest(self) -> None:
        """The vehicle stands on the ground: no motion goes on from before."""
        self._before = None

    def disturbance(self, dynamics: Dynamics, state: State, gust: Disturbance) -> Disturbance:
        """Force and moment at this state.

        Args:
            dynamics: with the parameters in force.
            state: where the vehicle is.
            gust: of the gentle turbulence, to add to.
        """
        x, y, z = gust.force
        t_x, t_y, t_z = gust.torque
        v, q = dynamics.vehicle, state.quaternion
        b_x = b_y = b_z = 0.0
        vx, vy, vz = state.velocity
        p, q_rate, r = state.rates
        if self.wind is not None:
            wind_x, wind_y, wind_z = self.wind.velocity
            gust_p, gust_q = self.wind.rates
            # `dynamics` has the linear drag of air at rest.
            D = v.linear_drag
            x, y, z = x + D * wind_x, y + D * wind_y, z + D * wind_z
            vx, vy, vz = vx - wind_x, vy - wind_y, vz - wind_z
        else:
            gust_p = gust_q = 0.0
        if self._air is not None:
            air = rotate_to_body(q, (vx, vy, vz))
            f_x, f_y, f_z, m_x, m_y, m_z = self._air.wrench(
                air, (p - gust_p, q_rate - gust_q, r), state.speeds
            )
            b_x, b_y, b_z = b_x + f_x, b_y + f_y, b_z + f_z
            t_x, t_y, t_z = t_x + m_x, t_y + m_y, t_z + m_z
        if dynamics.uneven is not None and dynamics.uneven.canted:
            f_x, f_y = dynamics.uneven.side_force(state.speeds)
            b_x, b_y = b_x + f_x, b_y + f_y
        if self._radius:
            gain = thrust_gain(-state.body[2], self._radius)
            thrust, m_x, m_y = dynamics.wrench(state.speeds, state.speeds)[:3]
            b_z, t_x, t_y = b_z - gain * thrust, t_x + gain * m_x, t_y + gain * m_y
        if self._random is not None:
            a, b, c, d, e, f = self._random.next()
            t_x = t_x + v.Ixx * a + v.Ixy * b + v.Ixz * c
            t_y = t_y + v.Ixy * a + v.Iyy * b + v.Iyz * c
            t_z = t_z + v.Ixz * a + v.Iyz * b + v.Izz * c
            b_x, b_y, b_z = b_x + v.mass * d, b_y + v.mass * e, b_z + v.mass * f
        if self._slosh is not None or self._swing is not None:
            (x, y, z), (l_x, l_y, m_x, m_y, m_z) = self._loads(dynamics, state, (x, y, z))
            b_x, b_y = b_x + l_x, b_y + l_y
            t_x, t_y, t_z = t_x + m_x, t_y + m_y, t_z + m_z
        w_x, w_y, w_z = rotate_to_world(q, (b_x, b_y, b_z))
        return Disturbance((x + w_x, y + w_y, z + w_z), (t_x, t_y, t_z))

    def _loads(
        self, dynamics: Dynamics, state: State, force: tuple[Value, Value, Value]
    ) -> tuple[tuple[Value, Value, Value], tuple[Value, ...]]:
        """World force with that of the line, and the loads' F_x, F_y, M_x, M_y, M_z."""
        before, self._before = (self._before or state).body, state
        now, rate = state.body, 1.0 / self._h
        felt = (
            (now[3] - before[3]) * rate,
            (now[4] - before[4]) * rate,
            (now[5] - before[5]) * rate - dynamics.gravity,
        )
        l_x = l_y = m_x = m_y = m_z = 0.0
        if self._slosh is not None:
            own = rotate_to_body(state.quaternion, felt)
            turning = tuple((b - a) * rate for a, b in zip(before[10:], now[10:], strict=True))
            l_x, l_y, m_x, m_y, m_z = self._slosh.wrench(own, turning)
        if self._swing is not None:
            pull, tension = self._swing.pull(felt)
            force = (force[0] + pull[0], force[1] + pull[1], force[2] + pull[2])
            n_x, n_y, _ = rotate_to_body(state.quaternion, tension)
            hook = self._swing.hook
            m_x, m_y = m_x - hook * n_y, m_y + hook * n_x
        return force, (l_x, l_y, m_x, m_y, m_z)
