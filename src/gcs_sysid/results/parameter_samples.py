"""Vehicles drawn from a result's covariance, and the flight model of a result or of its samples."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Literal

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError, NoAnswerError, needed
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.flight_model import FURTHER, FlightModel
from gcs_sysid.model.parameters import AXIS_DAMPINGS, INERTIA, REGISTRY
from gcs_sysid.results.result_data import ResultData

if TYPE_CHECKING:
    import pandas

_FEW = 3
"""Missing parameters whose motions are named one by one."""
_BY_NAME = tuple(f.name for f in fields(FlightModel) if f.name in REGISTRY and f.name != "mass")
"""Of the flight model, parameters that are zero where the flight does not determine them."""


@dataclass(frozen=True)
class ParameterSamples(Mapping[str, Array]):
    """Vehicles drawn from a result: name -> (n,) values, SI. Given values are the same in all.

    Attributes:
        names: of the parameters and timing values.
        table: (n, names) values.
    """

    names: tuple[str, ...]
    table: Array

    def __getitem__(self, name: str) -> Array:
        """(n,) values of a parameter."""
        if name not in self.names:
            raise KeyError(name)
        return self.table[:, self.names.index(name)]

    def __iter__(self) -> Iterator[str]:
        """The names."""
        return iter(self.names)

    def __len__(self) -> int:
        """How many parameters there are."""
        return len(self.names)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row per vehicle, a column per parameter.

        Raises:
            InputError: pandas is not installed.
        """
        return needed("pandas", "to_dataframe()").DataFrame(self.table, columns=list(self.names))


def draw_samples(result: ResultData, n: int, seed: int, *, given: bool = True) -> ParameterSamples:
    """Draw vehicles from the normal distribution of a result's covariance, cut to physical ones.

    Inertia matrices are those of rigid bodies, masses and coefficients positive; damping, drag,
    rotor inertia and lag below zero are zero, as in exports.

    Args:
        result: with its covariance.
        n: vehicles.
        seed: of the random numbers.
        given: whether errors of what was given (arm, scale, IMU) are drawn too. Without them the
            samples are of vehicles that move alike: an arm and an inertia that are too large by
            the same share change no motion.

    Raises:
        InputError: n is below 1.
        NoAnswerError: there is no covariance, or hardly any draw is physical.
    """
    if n < 1:
        raise InputError(f"samples: n must be 1 or more, got {n}")
    mean = {name: e.value for name, e in result.estimates.items() if e.value is not None}
    names = tuple(mean)
    center = np.array(list(mean.values()))
    root = _root(result, names, given=given)
    rng = np.random.default_rng(seed)
    kept: list[Array] = []
    found = tried = 0
    while found < n:
        drawn = center + rng.standard_normal((max(n, 64), len(names))) @ root.T
        drawn, good = physical(names, drawn)
        kept.append(drawn[good])
        found, tried = found + int(good.sum()), tried + len(drawn)
        # Below a thousandth the covariance says nothing.
        if found < 1e-3 * tried and tried >= 10_000:
            raise NoAnswerError(
                "samples: hardly any draw from the covariance is a possible rigid body; the "
                "inertia is too uncertain: fly more of all axes, or give priors"
            )
    return ParameterSamples(names, np.concatenate(kept)[:n])


def covariance_of(result: ResultData) -> tuple[tuple[str, ...], Array]:
    """Names and (n, n) covariance, SI.

    Raises:
        NoAnswerError: the result has none.
        InputError: it is malformed.
    """
    names = result.covariance.get("names")
    if not names:
        raise NoAnswerError(
            "the result has no covariance: nothing was identified, or an earlier version wrote it; "
            "analyze the log again"
        )
    matrix = _finite(result.covariance.get("matrix"))
    if matrix.shape != (len(names), len(names)):
        raise InputError("the result's covariance is malformed: matrix and names do not fit")
    return tuple(map(str, names)), matrix


def flight_model(result: ResultData, samples: ParameterSamples | None = None) -> FlightModel:
    """The equations of motion with a result's numbers in them.

    What the flight does not show of damping, drag and rotor inertia is zero. Rotors lie where the
    fit has them, and have the shares of thrust and torque that the result gives each of them.

    Args:
        result: with its airframe.
        samples: an ensemble drawn from it; None: the estimate itself.

    Raises:
        InputError: the result lacks rotors or a parameter that no flight does without.
    """
    airframe = result.layout
    if airframe is None:
        raise InputError("the result has no rotor positions; analyze the log again")
    geometry = airframe.geometry.copy()
    geometry[:2] += found_in_flight(result, "rotor_offsets", geometry[:2].shape)
    if samples is None:
        estimates = result.estimates
        names = tuple(n for n, e in estimates.items() if e.value is not None)
        center = np.array([[estimates[name].value for name in names]], np.float64)
        samples = ParameterSamples(names, physical(names, center)[0])
        values = {name: samples[name][0] for name in samples}
    else:
        values = dict(samples)
    thrust, torque = result.rotor_input.thrust, result.rotor_input.torque
    required = ("mass", *INERTIA, "cg_x", "cg_y", thrust, torque)
    if missing := [name for name in required if name not in values]:
        raise NoAnswerError(
            f"a flight model needs {', '.join(missing)}, which this flight did not identify; fly "
            + (
                "roll, pitch and yaw, several at once: gcs-sysid plan"
                if len(missing) > _FEW
                else "; ".join(sorted({REGISTRY[name].excited_by for name in missing}))
            )
        )
    zero = np.zeros(np.shape(values["mass"]))
    damping = values.get("rotational_damping", zero)
    thrusts = values[thrust][..., None] * _shares(result, "k_T", geometry.shape[1])
    torques = values[torque][..., None] * _shares(result, "k_M", geometry.shape[1])
    return FlightModel(
        geometry,
        result.rotor_input,
        mass=values["mass"],
        inertia=np.stack([values[name] for name in INERTIA], axis=-1),
        cg=np.stack([values["cg_x"], values["cg_y"]], axis=-1),
        thrust=thrusts,
        # With commands the ratio is that of torque and thrust. What canted rotors' thrust adds in
        # yaw goes with their torque.
        torque=(torques * values[thrust][..., None] if result.rotor_input.motors else torques)
        + airframe.cant * thrusts,
        damping=np.stack([values.get(name, damping) for name in AXIS_DAMPINGS], axis=-1),
        drag=values.get("linear_drag", zero),
        further={name: values[name] for name in FURTHER if name in values},
        **{name: values.get(name, zero) for name in _BY_NAME},
    )


def found_in_flight(
    result: ResultData, what: Literal["imu_rotation", "rotor_offsets"], shape: tuple[int, ...]
) -> Array:
    """How IMU (degrees) or rotors (m) lie otherwise than given; zeros where no fit says so.

    Raises:
        InputError: a file's is malformed.
    """
    found = result.telemetry.get(what)
    if found is None:
        return np.zeros(shape)
    value = _finite(found.get("value") if isinstance(found, dict) else None)
    if value.shape != shape:
        raise InputError(f"the result's {what} is malformed")
    return value


def _root(result: ResultData, names: tuple[str, ...], *, given: bool) -> Array:
    """(names, names) A with A A' the covariance; what it does not name varies by itself."""
    names_known, matrix = covariance_of(result)
    estimates = [result.estimates[name] for name in names]
    whole = np.diag([(e.std or 0.0) ** 2 for e in estimates])
    at = [i for i, name in enumerate(names_known) if name in names]
    to = [names.index(names_known[i]) for i in at]
    whole[np.ix_(to, to)] = matrix[np.ix_(at, at)]
    if not given:
        # As `parameter_covariance` adds it: all that rests on one thing given shares its error.
        effects = _effects(result, len(names_known))
        if effects is None:  # an earlier version's file: as if all were one error
            shared = [np.copysign(e.std_given, e.value or 0.0) for e in estimates]
            effects = np.array(shared)[
                [names.index(n) if n in names else 0 for n in names_known], None
            ]
        whole[np.ix_(to, to)] -= effects[at] @ effects[at].T
        whole[np.diag_indices(len(names))] = [(e.std_data or 0.0) ** 2 for e in estimates]
    return covariance_root(whole)


def covariance_root(covariance: Array) -> Array:
    """(n, n) A with A A' an (n, n) covariance, and its variances though it is rounded."""
    scale = np.sqrt(np.diag(covariance))
    scale[scale == 0.0] = 1.0
    correlation = covariance / np.outer(scale, scale)
    # Units differ by many powers of ten. Rounding, and rounded shares, leave negative powers.
    power, axes = np.linalg.eigh(correlation)
    root: Array = axes * np.sqrt(np.maximum(power, 0.0))
    size = np.sqrt((root**2).sum(axis=1))
    size[size == 0.0] = 1.0
    return (scale * np.sqrt(np.diag(correlation)) / size)[:, None] * root


def _effects(result: ResultData, count: int) -> Array | None:
    """(names, causes) effects of errors in given values on the parameters; None: unknown."""
    effects = _finite(result.covariance.get("given"))
    return effects if effects.ndim == 2 and len(effects) == count else None


def _finite(value: object) -> Array:
    """Numbers of a file; an empty array where they are none, or not all finite."""
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return np.empty(0)
    return found if np.isfinite(found).all() else np.empty(0)


def _shares(result: ResultData, name: str, rotors: int) -> Array:
    """(rotors,) each rotor's coefficient over their mean; ones where they are not separate."""
    each = [rotor[name].value for rotor in result.rotors if name in rotor]
    values = np.array([np.nan if value is None else value for value in each])
    if len(values) != rotors or not np.isfinite(values).all() or not (values > 0.0).all():
        return np.ones(rotors)
    return values / values.mean()


def physical(names: tuple[str, ...], drawn: Array) -> tuple[Array, Array]:
    """(n, names) draws with what cannot be negative cut at zero, and (n,) which are vehicles."""
    drawn = drawn.copy()
    good = np.ones(len(drawn), bool)
    for i, name in enumerate(names):
        sign = REGISTRY[name].sign if name in REGISTRY else "positive"
        if sign == "not negative":
            drawn[:, i] = np.maximum(drawn[:, i], 0.0)
        elif sign == "positive":
            good &= drawn[:, i] > 0.0
    if set(INERTIA) <= set(names):
        good &= rb.are_physical(drawn[:, [names.index(name) for name in INERTIA]])
    return drawn, good
