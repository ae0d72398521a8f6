"""The estimators that are entered: what others would take, each as its own page shows it.

All are given the thrust signals of squared speeds (of commands, their squares) and the mass. They
claim what the flight made more certain than it was before, by their own standard deviation.
"""

import contextlib
import importlib.util
import io
from functools import partial

import numpy as np
from scipy.signal import savgol_filter

from benchmarks.public.flight import Claims, Entry, Flight, Stretch
from gcs_sysid.arrays import Array
from gcs_sysid.model import rigid_body as rb

CLAIM = 0.2
"""Largest standard deviation of a claim, of the value (of a CG: of a tenth of the arm)."""
WINDOW = 0.1
"""s of the filters that smooth and differentiate."""
_START_ARM2 = np.array([0.2, 0.2, 0.36])
"""Ixx, Iyy, Izz of a multirotor in masses times arms squared, as from a drawing."""
_START_MOMENT = 0.1
"""k_M / k_T in arms."""
_START_ROTOR = 3e-3
"""Inertia of a rotor, of Izz."""


def claims_of(flight: Flight, values: dict[str, float], stds: dict[str, float]) -> Claims:
    """What is certain enough to be claimed; thrust and its ratios only with rotor speeds."""
    found = {}
    for name, value in values.items():
        if flight.commands and name in ("k_T", "k_M"):
            continue  # an unfitted thrust curve is in them
        size = 0.1 * flight.arm if name.startswith("cg") else abs(value)
        if np.isfinite(stds[name]) and 0.0 < stds[name] < CLAIM * size:
            found[name] = (value, stds[name])
    return found


def thrust_signals(flight: Flight, stretch: Stretch) -> Array:
    """(n, 6) -sum y O, sum x O, sum O, sum s O, H and its derivative.

    O is the squared rotor stream, H the sum of s times the stream.
    """
    signals, H = rb.rotor_signals(flight.geometry, stretch.rotors)
    length = max(5, round(WINDOW / flight.dt) | 1)
    return np.column_stack([signals, H, savgol_filter(H, length, 3, deriv=1, delta=flight.dt)])


def thrust_coefficient(flight: Flight) -> float:
    """k_T (of commands: T_max) that explains the vertical specific force, by least squares."""
    total = np.concatenate([thrust_signals(flight, s)[:, 2] for s in flight.stretches])
    force = np.concatenate([s.force[:, 2] for s in flight.stretches])
    return -flight.mass * float(force @ total) / float(total @ total)


def least_squares(flight: Flight) -> Claims:
    """What a practitioner does in an afternoon: Ixx and Iyy by Euler's equations.

    Savitzky-Golay filters smooth the rates and differentiate them; thrust is one k_T times squared
    speeds, at once; intervals as if the residuals were white. In yaw, with k_M unknown, the
    equation's right side is zero and noise pulls Izz there.
    """
    length = max(5, round(WINDOW / flight.dt) | 1)
    rates = np.concatenate([s.rates for s in flight.stretches])
    if len(rates) < 10 * length:
        return {}
    speeds = np.concatenate([s.rotors for s in flight.stretches])
    rotors = savgol_filter(rb.rotor_signals(flight.geometry, speeds)[0], length, 3, axis=0)
    turning = savgol_filter(rates, length, 3, deriv=1, delta=flight.dt, axis=0)
    force = np.concatenate([s.force[:, 2] for s in flight.stretches])
    k_T = -flight.mass * float(force @ rotors[:, 2]) / float(rotors[:, 2] @ rotors[:, 2])
    phi, y = rb.direct_rows(smooth(rates, flight.dt), turning, rotors)
    x = phi.reshape(-1, 9)
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-300
    found, _, rank, _ = np.linalg.lstsq(x / size, y.ravel(), rcond=None)
    if rank < 9:
        return {}
    residual = y.ravel() - x / size @ found
    covariance = np.linalg.inv((x / size).T @ (x / size)) * float(np.mean(residual**2))
    names = ("Ixx", "Iyy")
    values = dict(zip(names, (k_T * found / size).tolist(), strict=False))
    stds = abs(k_T) * np.sqrt(np.diag(covariance)) / size
    return claims_of(flight, values, dict(zip(names, stds.tolist(), strict=False)))


# An extended Kalman filter whose state has the parameters in it.

_STATES = ("Ixx", "Iyy", "Izz", "k_T", "k_M", "rotor_inertia", "cg_x", "cg_y")
"""After the three rates. The first six as logarithms, so that they stay positive."""
_LOGS = slice(3, 9)


def augmented_ekf(flight: Flight) -> Claims:
    """An ExtendedKalmanFilter of filterpy on rates and parameters.

    It measures the rates and the vertical specific force. The noise of the rates is taken from
    what the Savitzky-Golay filter removes; that of the angular acceleration is 1 rad/s^2.
    """
    from filterpy.kalman import ExtendedKalmanFilter

    n = 3 + len(_STATES)
    ekf = ExtendedKalmanFilter(n, 4)
    k_T = thrust_coefficient(flight)
    J = flight.mass * flight.arm**2 * _START_ARM2
    start = [*J, k_T, _START_MOMENT * flight.arm * k_T, _START_ROTOR * J[2]]
    ekf.x = np.concatenate([flight.stretches[0].rates[0], np.log(start), [0.0, 0.0]])
    cg = 0.1 * flight.arm
    gyro = np.concatenate([s.rates - smooth(s.rates, flight.dt) for s in flight.stretches])
    noise = np.maximum(gyro.std(axis=0), 1e-4)
    ekf.P = np.diag([*noise, 0.5, 0.5, 0.5, 0.2, 0.7, 1.0, cg, cg]) ** 2
    ekf.R = np.diag([*noise, 0.5]) ** 2
    ekf.Q = np.diag([*(3 * [flight.dt]), *(len(_STATES) * [0.0])]) ** 2
    for stretch in flight.stretches:
        # A gap ends in rates that are known afresh.
        ekf.x[:3] = stretch.rates[0]
        ekf.P[:3, :], ekf.P[:, :3] = 0.0, 0.0
        ekf.P[:3, :3] = np.diag(noise**2)
        signals = thrust_signals(flight, stretch)
        before = signals[0]
        for rates, force, signal in zip(
            stretch.rates[1:], stretch.force[1:, 2], signals[1:], strict=True
        ):
            slope, jacobian = _acceleration(ekf.x, 0.5 * (before + signal))
            ekf.F = np.eye(n)
            ekf.F[:3] += flight.dt * jacobian
            ekf.predict_x = partial(_advance, ekf, flight.dt * slope)
            ekf.predict()
            ekf.update(
                np.append(rates, force),
                partial(_measured_slope, signal[2] / flight.mass),
                partial(_measured, signal[2] / flight.mass),
            )
            before = signal
    stds = np.sqrt(np.maximum(np.diag(ekf.P)[3:], 0.0))
    values = np.append(np.exp(ekf.x[_LOGS]), ekf.x[9:])
    stds[:6] *= values[:6]
    named = dict(zip(_STATES, values.tolist(), strict=True))
    return claims_of(flight, named, dict(zip(_STATES, stds.tolist(), strict=True)))


def _advance(ekf: object, step: Array, u: float = 0.0) -> None:
    ekf.x[:3] += step  # type: ignore[attr-defined]


def _acceleration(x: Array, signal: Array) -> tuple[Array, Array]:
    """Angular acceleration (3,) by Euler's equations, and its Jacobian (3, states)."""
    p, q, r = x[:3]
    Ixx, Iyy, Izz, k_T, k_M, J_r = np.exp(x[_LOGS])
    cg_x, cg_y = x[9:]
    roll, pitch, thrust, yaw, H, H_slope = signal
    M = np.array([k_T * (roll + cg_y * thrust), k_T * (pitch - cg_x * thrust), k_M * yaw])
    rotors = J_r * np.array([q * H, -p * H, H_slope])
    J = np.array([Ixx, Iyy, Izz])
    products = np.array([q * r, r * p, p * q])
    left = np.array([Iyy - Izz, Izz - Ixx, Ixx - Iyy])
    slope = (M + left * products + rotors) / J
    d = np.zeros((3, len(x)))
    d[0, 1:3], d[1, [0, 2]], d[2, :2] = (
        left[0] * np.array([r, q]),
        left[1] * np.array([r, p]),
        (left[2] * np.array([q, p])),
    )
    # By the logarithms of the moments: left's own, and of what divides.
    d[0, 4], d[0, 5] = Iyy * products[0], -Izz * products[0]
    d[1, 5], d[1, 3] = Izz * products[1], -Ixx * products[1]
    d[2, 3], d[2, 4] = Ixx * products[2], -Iyy * products[2]
    d[0, 6], d[1, 6], d[2, 7] = M[0], M[1], M[2]
    d[:, 8] = rotors
    d[0, 1] += J_r * H
    d[1, 0] -= J_r * H
    d[1, 9], d[0, 10] = -k_T * thrust, k_T * thrust
    d /= J[:, None]
    d[range(3), range(3, 6)] -= slope
    return slope, d


def _measured(loading: float, x: Array) -> Array:
    return np.append(x[:3], -np.exp(x[6]) * loading)


def _measured_slope(loading: float, x: Array) -> Array:
    H = np.zeros((4, len(x)))
    H[:3, :3] = np.eye(3)
    H[3, 6] = -np.exp(x[6]) * loading
    return H


# Multiple shooting with MuJoCo's own toolbox.

_SHOT, _SHOTS = 0.3, 100
"""s of each simulated piece, and most pieces, spread over the flight."""
_MODEL = """<mujoco><option timestep="{dt:.9g}" gravity="0 0 0" integrator="RK4"/><worldbody>
<body name="vehicle"><freejoint/><site name="body"/>
<inertial pos="0 0 0" mass="{mass:.9g}" fullinertia="1 1.1 1.5 .1 .1 .1"/></body></worldbody>
<actuator>
<general site="body" gear="0 0 0 1 0 0"/><general site="body" gear="0 0 0 0 1 0"/>
<general site="body" gear="0 0 0 0 0 1"/></actuator></mujoco>"""


def mujoco_sysid(flight: Flight) -> Claims:
    """mujoco.sysid.optimize on pieces of 0.3 s of a free body, intervals by its Jacobian.

    Each piece starts from smoothed rates; what is compared are the rates. All of the inertia
    matrix, k_M, the CG, the rotors' inertia and damping of each axis are fitted; k_T is that of
    the vertical specific force.
    """
    import mujoco
    from mujoco import rollout, sysid

    model = mujoco.MjModel.from_xml_string(_MODEL.format(dt=flight.dt, mass=flight.mass))
    data = mujoco.MjData(model)
    k_T = thrust_coefficient(flight)
    start, signals, rates = _pieces(flight)
    if not len(start):
        return {}
    roll, pitch, thrust, yaw, H, H_slope = np.moveaxis(signals, 2, 0)
    rotors = np.stack([rates[:, :, 1] * H, -rates[:, :, 0] * H, H_slope], axis=2)
    turning = slice(1 + model.nq + 3, 1 + model.nq + 6)
    state = np.zeros((len(start), mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    state[:, 4] = 1.0  # after time and place, the quaternion's real part
    state[:, turning] = start
    size, arm = flight.mass * flight.arm**2, flight.arm

    def residual(x: Array, _: object) -> tuple[list[Array], None, None]:
        root = np.exp(0.5 * x[:3])
        elements = np.concatenate([root**2, x[3:6] * root * np.roll(root, -1)])
        moments, axes = np.linalg.eigh(rb.inertia_matrix(elements))
        axes[:, 0] *= np.linalg.det(axes)
        model.body_inertia[1] = np.maximum(moments, 1e-3) * size
        mujoco.mju_mat2Quat(model.body_iquat[1], axes.ravel())
        moment_ratio, (cg_x, cg_y, J_r) = np.exp(x[6]), x[7:10]
        model.dof_damping[3:] = x[10:] * size
        control = [
            roll + cg_y * arm * thrust,
            pitch - cg_x * arm * thrust,
            moment_ratio * arm * yaw,
        ]
        torque = k_T * np.stack(control, axis=2) + J_r * size * rotors
        out, _ = rollout.rollout(model, data, state, torque)
        return [(out[:, :, turning] - rates).ravel()], None, None

    begin = [
        *np.log(_START_ARM2),
        0.0,
        0.0,
        0.0,
        np.log(_START_MOMENT),
        0.0,
        0.0,
        1e-3,
        0.1,
        0.1,
        0.1,
    ]
    widths = [1.5, 1.5, 1.5, 0.3, 0.3, 0.3, 2.0, 0.3, 0.3, 0.02, 0.5, 0.5, 0.5]
    damping = ("roll_damping", "pitch_damping", "yaw_damping")
    names = (*rb.INERTIA, "k_M", "cg_x", "cg_y", "rotor_inertia", *damping)
    parameters = sysid.ParameterDict()
    for name, value, width in zip(names, begin, widths, strict=True):
        parameters.add(sysid.Parameter(name, value, value - width, value + width))
    with contextlib.redirect_stdout(io.StringIO()):  # its iterations
        _, best = sysid.optimize(
            parameters, residual, optimizer="scipy", verbose=False, x_scale=widths, max_iters=12
        )
    (left,), _, _ = residual(best.x, None)
    J = np.asarray(best.jac)
    covariance = np.linalg.pinv(J.T @ J) * float(left @ left) / (len(J) - J.shape[1])
    std = np.sqrt(np.diag(covariance))
    root = np.exp(0.5 * best.x[:3])
    products = root * np.roll(root, -1) * size
    scale = np.concatenate(
        [root**2 * size, products, [np.exp(best.x[6]) * k_T * arm, arm, arm, *(4 * [size])]]
    )
    value = np.concatenate([scale[:3], best.x[3:6] * products, scale[6:7], best.x[7:] * scale[7:]])
    return claims_of(
        flight,
        dict(zip(names, value.tolist(), strict=True)) | {"k_T": k_T},
        dict(zip(names, (std * scale).tolist(), strict=True)) | {"k_T": np.nan},
    )


def _pieces(flight: Flight) -> tuple[Array, Array, Array]:
    """(k, 3) rates at the start, (k, n, 6) thrust signals and (k, n, 3) rates of the pieces."""
    steps = max(3, round(_SHOT / flight.dt))
    start, signals, rates = [], [], []
    for stretch in flight.stretches:
        smoothed, rotors = smooth(stretch.rates, flight.dt), thrust_signals(flight, stretch)
        middle = 0.5 * (rotors[1:] + rotors[:-1])
        for first in range(0, len(rotors) - steps - 1, steps):
            start.append(smoothed[first])
            signals.append(middle[first : first + steps])
            rates.append(stretch.rates[first + 1 : first + steps + 1])
    every = max(1, -(-len(start) // _SHOTS))
    return np.array(start[::every]), np.array(signals[::every]), np.array(rates[::every])


def smooth(rates: Array, dt: float) -> Array:
    """Rates through a Savitzky-Golay filter of 0.1 s."""
    return np.asarray(savgol_filter(rates, max(5, round(WINDOW / dt) | 1), 3, axis=0))


ENTRIES: dict[str, tuple[Entry, str | None, str]] = {
    "least squares": (least_squares, None, "Savitzky-Golay derivatives, SciPy and NumPy"),
    "EKF": (augmented_ekf, "filterpy", "parameters as states, filterpy"),
    "MuJoCo sysid": (mujoco_sysid, "mujoco.sysid", "multiple shooting, mujoco.sysid"),
}
"""Name -> function, the package that it needs, and what it is."""


def available() -> dict[str, Entry]:
    """Those whose package is installed."""

    def there(package: str | None) -> bool:
        try:
            return package is None or importlib.util.find_spec(package) is not None
        except ModuleNotFoundError:
            return False

    return {name: entry for name, (entry, package, _) in ENTRIES.items() if there(package)}


def load(named: str) -> Entry:
    """An entry given as FILE.py:FUNCTION.

    Raises:
        ValueError: there is no such file or function, or the file fails.
    """
    path, _, function = named.rpartition(":")
    spec = importlib.util.spec_from_file_location("entered", path or named)
    if not path or spec is None or spec.loader is None:
        raise ValueError(f"{named}: an estimator is given as FILE.py:FUNCTION")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{path}: {type(error).__name__}: {error}") from error
    entry: Entry | None = getattr(module, function, None)
    if not callable(entry):
        raise ValueError(f"{path}: no function {function}")
    return entry
