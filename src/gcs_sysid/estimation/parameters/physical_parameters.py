"""From relative estimates and one scale anchor to physical parameters.

What these numbers may be worth is decided in `judgement`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.deviations import SURE
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.translation import TranslationFit
from gcs_sysid.estimation.parameters.scale import AbsoluteScale, resolve_scale
from gcs_sysid.estimation.record.input_noise import ROUNDING_STD
from gcs_sysid.estimation.rows.actuator_dynamics import COORDINATE_NAMES, Coordinate
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import NOT_CANTED, Cant, Known, ScaleReference
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import AXIS_DAMPINGS, GRAVITY, PARAMETERS, REGISTRY, TIMING
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.complementary import DEFAULT_K_P
from gcs_sysid.significance import FALSE_ALARM_RATE

Raw = dict[str, tuple[float, float]]
"""Values and standard deviations by name."""


@dataclass(frozen=True)
class ModelErrors:
    """Systematic errors of a model that fits well; scatter within one flight does not show them.

    Relative where no unit is given.
    """

    cg_floor: float = 6e-6
    """Of the arm (a micrometer or two), least standard deviation of the CG by commands."""
    rounded: float = 0.05
    """Of what speeds rounded to whole rpm would shift the CG by if the rounding stayed the same all
    flight. Speeds that are steadier than a rotor's would need more; three emulated octocopters
    moved by 0.01 to 0.04 of it when their speeds were dithered."""
    gyro_bias: float = 0.01
    """rad/s, bias that an autopilot's calibration leaves, before the complementary filter finds
    it."""
    curve_shape: float = 1e-3
    """Of the CG's offset, with commands: thrust curves are not quite of the form fitted (measured:
    0.13 % where the lag is the speed's, not the command's; see `_slowness`)."""
    command: float = 0.0015
    """With commands: a motor is not quite of first order, nor its thrust quite a parabola of the
    command. On flights of the emulator it leaves 0.1 to 0.25 %, in the thrust curve as well."""
    steps: float = 1.7e-4
    """With speeds: commands change in steps, and the cubic between two samples rounds the corners
    that they leave in the speeds. Inertia reads 0.03 % larger where the loop runs once a sample
    than where it runs four times (emulator, 250 Hz); anything between is as likely, and the
    standard deviation of that is the whole over the root of three."""
    delay: float = 2e-5
    """s, of the rotors' delay, likewise: it reads 35 us there."""
    quick_motor: float = 0.03
    """s, lag of the motors that these two were measured with."""
    lag: float = 0.02
    """Of a motor's lag: up to 3.5 % at 100 Hz and on recorded flights."""
    rotor_height: float = 0.15
    """Of the arm, rotors over the CG: where they are, wind pushes a hovering vehicle, whose CG then
    seems to be elsewhere."""
    still_air: float = 0.1
    """m/s^2, of wind's push: flights of 12 s to a minute without wind read 0.01 to 0.05, as what is
    left of the gyro's bias tilts the attitude, which looks like a push."""


ERRORS = ModelErrors()


def physical_parameters(
    anchor: ScaleReference,
    rotation: RotationFit | None,
    translation: TranslationFit | None,
    arm: float,
    known: Mapping[str, Known] | None = None,
    rotor_input: RotorInput = RotorInput.SPEED,
    lateness: float = 0.0,
    cant: Cant = NOT_CANTED,
    seconds: float = math.inf,
) -> dict[str, Estimate]:
    """Physical parameters of the fits, at the anchor's scale; none of them is judged.

    With commands T_max and the thrust curve take the places of k_T and k_M, and a rotor's inertia
    is unobservable.

    Args:
        anchor: the known value that sets the scale.
        rotation: relative to k_T or T_max; None while there is none.
        translation: the same over m, and D / m; None while there is none.
        arm: m, mean rotor distance, for the reference value of the CG.
        known: priors on mass and k_T; those on the rotation are in its fit.
        rotor_input: what the fits are relative to.
        lateness: s, known delay of the gyro, and so of the attitude.
        cant: of the rotors.
        seconds: flight time of the fits.
    """
    scale = resolve_scale(anchor, translation, known or {})
    # Relative effect of a wrong thrust curve on thrust over mass.
    bend = 0.0
    if translation is not None and translation.kappa > 0.0:
        bend = translation.curve_slope / translation.kappa
    doubt = ERRORS.command * _slowness(rotation) if rotor_input.motors else ERRORS.steps
    scaled = doubt if rotor_input.motors else 0.0
    raw = _scale_values(scale, rotation, rotor_input, bend, scaled)
    if rotation is not None:
        # A given T_max does not depend on the curve.
        own_bend = 0.0 if anchor.kind == rotor_input.thrust else bend
        floor = _cg_floor(translation, arm, rotor_input)
        raw |= _rotation_values(rotation, scale, floor, rotor_input, own_bend, doubt, cant)
        shift = math.hypot(
            _wind_shift(translation, arm), _bias_shift(translation, rotation, seconds)
        )
        for name in (n for n, p in PARAMETERS.items() if p.mean_torque):
            raw[name] = raw[name][0], math.hypot(raw[name][1], shift)
        raw |= _axis_values(rotation, scale, own_bend, scaled)
    if translation is not None and scale.mass is not None and math.isfinite(translation.delta):
        if rotation is not None:
            lateness += max(-float(rotation.delay), 0.0)  # rotors ahead: the IMU is behind
        spread = math.hypot(translation.delta_std, lateness * translation.quickness)
        raw["linear_drag"] = scale.mass * translation.delta, scale.mass * spread

    if anchor.std == 0.0:
        raw[anchor.kind] = anchor.value, 0.0
    if rotation is not None:
        raw |= {
            name: _coordinate(rotation, name, doubt)
            for name, p in PARAMETERS.items()
            if p.fit == "actuator" and p.in_result(rotor_input)
        }
    return {
        name: _unjudged(name, raw.get(name))
        for name, p in PARAMETERS.items()
        if p.in_result(rotor_input) or (p.optional and name in raw)
    }


def _unjudged(name: str, found: tuple[float, float] | None) -> Estimate:
    """The estimate of a parameter or timing value; None: nothing was found."""
    p = REGISTRY[name]
    value, std = found or (None, None)
    return Estimate(value, std, p.unit, not_negative=p.sign == "not negative")


def _scale_values(
    scale: AbsoluteScale,
    rotation: RotationFit | None,
    rotor_input: RotorInput,
    bend: float,
    doubt: float,
) -> Raw:
    """Mass and k_T or T_max, as far as they are known."""
    bent = (
        0.0 if rotation is None else abs(bend) * float(rotation.coordinates_std[Coordinate.CURVE])
    )
    found = (
        ("mass", scale.mass, scale.mass_share),
        (rotor_input.thrust, scale.thrust, scale.thrust_share),
    )
    return {
        name: (value, value * math.hypot(share, bent, doubt))
        for name, value, share in found
        if value is not None
    }


def _rotation_values(
    rotation: RotationFit,
    scale: AbsoluteScale,
    cg_floor: float,
    rotor_input: RotorInput,
    bend: float,
    doubt: float,
    cant: Cant,
) -> Raw:
    """Parameters read off theta: lengths directly, the rest times thrust where that is known.

    Args:
        rotation: the fit.
        scale: with thrust, k_T or T_max.
        cg_floor: m, least standard deviation of the CG.
        rotor_input: what theta is relative to.
        bend: relative change of thrust with the thrust curve.
        doubt: relative error of parameters identified from commands.
        cant: of the rotors.
    """
    out: Raw = {}
    theta, std = rotation.theta.copy(), rotation.std
    theta *= cant.shortened(float(theta[rb.MOMENT_RATIO]))
    theta[rb.MOMENT_RATIO] -= cant.adds
    n, curve = rb.N_THETA, Unknown.CURVE
    full = rotation.full_covariance
    # Errors of the curve move the relative values and the scale together.
    variance = std**2 + theta * bend * (2.0 * full[:n, curve] + theta * bend * full[curve, curve])
    bent = np.sqrt(np.maximum(variance, 0.0))
    slowness = _slowness(rotation) if rotor_input.motors else 0.0
    for name, p in PARAMETERS.items():
        if not p.theta or rotor_input not in p.inputs:
            continue
        at = rb.THETA.index(p.theta)
        value = float(theta[at])
        if p.mean_torque:
            shape = ERRORS.curve_shape * slowness * value
            out[name] = value, math.hypot(std[at], cg_floor, shape)
        elif p.scale == "none":
            out[name] = value, math.hypot(std[at], doubt * value)
        elif scale.thrust is not None:
            out[name] = scale.of(value, float(bent[at]), doubt)
    return out


def _cg_floor(translation: TranslationFit | None, arm: float, rotor_input: RotorInput) -> float:
    """m, least standard deviation of the CG.

    Rotors at Omega in hover that are each off by a constant d shift it by
    sum x_i 2 Omega d_i / sum Omega^2: sqrt(2) arm std(d) / sqrt(sum Omega^2), where the sum of the
    squares is g / kappa.
    """
    if rotor_input.motors or translation is None or not translation.kappa > 0.0:
        return ERRORS.cg_floor * arm
    hover = math.sqrt(GRAVITY / translation.kappa)
    return float(ERRORS.rounded * math.sqrt(2.0) * arm * ROUNDING_STD / hover)


def _wind_shift(translation: TranslationFit | None, arm: float) -> float:
    """m, by which a steady wind may shift what rests on the mean torque."""
    if translation is None:
        return 0.0
    push = max(translation.wind - ERRORS.still_air, 0.0)
    return ERRORS.rotor_height * arm * push / GRAVITY


def _bias_shift(translation: TranslationFit | None, rotation: RotationFit, seconds: float) -> float:
    """m, by which a gyro's bias that was not known yet shifts what rests on the mean torque.

    A bias b left in the rates makes damping d take d b for torque, against m g of thrust; with d
    and thrust relative to k_T, that is d b kappa / g. In the attitude b / k_p stands meanwhile,
    which turns gravity: where there is a velocity, the push g b / k_p on both horizontal axes gives
    b.
    """
    if translation is None or not translation.kappa > 0.0:
        return 0.0
    bias = _unsettled_bias(seconds)
    if translation.source == "momentum":
        bias = DEFAULT_K_P * translation.wind / GRAVITY / math.sqrt(2.0)
    return abs(float(rotation.theta[rb.DAMPING])) * bias * translation.kappa / GRAVITY


def _unsettled_bias(seconds: float) -> float:
    """rad/s, mean over a flight of the gyro's bias that the complementary filter has yet to find.

    After T it is wrong by some share of 1 / (1 + (k_p T)^2), from the start of the flight at worst.
    """
    settled = max(seconds, 1e-3) * DEFAULT_K_P
    return ERRORS.gyro_bias * math.atan(settled) / settled


def _axis_values(rotation: RotationFit, scale: AbsoluteScale, bend: float, doubt: float) -> Raw:
    """Damping by axis where the flight shows it to differ, and its mean over roll and pitch."""
    if scale.thrust is None or not rotation.deviating.dampings.any():
        return {}
    values, stds = axis_dampings(rotation, bend)
    mean, mean_std = mean_damping(rotation, bend)
    found = [("rotational_damping", mean, mean_std)]
    if "damping" in rotation.deviating.shown:
        found += zip(AXIS_DAMPINGS, values, stds, strict=True)
    return {name: scale.of(float(value), float(std), doubt) for name, value, std in found}


def rotor_values(
    rotation: RotationFit | None, scale: AbsoluteScale, rotors: int, cant: Cant = NOT_CANTED
) -> list[dict[str, Estimate]]:
    """k_T and k_M of each rotor, not judged, in motor order; empty where nothing sets the scale.

    Args:
        rotation: of measured rotor speeds.
        scale: with the mean k_T.
        rotors: how many there are.
        cant: of the rotors.
    """
    if rotation is None or scale.thrust is None:
        return []
    k_T, k_T_std, ratio, ratio_std = rotor_coefficients(rotation, rotors)
    ratio = ratio * cant.shortened(float(rotation.theta[rb.MOMENT_RATIO])) - cant.adds * k_T
    columns = zip(*(v.tolist() for v in (k_T, k_T_std, ratio, ratio_std)), strict=True)
    return [
        {
            "k_T": Estimate(*scale.of(*each[:2]), REGISTRY["k_T"].unit),
            "k_M": Estimate(*scale.of(*each[2:]), REGISTRY["k_M"].unit),
        }
        for each in columns
    ]


def rests_on_prior(rotation: RotationFit) -> frozenset[str]:
    """Parameters of whose information more than half does not come from the flight's data."""
    leaning = rotation.std**2 < 0.5 * rotation.data_std**2
    names = {name for name, leans in zip(rb.THETA, leaning, strict=True) if leans}
    return frozenset(name for name, p in PARAMETERS.items() if p.theta in names)


def timing_values(rotation: RotationFit | None, rotor_input: RotorInput) -> dict[str, Estimate]:
    """How far the rotor stream lags behind the IMU's, and with commands a motor's lag, s."""
    return {
        name: _unjudged(name, None if rotation is None else _coordinate(rotation, name))
        for name, p in TIMING.items()
        if rotor_input in p.inputs
    }


def _slowness(rotation: RotationFit | None) -> float:
    """What the errors of a motor's form are multiplied with, at least 1.

    Whether a rotor's speed lags or its command is of no account for small changes; for large ones
    it is, the more so the longer the lag: 60 ms leave 0.44 %, three times what 30 ms leave.
    """
    if rotation is None:
        return 1.0
    return max(1.0, float(rotation.coordinates[Coordinate.LAG]) / ERRORS.quick_motor)


def _coordinate(rotation: RotationFit, name: str, doubt: float = 0.0) -> tuple[float, float]:
    """One of the actuator's coordinates; its standard deviation is 0 where it was given.

    Args:
        rotation: the fit.
        name: of the coordinate.
        doubt: what its form may be off by, in its unit.
    """
    which = COORDINATE_NAMES.index(name)
    value = float(rotation.coordinates[which])
    std = float(rotation.coordinates_std[which])
    if std == 0.0:
        return value, 0.0
    if which == Coordinate.LAG:
        doubt = ERRORS.lag * value
    elif which == Coordinate.DELAY:
        doubt = ERRORS.delay
    return value, math.hypot(std, doubt)


def axis_dampings(fit: RotationFit, bend: float = 0.0) -> tuple[Array, Array]:
    """(3,) of roll, pitch and yaw relative to thrust, and their (3,) standard deviations.

    Linear in the unknowns [theta, coordinates, deviations], as rotors' coefficients are. Where a
    kind of deviation had no evidence, each has the mean's value.

    Args:
        fit: with deviations or none.
        bend: relative change of thrust with the thrust curve, which the standard deviations are
            to include.
    """
    return _linear(fit, _dampings(fit), bend)


def mean_damping(fit: RotationFit, bend: float = 0.0) -> tuple[float, float]:
    """Of roll and pitch, relative to thrust, and its standard deviation; see `axis_dampings`."""
    value, std = _linear(fit, _dampings(fit)[:2].mean(axis=0, keepdims=True), bend)
    return float(value[0]), float(std[0])


def _dampings(fit: RotationFit) -> Array:
    """(3, N_UNKNOWNS + m) that take the unknowns to the damping of each axis."""
    maps = np.zeros((3, N_UNKNOWNS + len(fit.deviating.std)))
    maps[:, rb.DAMPING] = 1.0
    maps[:, N_UNKNOWNS:] = fit.deviating.dampings.T
    return maps


def rotor_coefficients(fit: RotationFit, rotors: int) -> tuple[Array, Array, Array, Array]:
    """Of each rotor, relative to the mean k_T: thrust and torque, with standard deviations.

    Args:
        fit: with deviations or none.
        rotors: how many there are.

    Returns:
        (rotors,) k_T of each over the mean, its standard deviation, k_M over the mean k_T in m, and
        its standard deviation.
    """
    deviating = fit.deviating
    m = len(deviating.std)
    thrust = np.zeros((rotors, N_UNKNOWNS + m))
    ratio = np.zeros_like(thrust)
    ratio[:, rb.MOMENT_RATIO] = 1.0
    if m:
        thrust[:, N_UNKNOWNS:] = deviating.thrusts.T
        ratio[:, N_UNKNOWNS:] = deviating.ratios.T
    k_T, k_T_std = _linear(fit, thrust)
    return 1.0 + k_T, k_T_std, *_linear(fit, ratio)


def unlike_rotors(fit: RotationFit, rotors: int) -> tuple[list[int], float]:
    """The rotor that alone makes the differences between rotors, and by what share of the others.

    One that reads its speed wrong, or whose propeller is another, differs in thrust and torque. Six
    and more share four signals: theirs alone are seen, and others may look as it does.

    Args:
        fit: with deviations.
        rotors: how many there are.

    Returns:
        Those that it may be, the likeliest first; none where none alone is likely. And the change
        of thrust for the speed that it reads.
    """
    deviating = fit.deviating
    if not deviating.thrusts.any():
        return [], 0.0
    alone = np.eye(rotors) - 1.0 / rotors
    ways = (deviating.thrusts + fit.theta[rb.MOMENT_RATIO] * deviating.ratios) @ alone
    own = ways.any(axis=1)
    ways = ways[own]
    inverse = np.linalg.pinv(fit.deviations_covariance[np.ix_(own, own)], hermitian=True)
    information = inverse - np.diag(deviating.information[own])
    score = inverse @ fit.deviations[own]
    pulls, known = ways.T @ score, np.einsum("ki,kl,li->i", ways, information, ways)
    gains = np.where(known > 0.0, 0.5 * pulls**2 / np.maximum(known, 1e-300), 0.0)
    order = np.argsort(-gains)
    best = int(order[0])
    every = 0.5 * float(score @ np.linalg.pinv(information, hermitian=True) @ score)
    left = 2.0 * (every - float(gains[best]))
    if not gains[best] > 0.0 or left > chdtri(len(score) - 1, FALSE_ALARM_RATE):
        return [], 0.0
    likely = [int(i) for i in order if gains[i] > gains[best] - SURE]
    e = float(pulls[best] / known[best])  # of the mean
    return likely, e / (1.0 - e / rotors)


def _linear(fit: RotationFit, maps: Array, bend: float = 0.0) -> tuple[Array, Array]:
    """Values of (k, N_UNKNOWNS + m) maps of the unknowns, and standard deviations."""
    unknowns = np.concatenate([fit.unknowns, fit.deviations])
    covariance, values = fit.extended_covariance, maps @ unknowns
    maps = maps.copy()
    # d (x T) / dc = T (dx / dc + x bend)
    maps[:, Unknown.CURVE] += bend * values
    variance = np.einsum("ki,ij,kj->k", maps, covariance, maps)
    return values, np.sqrt(np.maximum(variance, 0.0))


def parameter_covariance(
    rotation: RotationFit,
    scale: AbsoluteScale,
    values: Mapping[str, tuple[float, float]],
    given: Mapping[str, Array],
) -> tuple[Sequence[str], Array, Array]:
    """Names, (n, n) covariance and (n, causes) effects of what is given, SI.

    Entries of theta correlate as in the fit; parameters scaled by thrust share the error of the
    scale, and those that depend on given arms or masses share theirs. Standard deviations are those
    of the result, with all that widens them.

    Args:
        rotation: the fit, relative to thrust.
        scale: mass and thrust with relative standard deviations.
        values: name -> value and standard deviation of the result.
        given: name -> (causes,) what one standard deviation of each thing given does to it, see
            `given_errors.given_effects`.

    Returns:
        Names of all that has a standard deviation, their covariance, and (n, causes) the effects
        of what is given, whose products are a part of it.
    """
    names = [name for name, (_, std) in values.items() if std > 0.0]
    thrust = scale.thrust or 1.0
    maps = np.zeros((len(names), N_UNKNOWNS))
    # Of thrust, of mass, and of each thing given.
    causes = max((len(effect) for effect in given.values()), default=0)
    common = np.zeros((len(names), 2 + causes))
    for i, name in enumerate(names):
        p, (value, _) = REGISTRY[name], values[name]
        if p.theta:
            maps[i, rb.THETA.index(p.theta)] = thrust if p.scale == "thrust" else 1.0
        elif name in COORDINATE_NAMES:
            maps[i, rb.N_THETA + COORDINATE_NAMES.index(name)] = 1.0
        if p.scale == "thrust":
            common[i, 0] = value * scale.thrust_share
        elif p.scale == "mass":
            common[i, 1] = value * scale.mass_share
        common[i, 2:] = given.get(name, 0.0)
    fit = maps @ rotation.full_covariance @ maps.T
    stds = np.array([values[name][1] for name in names])
    shared = (common**2).sum(axis=1)
    common *= np.minimum(1.0, stds / np.sqrt(np.maximum(shared, 1e-300)))[:, None]
    # What else widens a parameter (systematic errors, the IMU's alignment) has the correlations of
    # the fit: Izz and k_M, which it can hardly separate, do not separate by adding error.
    rest = np.maximum(stds**2 - shared, 0.0)
    own = np.diag(fit)
    widening = np.sqrt(np.divide(rest, own, out=np.zeros_like(own), where=own > 0.0))
    covariance = fit * np.outer(widening, widening) + common @ common.T
    covariance[np.diag_indices(len(names))] = stds**2
    return names, covariance, common[:, 2:]
