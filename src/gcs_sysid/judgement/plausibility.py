"""Objections to estimates of a vehicle that cannot exist.

A fit cannot notice a wrong unit or a guessed arm: every inertia follows in proportion, with narrow
intervals. The numbers of multirotors from 0.02 to 25 kg do not leave the ranges below (vehicles and
derivation: docs/result.md, "Plausibility"); values outside come from what was entered.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.estimation.parameters.given_errors import unseen_shift
from gcs_sysid.estimation.parameters.physical_parameters import rotor_coefficients, unlike_rotors
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.status import LINES, READINGS
from gcs_sysid.model.airframe import Airframe, own_units_words
from gcs_sysid.model.estimate import KNOWN, Objection
from gcs_sysid.model.parameters import GRAVITY, INERTIA, PARAMETERS
from gcs_sysid.model.rigid_body import inertia_matrix
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.rotor_readings import AGE, APART
from gcs_sysid.signals.rotor_units import LARGEST_ROTOR
from gcs_sysid.significance import Z95

Range = tuple[float, float]


@dataclass(frozen=True)
class PlausibleRanges:
    """Ranges of multirotors; arm is the mean distance of the rotors from the geometric center."""

    density: Range = (10.0, 2500.0)
    """Mass over arm cubed, kg/m^3. Vehicles of the table: 52 to 787; of the article: 34; a 3-inch
    quad with ducts: 898."""
    rotor: float = LARGEST_ROTOR
    tip: float = 150.0
    """Speed of propeller tips in hover, m/s, at most. Makers allow 140 to 190 at full thrust; with
    the diameter that k_T has at C_T = 0.1, vehicles have 41 to 116."""
    thrust_to_weight: Range = (1.05, 30.0)
    """Full thrust of all rotors over weight: below it does not climb; racers reach 15."""
    roll_pitch: Range = (0.01, 1.0)
    """Ixx and Iyy over mass times arm squared. All the mass at the motors of a quad: 0.5."""
    yaw: Range = (0.02, 2.0)
    """Izz over the same. All the mass at the motors: 1."""
    moment_ratio: Range = (0.03, 0.13)
    """k_M / k_T over the propeller's diameter, C_P / (2 pi C_T) of propellers. With the diameter
    that k_T has at C_T = 0.1, vehicles of known k_M have 0.049 to 0.119, the CineRat of 3 inches
    0.104, and the article's 0.059. Upper and lower rotor of one arm of four swapped: twice as
    much."""
    most_of_many: float = 0.09
    """The same over the distance between neighbors, of vehicles with six rotors and more, whose
    propellers are large ones: 0.05 to 0.076 emulated. The small ones of quads reach 0.11."""


RANGES = PlausibleRanges()
_BY_ARM = frozenset(name for name, p in PARAMETERS.items() if p.theta)
"""Read off torque over angular acceleration, in proportion to the arm."""
_BY_SPIN = frozenset({"k_M", "moment_ratio", "rotor_inertia"})
"""Read off what the rotors' spins do to yaw."""
_BY_SPEED = frozenset({"k_T", "k_M", "rotor_inertia"})
"""In proportion to the square of the rotors' speeds, or to the speeds."""
_BY_SCALE = frozenset(name for name, p in PARAMETERS.items() if p.scale != "none")
"""In proportion to mass or thrust."""


def placeholder_arm(evidence: Evidence) -> Iterator[Objection]:
    """An arm that was not given."""
    airframe, known = evidence.airframe, _known(evidence)
    if not airframe.arm_known and _BY_ARM & known.keys():
        yield Objection(
            f"the {airframe.arm:g} m arm is a placeholder of the built-in layout "
            f"{airframe.name}, and inertia is proportional to it",
            _BY_ARM,
            cap="weak",
            verdict="partial",
            how="give --arm M",
        )


def own_units(evidence: Evidence) -> Iterator[Objection]:
    """Neither mass nor thrust was given, and perhaps no size."""
    if evidence.airframe.own_units:
        reason, how = own_units_words(evidence.airframe.own_units)
        yield Objection(reason, verdict="identified", how=how)


REREAD = Objection(
    "rotor speeds were read as rad/s, because as rpm they could not carry this mass",
    verdict="partial",
    how="check --mass (kg) and --arm (m), or the unit that the ESCs send",
    by="units",
)
"""Speeds in another unit than declared: either that was wrong, or the mass that judged it."""


def reread_speeds(evidence: Evidence) -> Iterator[Objection]:
    """Such speeds."""
    if evidence.reread:
        yield replace(REREAD, parameters=_BY_SCALE, cap="weak")


def unshaken_speeds(evidence: Evidence) -> Iterator[Objection]:
    """Speeds that are all off by one factor, which leaves the fit as good."""
    names = _BY_SCALE if evidence.anchor == "k_T" else _BY_SPEED
    for found in of_turning(evidence.turning):
        yield replace(found, parameters=names, cap="weak", verdict="partial")


def unseen_speeds(evidence: Evidence) -> Iterator[Objection]:
    """Speeds that nothing checks: a note, as rpm is what they are defined in."""
    names = _BY_SCALE if evidence.anchor == "k_T" else _BY_SPEED
    claimed = evidence.received is not None and names & _known(evidence).keys()
    if evidence.as_sent and claimed:
        how = "compare the magnets of a motor with the pole count of its ESC or autopilot"
        yield Objection(evidence.as_sent, names, verdict="identified", how=how)


def of_turning(factor: float | None) -> Iterator[Objection]:
    """The same, whatever the speeds are for; `factor` as of `Evidence.turning`."""
    if factor is not None and factor != 1.0:
        yield Objection(
            f"the IMU is shaken at {factor:.2f} times the rotor speeds read",
            verdict="identified",
            evidence={"factor": factor},
            how="count the magnets of a motor, and give their number to ESC or autopilot",
            by=LINES,
        )


def assumed_unit(evidence: Evidence) -> Iterator[Objection]:
    """A unit that the log does not define: what is in proportion to it is not known.

    Speeds by the mass leave torques, and so inertia, as they are. A range of commands is a unit
    and a zero: by how much rotors differ in thrust, and so the CG, follows from it too.
    """
    if evidence.assumed:
        speeds = evidence.rotor_input is RotorInput.SPEED
        parameters = _BY_SCALE if speeds else _BY_SCALE | {"thrust_curve", "cg_x", "cg_y"}
        if speeds and evidence.anchor != "k_T":
            parameters = _BY_SPEED
        how = "give [command] min and max in the airframe file, or record the parameters"
        if speeds:
            how = "give motor_poles, counted, in the airframe file, or record the IMU at 500 Hz"
        yield Objection(evidence.assumed, parameters, cap="weak", verdict="partial", how=how)


def differing_rotors(evidence: Evidence) -> Iterator[Objection]:
    """Rotors whose thrust at the speed that they read differs more than that of propellers does.

    Where that is an ESC's reading (pole count), the vehicle flies alike, and the mean over the
    rotors is off: by what a mean of so many values is uncertain that scatter so much.
    """
    rotation, rotors = evidence.fit.rotation, len(evidence.airframe.rotors)
    if rotation is None or evidence.rotor_input.motors or not rotation.deviating.thrusts.any():
        return
    likely, share = unlike_rotors(rotation, rotors)
    apart = rotor_coefficients(rotation, rotors)[0] - 1.0
    if 0 < len(likely) < rotors:
        apart = share * (np.eye(rotors)[likely[0]] - 1.0 / rotors) / (1.0 + share / rotors)
        which = " or ".join(str(i + 1) for i in sorted(likely))
        what = f"rotor {which} by {100.0 * share:+.0f} % of the others"
    else:
        what = f"by up to {100.0 * np.abs(apart).max():.0f} % of the mean"
    how = "check its propeller, and the pole count of its ESC"
    if apart.min() < -1.0:  # no propeller pulls the other way
        how = "check the motor order, and that no two columns change places"
    excess = float(np.mean(apart**2)) - (0.5 * APART) ** 2
    if excess > 0.0:
        share = math.sqrt(excess / rotors)
        yield Objection(
            f"rotors differ in thrust for the speed that they read, {what}",
            frozenset({"k_T", "k_M"}),
            cap="weak",
            verdict="identified",
            widening=evidence.share_of(("k_T", "k_M"), share),
            evidence={"share": share},
            how=how,
        )
        # Thrust and torque of each rotor are fitted; what its own inertia does goes with the speed,
        # and looks like yaw with roll and pitch.
        own = evidence.estimates.get("rotor_inertia")
        if own is not None and own.value is not None:
            yield Objection(
                "rotor inertia, Ixz and Iyz come from speeds that one of the rotors may read wrong",
                frozenset({"rotor_inertia", "Ixz", "Iyz"}),
                cap="weak",
                verdict="identified",
                by="spin-up",
            )


def unlike_spins(evidence: Evidence) -> Iterator[Objection]:
    """Rotors of one spin that lift more for the speed read: either may be those that read wrong."""
    rotation = evidence.fit.rotation
    if rotation is None or unlike_rotors(rotation, len(evidence.airframe.rotors))[0]:
        return  # one rotor that reads otherwise does as much
    names = _BY_SCALE if evidence.anchor == "k_T" else _BY_SPEED
    for found in of_spins(evidence.spins):
        widening = evidence.share_of(names, abs(found.evidence["share"]))
        yield replace(found, parameters=names, cap="weak", widening=widening)


def of_spins(share: float | None) -> Iterator[Objection]:
    """The same, whatever the speeds are for; `share` as of `Evidence.spins`."""
    if share is not None:
        less, more = ("clockwise", "counter-clockwise")[:: 1 if share > 0.0 else -1]
        percent = 100.0 * (1.0 - (1.0 - abs(share)) / (1.0 + abs(share)))
        yield Objection(
            f"for the speed that they read the {less} rotors lift {percent:.0f} % less than the "
            f"{more} ones, as thrust shows where it yaws",
            verdict="identified",
            evidence={"share": share},
            how="check the pole counts of the ESCs of one spin, and their propellers",
            by=READINGS,
        )


def unseen_rotors(evidence: Evidence) -> Iterator[Objection]:
    """Rotors that differ by their commands, where no flight shows whether they do."""
    unlike = evidence.unlike
    if evidence.rotor_input.motors or np.allclose(unseen_shift(evidence.airframe), 0.0):
        return
    if unlike is None:
        if evidence.fit.rotation is not None and evidence.spins is None:
            share = evidence.airframe.uncertainty.rotor_thrust.of(1.0)
            yield Objection(
                "CG, k_T and k_M hold for rotors that give one thrust for one speed, within "
                f"{100.0 * share:.0f} %: speeds alone do not show one side unlike the other",
                verdict="identified",
                by="alike",
                how="record the commands too, and check that all ESCs count the same poles",
            )
        return
    if unlike < 0.5 * APART:
        return
    yield Objection(
        f"at their commands rotors differ by {100.0 * unlike:.0f} % in speed squared: those of one "
        "side that lift less for their speed look like a CG",
        frozenset({"cg_x", "cg_y", "k_T", "k_M"}),
        cap="weak",
        verdict="partial",
        how="check propellers, motors and the pole counts of their ESCs",
    )


def aged_readings(evidence: Evidence) -> Iterator[Objection]:
    """Rotors whose readings are older than those of others: the fit has one delay for all.

    A speed that is read wrong looks so, too. One that was held at times was so unseen at others.
    """
    by_rotation = evidence.names(lambda p: p.fit == "rotation")
    if evidence.stale:
        yield Objection(
            evidence.stale,
            by_rotation,
            cap="weak",
            verdict="partial",
            how="mend the telemetry of that ESC, or have commands recorded too",
        )
        return
    rotation, rotors = evidence.fit.rotation, len(evidence.airframe.rotors)
    if rotation is None or not len(rotation.ages) or evidence.spins is not None:
        return
    if unlike_rotors(rotation, rotors)[0]:
        return
    apart = float(np.abs(rotation.ages - np.median(rotation.ages)).max())
    if apart > AGE:
        # Whose they are does not show: what rotors differ by otherwise looks much the same.
        yield Objection(
            "the readings of one rotor are older or younger than those of the others, by some "
            f"{1e3 * apart:.0f} ms",
            by_rotation,
            cap="weak",
            verdict="partial",
            evidence={f"rotor {i}": age for i, age in enumerate(rotation.ages.tolist(), 1)},
            how="have all ESCs read at once, or each with its own time",
        )


def unseen_spins(evidence: Evidence) -> Iterator[Objection]:
    """Upper and lower rotors by the airframe file alone.

    Whatever the flight asks of one arm, it asks of both its rotors; by yaw they differ on all arms
    alike. With two of them exchanged all else fits as well, at twice the torque and inertia.
    """
    if evidence.airframe.coaxial and not evidence.confirmed and _BY_SPIN & _known(evidence).keys():
        yield Objection(
            "no flight shows which rotor of an arm is the upper one: with two exchanged, rotor "
            "torque and inertia come out twice as large",
            _BY_SPIN,
            cap="weak",
            verdict="partial",
            how="record the autopilot's parameters, which say, or check the spins of each arm",
        )


def implausible(evidence: Evidence) -> Iterator[Objection]:
    """Numbers that no multirotor has, however well the model fits."""
    found, airframe, everything = _known(evidence), evidence.airframe, frozenset(evidence.estimates)
    own = airframe.own_units
    sizes = () if own else tuple(misfits(found, airframe, evidence.rotor_input))
    yield from (replace(each, parameters=everything, cap="weak") for each in sizes)
    if sizes:  # where mass and arm do not fit each other, inertia cannot fit both
        return
    if "arm" in own:  # what is compared with the square of the arm is per m of it
        found.pop("mass", None)
    if own:  # and no propeller's size follows from what is per kg
        found.pop("k_T", None)
    by_speed = _BY_SCALE if evidence.anchor == "k_T" else _BY_SPEED
    for fast in too_fast(found, airframe):
        yield replace(fast, parameters=by_speed, cap="weak")
    found_wrong = [(each, frozenset(INERTIA)) for each in _inertia(found, airframe.arm)]
    # The propeller's size is by the speeds: as well as the torque, their unit may be wrong.
    by_spin = _BY_SPIN if evidence.rotor_input.motors else _BY_SPIN | _BY_SPEED
    found_wrong += [(each, by_spin) for each in _spins(found, airframe, evidence.rotor_input)]
    for (reason, how), names in found_wrong:
        yield Objection(reason, names, cap="weak", verdict="partial", how=how)


def edge_of_bodies(evidence: Evidence) -> Iterator[Objection]:
    """A body without any extent along one axis: where nothing shows the scale of yaw, fits end so.

    Then no interval says anything of what coupled the axes.
    """
    rotation = evidence.fit.rotation
    if rotation is None:
        return
    moments = np.linalg.eigvalsh(inertia_matrix(rotation.theta[: len(INERTIA)]))
    if moments[0] < RANGES.yaw[0] / RANGES.roll_pitch[1] * moments[2]:
        yield Objection(
            "Izz came out as next to nothing, which no vehicle has: it and products of inertia are "
            "not observable",
            frozenset(name for name, p in PARAMETERS.items() if p.rigid_body),
            cap="unobservable",
            verdict="partial",
            how="fly several axes at once, such as roll and yaw",
            flying=True,
        )
        # Bodies like that have them alike, |Ixx - Iyy| < Izz.
        yield Objection(
            "without Izz, Ixx and Iyy come out alike",
            frozenset({"Ixx", "Iyy"}),
            cap="weak",
            stated=False,
        )


def _known(evidence: Evidence) -> dict[str, float]:
    """Values of parameters that are claimed."""
    return {
        name: e.value
        for name, e in evidence.estimates.items()
        if e.status in KNOWN and e.value is not None
    }


def misfits(
    found: Mapping[str, float], airframe: Airframe, rotor_input: RotorInput, arm_std: float = 0.0
) -> Iterator[Objection]:
    """Mass, thrust and arm against each other: what no multirotor has together.

    Args:
        found: mass, and k_T or T_max; those that are known.
        airframe: whose arm.
        rotor_input: of the flight.
        arm_std: relative standard deviation of the arm.
    """
    mass, arm, rotors = found.get("mass"), airframe.arm, len(airframe.rotors)
    if mass is None:
        return
    arms = (max(arm * (1.0 - Z95 * arm_std), 0.0), arm * (1.0 + Z95 * arm_std))
    low, high = (limit * size**3 for limit, size in zip(RANGES.density, arms, strict=True))
    if not low <= mass <= high:
        size = f"an arm of {arm:.3g} m (multirotors of this size weigh {_short(low)} to "
        if arm_std:
            size = f"an arm of up to {arms[1]:.2g} m, as is assumed (at most "
        yield _of_sizes(
            f"a mass of {mass:.4g} kg is implausible for {size}{_short(high)} kg)",
            "give --mass in kg and --arm in m (or with their units: 1400g, 250mm)",
        )
        return
    name = rotor_input.thrust
    thrust = found.get(name)
    if thrust is None or thrust <= 0.0 or arm_std:
        return
    if not rotor_input.motors and thrust > RANGES.rotor * airframe.apart**4:
        rpm = 30.0 / math.pi * math.sqrt(mass * GRAVITY / (rotors * thrust))
        yield _of_sizes(
            f"hovering {mass:.3g} kg at {rpm:.0f} rpm takes rotors that do not fit an arm of "
            f"{arm:.3g} m",
            "check mass (kg), arm (m) and the unit and pole count of the rotor speeds",
        )
    ratio = rotors * thrust / (mass * GRAVITY)
    if rotor_input.motors and not _within(ratio, RANGES.thrust_to_weight):
        yield _of_sizes(
            f"full thrust is {ratio:.2g} times the weight, expected "
            f"{RANGES.thrust_to_weight[0]:g} to {RANGES.thrust_to_weight[1]:g}",
            "check mass (kg), T_max (N a rotor) and the range of the commands",
        )


def too_fast(found: Mapping[str, float], airframe: Airframe) -> Iterator[Objection]:
    """Speeds at which tips would move as no propeller's do in hover, whatever the arm.

    That goes with the root of the speeds, and the fourth root of the mass: it is their unit.
    """
    mass, k_T = found.get("mass"), found.get("k_T")
    if mass is None or k_T is None or k_T <= 0.0:
        return
    speed, diameter = math.sqrt(mass * GRAVITY / (len(airframe.rotors) * k_T)), _diameter(k_T)
    tip = 0.5 * diameter * speed
    if tip > RANGES.tip:
        yield Objection(
            f"hovering {mass:.3g} kg at {30.0 / math.pi * speed:.0f} rpm takes propellers of "
            f"{diameter:.2g} m whose tips move at {tip:.0f} m/s",
            verdict="partial",
            how="check the unit of the rotor speeds: eRPM are half the pole count times rpm",
            by="units",
        )


def _of_sizes(reason: str, how: str) -> Objection:
    return Objection(reason, verdict="partial", how=how, by="sizes")


def _inertia(found: Mapping[str, float], arm: float) -> Iterable[tuple[str, str]]:
    """Inertia against mass and arm, and its principal moments against each other."""
    mass = found.get("mass")
    if mass is not None:
        unit = mass * arm**2
        for name, range_ in (
            ("Ixx", RANGES.roll_pitch),
            ("Iyy", RANGES.roll_pitch),
            ("Izz", RANGES.yaw),
        ):
            value = found.get(name)
            if value is not None and not _within(value / unit, range_):
                yield (
                    f"{name} is {value / unit:.2g} of mass x arm^2, expected {range_[0]:g} to "
                    f"{range_[1]:g}",
                    "check mass (kg), arm (m) and rotor positions",
                )
    if all(name in found for name in INERTIA):
        moments = np.linalg.eigvalsh(inertia_matrix(np.array([found[name] for name in INERTIA])))
        if moments[0] <= 0.0 or moments[2] > _TRIANGLE * (moments[0] + moments[1]):
            yield (
                "no rigid body has these moments of inertia (the largest principal moment exceeds "
                "the sum of the others)",
                "check motor order and rotor positions",
            )


def _spins(
    found: Mapping[str, float], airframe: Airframe, rotor_input: RotorInput
) -> Iterable[tuple[str, str]]:
    """Torque over thrust against the propeller's diameter, and the power that air takes.

    That is T^1.5 / sqrt(2 rho A) of a rotor of area A, by momentum, over its figure of merit: with
    half the true speeds torque seems to give half of it.
    Rotors that share an arm always get nearly the same command: no flight shows which of them is
    the upper one. The same holds for a tilt of all rotors, which adds to their torque.
    """
    ratio, k_T = found.get("moment_ratio", 0.0), found.get("k_T")
    (low, high), least = RANGES.moment_ratio, 0.0
    if not rotor_input.motors and k_T is not None and k_T > 0.0:
        diameter = _diameter(k_T)
        least = math.sqrt(2.0 * k_T / (math.pi * _AIR)) / (_BEST * airframe.apart)
    else:
        # The largest that do not touch their neighbors.
        diameter, low = airframe.apart, 0.0
        high = high if len(airframe.rotors) <= _FEW else RANGES.most_of_many
    if ratio <= 0.0:  # it is the sign that is wrong, which the verdict says
        return
    if _within(ratio, (low * diameter, high * diameter)):
        if ratio < least:
            yield (
                f"rotor torque at these speeds is {100.0 * ratio / least:.0f} % of the power that "
                f"air takes from the best propellers that fit an arm of {airframe.arm:.3g} m",
                "check the unit and pole count of the rotor speeds; or motor order and arm",
            )
        return
    what = "upper and lower rotors, " if airframe.coaxial else ""
    speeds = "" if rotor_input.motors else "; or the arm, or the unit of the rotor speeds"
    over = f"{low * diameter:.2g} to" if low else "at most"
    yield (
        f"rotor torque over thrust is {ratio:.2g} m, expected {over} "
        f"{high * diameter:.2g} m of propellers of {diameter:.2g} m",
        f"check {what}motor order, spin and tilt of the rotors in the airframe file{speeds}",
    )


def _diameter(k_T: float) -> float:
    """M, of a propeller with a thrust coefficient in the middle of those that there are."""
    return float((4.0 * math.pi**2 * k_T / (_C_T * _AIR)) ** 0.25)


_FEW, _BEST = 4, 0.72
"""Rotors whose propellers may be small ones; figure of merit of the best, 0.75, times the diameter
of those that do not touch, over the distance between neighbors."""
_C_T, _AIR = 0.1, 1.225
"""Thrust coefficient of 0.06 to 0.16, on whose fourth root the diameter depends; kg/m^3."""
_TRIANGLE = 1.05
"""A flat vehicle has Izz = Ixx + Iyy; identified moments scatter by up to 5 %."""


def _short(kilograms: float) -> str:
    short = f"{kilograms:.2g}"
    return f"{float(short):.0f}" if kilograms >= 10.0 else short


def _within(value: float, range_: Range) -> bool:
    return range_[0] <= value <= range_[1]
