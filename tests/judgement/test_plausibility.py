"""Numbers of vehicles that do not exist, and estimates near a physical bound."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.estimation.fit.deviations import Deviations
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.judge import judge, judged
from gcs_sysid.judgement.plausibility import (
    RANGES,
    aged_readings,
    assumed_unit,
    differing_rotors,
    edge_of_bodies,
    implausible,
    placeholder_arm,
    reread_speeds,
    unlike_spins,
    unseen_rotors,
)
from gcs_sysid.judgement.status import NOTHING, by_interval
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe, builtin_names, load_airframe
from gcs_sysid.model.estimate import Estimate, Objection, Status
from gcs_sysid.model.parameters import ARM, CORE_OF, PARAMETERS, REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result_view import figures
from gcs_sysid.significance import Z95

QUAD = load_airframe("px4-quad-x").with_arm(0.25)
# A 1.5 kg quadrotor of 0.25 m: 10-inch propellers, hover at 5200 rpm.
SOUND = {
    "mass": 1.5, "Ixx": 0.02, "Iyy": 0.022, "Izz": 0.038, "Ixy": 1e-4, "Iyz": 0.0, "Ixz": -2e-4,
    "cg_x": 0.004, "cg_y": 0.0, "k_T": 1.25e-5, "k_M": 2e-7, "moment_ratio": 0.016,
    "rotational_damping": 1e-3, "rotor_inertia": 2e-5, "linear_drag": 0.2,
}  # fmt: skip


def values(**changes: float) -> dict[str, Estimate]:
    numbers = SOUND | changes
    out = {name: Estimate(value, 1e-3 * abs(value) or 1e-9) for name, value in numbers.items()}
    return out | {"mass": Estimate(numbers["mass"], 0.0)}


def evidence(
    estimates: dict[str, Estimate] | None = None,
    airframe: Airframe = QUAD,
    rotor_input: RotorInput = RotorInput.SPEED,
    *,
    reread: bool = False,
) -> Evidence:
    estimates = values() if estimates is None else estimates
    return Evidence(estimates, Fit(None, None, 0.0), airframe, rotor_input, reread=reread)


_SPREAD = {"identified": 1e-3, "weak": 0.2, "unobservable": 0.8, "given": 0.0}


def with_statuses(statuses: dict[str, str]) -> dict[str, Estimate]:
    """Estimates whose intervals give them these statuses; a zero is one."""
    return {
        name: Estimate(0.0, 1e-9)
        if status == "zero"
        else Estimate(SOUND[name] or 0.01, _SPREAD[status] * reference(name))
        for name, status in statuses.items()
    }


def reference(name: str) -> float:
    return REGISTRY[name].reference.size(SOUND[name], SOUND | {ARM: QUAD.arm})


def objections(known: Evidence) -> tuple[Objection, ...]:
    """What is said of numbers that are all claimed."""
    claimed = {
        n: replace(e, status="given" if e.std == 0.0 else "identified")
        if e.value is not None
        else e
        for n, e in known.estimates.items()
    }
    seen = replace(known, estimates=claimed)
    return (*placeholder_arm(seen), *reread_speeds(seen), *implausible(seen))


def reasons(airframe: Airframe = QUAD, reread: bool = False, **changes: float) -> str:
    found = objections(evidence(values(**changes), airframe, reread=reread))
    return "\n".join(objection.words for objection in found)


def test_a_sound_vehicle_raises_no_objection():
    assert reasons() == ""
    command = {name: value for name, value in values().items() if name not in ("k_T", "k_M")}
    command["T_max"] = Estimate(8.0, 0.01)
    assert objections(evidence(command, rotor_input=RotorInput.COMMAND)) == ()


def test_every_layout_needs_its_arm_and_vehicles_do_not():
    for name in builtin_names():
        airframe = load_airframe(name)
        assert airframe.arm_known is (name in ("paper", "px4-sih"))
        assert airframe.with_arm(0.2).arm_known


def test_the_arm_of_a_layout_is_a_placeholder():
    guessed = load_airframe("px4-quad-x")
    assert "0.25 m arm is a placeholder" in reasons(guessed)
    assert "--arm" in reasons(guessed)
    found = judged(evidence(airframe=guessed))
    assert found["Ixx"].status == "weak"
    assert found["cg_x"].status == "weak"
    assert found["k_T"].status == "identified"  # from mass and gravity
    assert found["mass"].status == "given"
    nothing = dict.fromkeys(SOUND, Estimate(None, None))
    assert objections(evidence(nothing, guessed)) == ()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mass": 1500.0}, "a mass of 1500 kg is implausible for an arm of 0.25 m"),  # grams
        ({"mass": 0.0015}, "is implausible for an arm of 0.25 m"),  # tonnes
        ({"k_T": 1.25e-5 * (30.0 / math.pi) ** 2 * 100.0}, "check mass (kg), arm (m) and the unit"),
        ({"k_T": 1.25e-5 / 49.0}, "0.095 m whose tips move at 181 m/s; check the unit"),
        ({"moment_ratio": 0.04}, "torque over thrust is 0.04 m, expected 0.0076 to 0.033 m"),
        ({"moment_ratio": 0.004}, "check motor order, spin and tilt of the rotors"),
        ({"k_T": 4.0 * 1.25e-5}, "at these speeds is 80 % of the power"),  # half the rpm
        ({"Ixx": 0.2}, "Ixx is 2.1 of mass x arm^2, expected 0.01 to 1"),
        ({"Iyy": 1e-4}, "Iyy is 0.0011 of mass x arm^2"),
        ({"Izz": 0.3}, "Izz is 3.2 of mass x arm^2"),
        ({"Izz": 0.06}, "no rigid body has these moments"),
        ({"Ixy": 0.03}, "no rigid body has these moments"),
    ],
)
def test_what_no_multirotor_is_like(changes, said):
    assert said in reasons(**changes)


def test_propellers_fit_between_their_neighbors():
    """Coaxial ones as well; six have less room than four. At half of the speeds k_T is fourfold."""
    said = "takes rotors that do not fit an arm"
    pairs = replace(QUAD, rotors=tuple(rotor for rotor in QUAD.rotors for _ in range(2)))
    hexa = load_airframe("px4-hexa-x").with_arm(0.25)
    for airframe, share in ((QUAD, 0.0392), (pairs, 0.0392), (hexa, 0.0098)):
        assert said in reasons(airframe, k_T=1.04 * share * 0.25**4)
        assert said not in reasons(airframe, k_T=0.96 * share * 0.25**4)


def test_what_the_documentation_says_of_a_wrong_mass():
    page = Path(__file__).parents[2] / "docs" / "intervals.md"
    text = " ".join(page.read_text("utf-8").split())
    as_wide_as_the_arm = 0.1 * 1.225 / (4.0 * math.pi**2)  # C_T rho D^4 / (4 pi^2 arm^4)
    factor = RANGES.rotor / as_wide_as_the_arm
    said = f"at {4.0 * factor:.0f} times the true mass of a quadrotor, and at {factor:.0f} times of"
    assert said in text


def test_a_wrong_unit_caps_all_but_the_given():
    wrong = judged(evidence(values(mass=1500.0)))
    assert {e.status for e in wrong.values()} == {"given", "weak"}
    with pytest.raises(InputError, match=r"got 250; 250 mm are 0\.25"):
        QUAD.with_arm(250.0)


def test_full_thrust_against_weight():
    for T_max, said in ((8.0, ""), (3.0, "0.82 times the weight"), (200.0, "54 times the weight")):
        found = {"mass": Estimate(1.5, 0.0), "T_max": Estimate(T_max, 0.01)}
        known = evidence(found, rotor_input=RotorInput.COMMAND)
        text = "\n".join(o.reason for o in objections(known))
        assert said in text
        assert bool(text) is bool(said)


def test_reinterpreted_units_concern_what_goes_with_the_mass():
    """Either the unit was wrong, or the mass by which it was judged."""
    assert "read as rad/s" in reasons(reread=True)
    statuses = judged(evidence(reread=True))
    assert statuses["k_T"].status == statuses["rotor_inertia"].status == "weak"
    assert statuses["Ixx"].status == "weak"
    assert statuses["cg_x"].status == "identified"


@pytest.mark.parametrize("shown", [{"assumed": "14 poles assumed"}, {"turning": 14.0 / 12.0}])
def test_a_unit_in_doubt_concerns_what_goes_with_it_and_no_inertia(shown):
    statuses = judged(replace(evidence(), **shown))
    assert statuses["k_T"].status == statuses["rotor_inertia"].status == "weak"
    assert statuses["Ixx"].status == statuses["moment_ratio"].status == "identified"
    assert judged(replace(evidence(), anchor="k_T", **shown))["Ixx"].status == "weak"
    assert judged(replace(evidence(), turning=1.0))["k_T"].status == "identified"
    of_commands = replace(evidence(rotor_input=RotorInput.COMMAND), assumed="pulses assumed")
    (objection,) = assumed_unit(of_commands)
    assert {"Ixx", "T_max", "thrust_curve", "cg_x"} <= objection.parameters


def test_vehicles_of_the_documentation_are_well_within_the_range():
    page = Path(__file__).parents[2] / "docs" / "result.md"
    rows = re.findall(r"^\| ([^|]+) \| ([\d.]+) kg \| ([\d.]+) m \|", page.read_text("utf-8"), re.M)
    assert len(rows) >= 8
    low, high = RANGES.density
    for name, mass, arm in rows:
        assert 2.0 * low < float(mass) / float(arm) ** 3 < high / 2.0, name
    assert min(float(mass) for _, mass, _ in rows) < 0.03
    assert max(float(mass) for _, mass, _ in rows) > 20.0


def by_size(value: float, std: float, name: str) -> Estimate:
    """As judged against a reference value of 1."""
    return by_interval(Estimate(value, std), 1.0, REGISTRY[name])


def test_consistent_with_zero_has_a_status_and_a_limit():
    assert by_size(1e-3, 2e-3, "Ixy").status == "zero"
    assert by_size(5e-3, 2e-3, "Ixy").status == "identified"
    assert by_size(1e-3, 2e-3, "Ixx").status == "identified"
    assert by_size(0.1, 0.2, "Ixy").status == "weak"
    estimate = Estimate(1e-3, 2e-3, "m", "zero")
    assert figures(estimate).half_text == "(< 0.0049)"
    assert figures(estimate).short == "~0 (< 0.0049)"
    assert figures(replace(estimate, status="unobservable")).short == "-"
    assert figures(Estimate(0.0165529, 4.1e-5, "kg m^2", "identified")).short == "0.016553 ±0.49 %"


def test_what_cannot_be_negative_is_not():
    assert by_size(-5e-3, 2e-3, "linear_drag").status == "zero"
    assert by_size(-7e-3, 2e-3, "linear_drag") == NOTHING
    bounded = Estimate(-5e-3, 2e-3, "N m s", "zero", not_negative=True).bounded
    assert bounded.value == 0.0
    assert bounded.ci95 == pytest.approx((0.0, Z95 * 2e-3))
    signs = {n: p.sign for n, p in PARAMETERS.items()}
    assert {n for n, sign in signs.items() if sign == "any"} == {
        "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "thrust_curve",
    }  # fmt: skip
    assert {n for n, sign in signs.items() if sign == "positive"} == {
        "mass", "Ixx", "Iyy", "Izz", "k_T", "k_M", "T_max", "moment_ratio",
    }  # fmt: skip


@pytest.mark.parametrize("true", [0.0, 0.3, 1.0, 1.96, 3.0, 6.0])
def test_bounded_intervals_hold_wherever_the_truth_is(true):
    """In units of sigma; beyond three sigma below zero nothing is claimed, so nothing misses."""
    draws = np.random.default_rng(7).normal(true, 1.0, 20_000)
    low, high = np.array(
        [Estimate(d, 1.0, "", "zero", not_negative=True).bounded.ci95 for d in draws[draws > -3.0]]
    ).T
    holds = np.mean((low <= true) & (true <= high))
    assert 0.945 < holds <= 1.0


def test_the_verdicts_rule_in_the_documentation_is_the_one_in_force():
    """One core parameter is enough for `partial`; with none the result is refused."""
    core = dict.fromkeys(CORE_OF[RotorInput.SPEED], "weak") | {"mass": "given"}
    for known, word in (
        ({}, "refused"),
        ({"k_T": "identified"}, "partial"),
        ({"Ixy": "zero"}, "partial"),
    ):
        assert judge(evidence(with_statuses(core | known))).verdict == word


def test_every_status_is_explained_beside_the_intervals():
    page = Path(__file__).parents[2] / "docs" / "intervals.md"
    listed = re.findall(r"^\| `(\w+)` \|", page.read_text("utf-8"), re.M)
    assert sorted(listed) == sorted(get_args(Status))


def test_swapped_coaxial_rotors_are_not_identified():
    """The upper taken for the lower rotor on one arm of four: k_M comes out twice as large."""
    pairs = tuple(replace(r, spin=-r.spin) for r in QUAD.rotors)
    x8 = replace(QUAD, rotors=(*QUAD.rotors, *pairs))
    sound = evidence(values(moment_ratio=0.018), x8)
    assert objections(sound) == ()
    # Nor are those that may be swapped, unless the vehicle reports its rotors.
    for confirmed, status in ((False, "weak"), (True, "identified")):
        known = judged(replace(sound, confirmed=confirmed))
        assert known["k_M"].status == known["rotor_inertia"].status == status
        assert known["Ixx"].status == known["k_T"].status == "identified"
    twice = evidence(values(moment_ratio=0.036, k_M=4.5e-7), x8)
    (found,) = objections(twice)
    assert "check upper and lower rotors, motor order" in found.words
    weak = {name for name, e in judged(twice).items() if e.status == "weak"}
    # What shows is that torque and speeds do not fit: either may be wrong.
    assert weak == {"k_M", "moment_ratio", "rotor_inertia", "k_T"}
    assert found.words.endswith("or the unit of the rotor speeds")


def test_with_commands_neighboring_rotors_bound_the_propellers():
    command = {name: value for name, value in values().items() if name not in ("k_T", "k_M")}
    command["T_max"] = Estimate(8.0, 0.01)
    # Neighbors are 0.35 m apart: at most 0.046 m.
    for ratio, objected in ((0.04, 0), (0.05, 1)):
        command["moment_ratio"] = Estimate(ratio, 1e-4)
        assert len(objections(evidence(command, QUAD, RotorInput.COMMAND))) == objected
    pairs = tuple(replace(r, spin=-r.spin) for r in QUAD.rotors)
    x8 = replace(QUAD, rotors=(*QUAD.rotors, *pairs))
    for ratio, objected in ((0.03, 0), (0.035, 1)):
        command["moment_ratio"] = Estimate(ratio, 1e-4)
        assert len(objections(evidence(command, x8, RotorInput.COMMAND))) == objected


def turning(k_T, ages=()):
    """Evidence of rotors of these thrust coefficients, known to a thousandth of the mean."""
    k_T = np.asarray(k_T)
    rotors, n = len(k_T), rb.N_THETA
    apart = np.linalg.svd(np.ones((1, rotors)))[2][1:]
    m = len(apart)
    own = np.zeros((N_UNKNOWNS + m, N_UNKNOWNS + m))
    own[N_UNKNOWNS:, N_UNKNOWNS:] = 1e-6 * np.eye(m)
    rotation = RotationFit(
        np.zeros(n), np.zeros((n, n)), np.eye(3), np.ones(3), 1000, True,
        deviations=apart @ (k_T / k_T.mean() - 1.0), extended_covariance=own, ages=np.array(ages),
        deviating=Deviations(np.zeros((m, 3, rb.N_SIGNALS)), np.full(m, 0.1), apart, 0.0 * apart,
                             *np.zeros((2, m, 3)), places=np.zeros((m, 2, rotors)),
                             sized=np.zeros(m, dtype=bool)),
    )  # fmt: skip
    spun = evidence(values() | {"rotor_inertia": Estimate(3e-5, 1e-6)})
    airframe = replace(QUAD, rotors=QUAD.rotors[:1] * rotors)
    return replace(spun, fit=Fit(rotation, None, 0.0), airframe=airframe)


@pytest.mark.parametrize(
    ("speed", "shown"), [(1.0, False), (1.03, False), (14 / 12, True), (12 / 14, True)]
)
def test_a_rotor_that_reads_otherwise_is_named_and_leaves_the_mean_uncertain(speed, shown):
    """Thrust for the speed read is off by its square; k_T was 7 to 9 half widths off."""
    k_T = np.array([1.0, 1.0, speed**-2.0, 1.0])
    mean = float(4.0 / (1.0 / k_T).sum())
    found = list(differing_rotors(turning(k_T)))
    assert [each.parameters for each in found] == (
        [{"k_T", "k_M"}, {"rotor_inertia", "Ixz", "Iyz"}] if shown else []
    )
    if shown:
        assert {each.cap for each in found} == {"weak"}
        assert found[0].words.endswith("check its propeller, and the pole count of its ESC")
        assert f"rotor 3 by {100.0 * (k_T[2] - 1.0):+.0f} % of the others" in found[0].reason
        own = found[0].widening["k_T"] / SOUND["k_T"]
        assert abs(mean - 1.0) < Z95 * own < 2.0 * abs(mean - 1.0)


def test_none_is_named_where_several_rotors_differ():
    (found, _) = differing_rotors(turning([1.25, 1.0, 1.25, 1.0]))
    assert "by up to 11 % of the mean" in found.reason
    (found,) = unlike_spins(replace(turning(np.ones(4)), spins=1.0 / 9.0))
    assert "the clockwise rotors lift 20 % less than the counter-clockwise ones" in found.reason
    assert found.widening["k_T"] == pytest.approx(SOUND["k_T"] / 9.0)
    assert not list(unlike_spins(replace(turning([1.0, 1.0, 1.4, 1.0]), spins=0.1)))


@pytest.mark.parametrize(
    ("name", "unlike", "caps"),
    [("hexa", None, [None]), ("hexa", 0.01, []), ("hexa", 0.11, ["weak"]), ("quad", 0.11, [])],
)
def test_where_no_flight_shows_unlike_rotors_commands_may(name, unlike, caps):
    evidence = replace(turning(np.ones(6)), airframe=load_airframe(f"px4-{name}-x"), unlike=unlike)
    assert [each.cap for each in unseen_rotors(evidence)] == caps


@pytest.mark.parametrize(
    ("ages", "k_T", "shown"),
    [
        ((-0.005, 0.015, -0.005, -0.005), np.ones(4), True),
        ((-0.003, 0.017, -0.003, -0.003, -0.003, -0.003), np.ones(6), True),
        ((0.001, -0.001, 0.001, -0.001), np.ones(4), False),
        ((), np.ones(4), False),
        # Its speeds are read wrong, which spoils what they say of time.
        ((-0.005, 0.015, -0.005, -0.005), (1.0, 1.4, 1.0, 1.0), False),
    ],
)
def test_readings_of_another_age_identify_no_rotation(ages, k_T, shown):
    found = list(aged_readings(turning(k_T, ages)))
    assert bool(found) is shown
    for one in found:
        assert "the readings of one rotor are" in one.reason
        assert "by some 20 ms" in one.reason
        assert {"Ixx", "k_M", "rotor_inertia"} <= one.parameters
        assert "k_T" not in one.parameters
    assert [one.reason for one in aged_readings(replace(turning(k_T, ages), stale="old"))] == [
        "old"
    ]


@pytest.mark.parametrize(("Izz", "named"), [(0.03, False), (2e-4, True)])
def test_a_body_without_extent_is_an_end_of_the_search(Izz, named):
    theta = rb.theta_of(
        SOUND | {"Ixx": 0.0201, "Iyy": 0.02, "Izz": Izz, "Ixy": 0.0, "Ixz": 0.0}, 1.0
    )
    n = rb.N_THETA
    rotation = RotationFit(theta, 1e-12 * np.eye(n), np.eye(3), np.ones(3), 5000, True)
    found = list(edge_of_bodies(replace(evidence(), fit=Fit(rotation, None, 0.0))))
    assert bool(found) is named
    caps = {name: one.cap for one in found for name in one.parameters}
    assert not named or (caps["Izz"], caps["Ixy"], caps["Ixx"]) == (
        "unobservable", "unobservable", "weak",
    )  # fmt: skip
