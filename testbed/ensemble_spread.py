"""The spread of an exported ensemble's step response in MuJoCo, and that of the covariance."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from gcs_sysid.arrays import Array
from gcs_sysid.cli.program import run
from gcs_sysid.model.parameters import GRAVITY, INERTIA
from gcs_sysid.results.parameter_samples import covariance_of
from gcs_sysid.results.result import Result

STEP = (0.08, -0.06, 0.03, -0.05)
"""Of the thrust in hover, added to each rotor's."""
SECONDS = 0.1
SHOWN = ("roll rate", "pitch rate", "yaw rate", "climb")
UNITS = ("rad/s", "rad/s", "rad/s", "m/s")
_NAMES = ("mass", *INERTIA, "cg_x", "cg_y", "moment_ratio")
_FLU = np.array([1.0, -1.0, -1.0])
"""MuJoCo's axes from ours."""


@dataclass(frozen=True)
class Spread:
    """Of a step response over an ensemble.

    Attributes:
        flown: (4,) standard deviations over the vehicles flown; `SHOWN`.
        expected: (4,) by the covariance.
        p: (4,) of a larger difference by chance, chi-square, two-sided.
        count: vehicles.
    """

    flown: Array
    expected: Array
    p: Array
    count: int


def spread_of(result: Result, count: int, folder: Path, seed: int = 1) -> Spread:
    """Export, load and fly an ensemble of a result with four rotors."""
    import mujoco

    source = folder / "result.json"
    result.write(source)
    argv = ["export", str(source), "--to", "mjcf", "-o", str(folder / "one.xml")]
    status = run([*argv, "--ensemble", str(count), "--seed", str(seed)])
    assert status == 0
    thrusts = _thrusts(result)
    ends = []
    for path in sorted(folder.glob("one-*.xml")):
        model = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(model)
        data.ctrl[:] = thrusts
        while data.time < SECONDS - 1e-9:
            mujoco.mj_step(model, data)
        # Joints of the CG: world velocity up, then body rates.
        ends.append([*(_FLU * data.qvel[3:6]), data.qvel[2]])
    flown = np.std(ends, axis=0, ddof=1)
    expected = _expected(result, thrusts)
    lower = chi2(count - 1).cdf((count - 1) * (flown / expected) ** 2)
    return Spread(flown, expected, 2.0 * np.minimum(lower, 1.0 - lower), count)


def _thrusts(result: Result) -> Array:
    mass = result.parameters["mass"].value
    assert mass is not None
    return mass * GRAVITY / len(STEP) * (1.0 + np.array(STEP))


def _expected(result: Result, thrusts: Array) -> Array:
    """(4,) sqrt(diag(G P G')); the mass varies by itself where the covariance lacks it."""
    names, matrix = covariance_of(result)
    center = np.array([result.parameters[n].value for n in _NAMES], float)
    P = np.diag([(result.parameters[n].std or 0.0) ** 2 for n in _NAMES])
    at = [i for i, n in enumerate(_NAMES) if n in names]
    there = [names.index(_NAMES[i]) for i in at]
    P[np.ix_(at, at)] = matrix[np.ix_(there, there)]
    step = np.maximum(1e-3 * np.sqrt(np.diag(P)), 1e-12)
    G = np.stack(
        [
            (_response(result, center + d, thrusts) - _response(result, center - d, thrusts))
            / (2.0 * d.max())
            for d in np.diag(step)
        ],
        axis=1,
    )
    root: Array = np.sqrt(np.einsum("ai,ij,aj->a", G, P, G))
    return root


def _response(result: Result, values: Array, thrusts: Array) -> Array:
    """(4,) rates and climb after the step, to first order in time: from rest, J w' = M."""
    v = dict(zip(_NAMES, values, strict=True))
    J = np.array(
        [[v["Ixx"], v["Ixy"], v["Ixz"]], [v["Ixy"], v["Iyy"], v["Iyz"]],
         [v["Ixz"], v["Iyz"], v["Izz"]]]
    )  # fmt: skip
    rotors = result.airframe["rotors"]
    x, y, s = (np.array([float(_number(r[k])) for r in rotors]) for k in ("x", "y", "spin"))
    M = (
        -thrusts @ (y - v["cg_y"]),
        thrusts @ (x - v["cg_x"]),
        v["moment_ratio"] * (s @ thrusts),
    )
    climb = thrusts.sum() / v["mass"] - GRAVITY
    return SECONDS * np.append(np.linalg.solve(J, M), climb)


def _number(value: float | str) -> float:
    return {"ccw": 1.0, "cw": -1.0}.get(value) if isinstance(value, str) else value  # type: ignore[return-value]
