"""What the air does to rotors and body beyond thrust with the square of speed.

With V = (u, v, w) the velocity of the CG relative to the air in body axes (forward, right, down),
r_i = (x_i, y_i, z) the hub of rotor i from the CG, and V_i = V + omega x r_i its own velocity:

    H_i = -k_D Omega_i (u_i, v_i)                      rotor drag (H-force), at the hub
    T_i = k_T Omega_i^2 + k_z Omega_i w_i + k_h (u^2 + v^2)
    M_i = -k_f Omega_i (v, -u)                         blade flapping, about the hub
    F   = -c |V| V                                     the body's drag

w_i > 0 is descent, so climb costs thrust and descent gains some, in the linear range short of the
vortex ring. The lumped coefficients k_D, k_z, k_h and k_f are those of Svacha, Mohta and Kumar,
"Improving quadrotor trajectory tracking by compensating for aerodynamic effects" (ICUAS 2017),
who derive them from blade-element theory; H-force and flapping also in Mahony, Kumar and Corke,
"Multirotor aerial vehicles" (IEEE RAM 2012), k_D and k_z as accelerations over speed in Faessler,
Franchi and Scaramuzza (RA-L 2018). For k_h, the vehicle's own speed approximates that of each hub.

All but k_h and c are linear in Omega_i, so the rotors enter by six sums over them alone. Values
are floats, or arrays of shape (N,) for an ensemble.
"""

from collections.abc import Sequence

from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.physics import Physics
from sim_bridge.simulated_vehicle import Value, Vehicle, hover_thrusts


class Aerodynamics:
    """Aerodynamic force and moment about the CG, body axes.

    Attributes:
        k_D: rotor drag, N s^2/(rad m).
        k_z: thrust lost against the inflow, N s^2/(rad m).
        k_h: thrust gained in forward flight, N s^2/m^2 a rotor.
        k_f: flapping moment, N s^2/rad.
        c: drag of the body, N s^2/m^2.
    """

    def __init__(self, vehicle: Vehicle, physics: Physics) -> None:
        v = vehicle
        hover = sum((thrust / v.k_T) ** 0.5 for thrust in hover_thrusts(v))
        self.k_D: Value = physics.rotor_drag * v.mass / hover
        self.k_z: Value = physics.inflow * v.mass / hover
        self.k_h: Value = physics.forward_lift * v.mass * GRAVITY / len(v.rotors)
        self.k_f: Value = physics.flapping * 0.5 * (v.Ixx + v.Iyy) / hover
        fall = physics.quadratic_drag
        self.c: Value = v.mass * GRAVITY / (fall * fall) if fall else 0.0
        self._z = v.rotor_z
        places = [(r.x - v.cg_x, r.y - v.cg_y) for r in v.rotors]
        self._places = [(x, y, x * x, x * y, y * y) for x, y in places]
        self._x: Value = sum(x for x, _ in places)
        self._y: Value = sum(y for _, y in places)

    def wrench(
        self, air: Sequence[Value], rates: Sequence[Value], speeds: Sequence[Value]
    ) -> tuple[Value, Value, Value, Value, Value, Value]:
        """F_x, F_y, F_z in N, M_x, M_y, M_z in N m.

        Args:
            air: velocity of the CG relative to the air, body axes, m/s.
            rates: body rates relative to the air's own rotation, rad/s.
            speeds: of the rotors, rad/s.
        """
        u, v, w = air
        p, q, r = rates
        s = s_x = s_y = s_xx = s_xy = s_yy = 0.0
        for (x, y, xx, xy, yy), speed in zip(self._places, speeds, strict=True):
            s = s + speed
            s_x = s_x + x * speed
            s_y = s_y + y * speed
            s_xx = s_xx + xx * speed
            s_xy = s_xy + xy * speed
            s_yy = s_yy + yy * speed
        z, k_D, k_z, k_f = self._z, self.k_D, self.k_z, self.k_f
        across = u * u + v * v
        # Velocity of the hubs' plane at the CG's place in it.
        u_h, v_h = u + q * z, v - p * z
        h_x = -k_D * (u_h * s - r * s_y)
        h_y = -k_D * (v_h * s + r * s_x)
        # Of the single rotor, -Delta T_i is the force along z.
        lift = self.k_h * across
        f_z = -k_z * (w * s + p * s_y - q * s_x) - lift * len(speeds)
        body = self.c * (across + w * w) ** 0.5
        return (
            h_x - body * u,
            h_y - body * v,
            f_z - body * w,
            -z * h_y - k_z * (w * s_y + p * s_yy - q * s_xy) - lift * self._y - k_f * s * v,
            z * h_x + k_z * (w * s_x + p * s_xy - q * s_xx) + lift * self._x + k_f * s * u,
            -k_D * (v_h * s_x - u_h * s_y + r * (s_xx + s_yy)),
        )
