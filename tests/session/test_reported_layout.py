"""What a vehicle tells of its rotors, and what an airframe says otherwise."""

import argparse
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.cli import airframe_choice
from gcs_sysid.cli.program import run
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe, Rotor, load_airframe
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.reported_layout import (
    airframe_of_layout,
    differences,
    notes,
    reported_layout,
)
from gcs_sysid.setup_help.airframe_file import layout_rotors
from sim_bridge.ardupilot_parameters import ardupilot_parameters
from sim_bridge.cli import main as sim_bridge
from sim_bridge.px4_parameters import px4_parameters
from sim_bridge.simulated_vehicle import even
from sim_bridge.vehicle_files import load_vehicle
from tests.blackbox_logs import blackbox_of

QUAD = load_airframe("px4-quad-x")


def parameters_of(rotors, **more):
    """As PX4 tells them."""
    table = {"CA_AIRFRAME": 0.0, "CA_ROTOR_COUNT": float(len(rotors))}
    for i, rotor in enumerate(rotors):
        table |= {f"CA_ROTOR{i}_PX": rotor.x, f"CA_ROTOR{i}_PY": rotor.y}
        table[f"CA_ROTOR{i}_KM"] = 0.05 * rotor.spin
    return table | more


def px4(rotors=QUAD.rotors, **more):
    return reported_layout("px4", parameters_of(rotors, **more))


def turned(rotors, degrees):
    """Clockwise, seen from above."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return tuple(Rotor(c * r.x - s * r.y, s * r.x + c * r.y, r.spin) for r in rotors)


def airframe(rotors):
    return replace(QUAD, rotors=tuple(rotors))


def swapped(i, j):
    rotors = list(QUAD.rotors)
    rotors[i], rotors[j] = rotors[j], rotors[i]
    return rotors


@pytest.mark.parametrize("name", ["px4-quad-x", "px4-hexa-x", "px4-octo-x", "paper", "px4-sih"])
def test_px4_proposes_what_it_flies_by(name):
    rotors = load_airframe(name).rotors
    told = px4(rotors)
    assert told.sized
    assert airframe_of_layout(told, None).rotors == rotors
    assert airframe_of_layout(told, 0.4).arm == pytest.approx(0.4)
    assert differences(load_airframe(name), told) == ()


KINDS = {"quad": 1.0, "hexa": 2.0, "octo": 3.0}


@pytest.mark.parametrize("layout", ["quad-x", "hexa-x", "octo-x"])
def test_ardupilot_proposes_its_frame(layout):
    kind = KINDS[layout.split("-")[0]]
    told = reported_layout("ardupilot", {"FRAME_CLASS": kind, "FRAME_TYPE": 1.0})
    assert not told.sized
    assert differences(load_airframe(f"ardupilot-{layout}"), told) == ()
    with pytest.raises(InputError, match="give --arm M"):
        airframe_of_layout(told, None)
    assert airframe_of_layout(told, 0.3).arm == pytest.approx(0.3)


@pytest.mark.parametrize("shape", ["quad-plus", "hexa-plus", "octo-plus"])
def test_both_have_the_plus_frames_of_the_wizard(shape):
    kind = KINDS[shape.split("-")[0]]
    usual = airframe(layout_rotors(f"ardupilot-{shape}", 0.25))
    told = reported_layout("ardupilot", {"FRAME_CLASS": kind, "FRAME_TYPE": 0.0})
    assert differences(usual, told) == ()
    autostart = {"quad-plus": 5001, "hexa-plus": 7001, "octo-plus": 9001}[shape]
    assert differences(usual, reported_layout("px4", {"SYS_AUTOSTART": float(autostart)})) == ()


def test_betaflights_order_is_another_one():
    told = reported_layout("ardupilot", {"FRAME_CLASS": 1.0, "FRAME_TYPE": 12.0})
    (line,) = differences(load_airframe("ardupilot-quad-x"), told)
    assert "motor order: motor 1 is front right, on the vehicle rear right" in line


# Roll, pitch and yaw factors of AP_MotorsMatrix.cpp: to the left, forward and counter-clockwise.
Y6 = {
    1: ((-1, 0.5, 1), (1, 0.5, -1), (1, 0.5, 1), (0, -1, -1), (-1, 0.5, -1), (0, -1, 1)),
    10: ((-1, 0.5, -1), (-1, 0.5, 1), (0, -1, -1), (0, -1, 1), (1, 0.5, -1), (1, 0.5, 1)),
    11: ((0, -1, 1), (-1, 0.5, 1), (1, 0.5, 1), (0, -1, -1), (-1, 0.5, -1), (1, 0.5, -1)),
}


@pytest.mark.parametrize("form", Y6)
def test_the_frames_of_three_arms_are_allocated_as_ardupilot_does(form):
    told = reported_layout("ardupilot", {"FRAME_CLASS": 5.0, "FRAME_TYPE": float(form)})
    x, y, spin = Airframe("y6", told.rotors).geometry
    np.testing.assert_allclose(np.transpose((-y / np.sin(np.pi / 3), x, spin)), Y6[form], atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "form"), [(4, 0), (4, 1), (4, 3), (4, 12), (4, 14), (5, 1), (5, 10), (12, 0), (12, 1)]
)
def test_a_coaxial_pair_in_the_wrong_order_is_named(kind, form):
    told = reported_layout("ardupilot", {"FRAME_CLASS": float(kind), "FRAME_TYPE": float(form)})
    rotors = list(airframe_of_layout(told, 0.3).rotors)
    assert differences(airframe(rotors), told) == ()
    places = [(round(r.x, 6), round(r.y, 6), r.spin) for r in rotors]
    assert all((x, y, -spin) in places for x, y, spin in places)
    lower = places.index((*places[0][:2], -places[0][2]))
    rotors[0], rotors[lower] = rotors[lower], rotors[0]
    (line,) = differences(airframe(rotors), told)
    assert "motors 1" in line
    assert "spin the other way" in line


def test_what_the_emulators_tell_is_what_they_fly():
    for name in ("px4-quad-x", "px4-hexa-x", "px4-octo-x", "paper"):
        vehicle = load_vehicle(name, None)
        found = {p.name: float(p.value) for p in px4_parameters(vehicle, 1)}
        assert differences(load_airframe(name), reported_layout("px4", found)) == ()
        found = {p.name: float(p.value) for p in ardupilot_parameters(vehicle, 1)}
        told = reported_layout("ardupilot", found)
        assert told is None or differences(load_airframe(name), told) == ()


WRONG = {
    "count": (load_airframe("px4-hexa-x").rotors, "it has 6 rotors, the vehicle 4"),
    "spin": (
        [*QUAD.rotors[:1], replace(QUAD.rotors[1], spin=-1), *QUAD.rotors[2:]],
        "motor 2 (rear left) spins the other way",
    ),
    "all spins": ([replace(r, spin=-r.spin) for r in QUAD.rotors], "all its rotors spin the other"),
    "90 right": (turned(QUAD.rotors, 90), "it is turned by 90 degrees to the right"),
    "90 left": (turned(QUAD.rotors, -90), "it is turned by 90 degrees to the left"),
    "180": (turned(QUAD.rotors, 180), "it is turned by 180 degrees"),
    "45": (turned(QUAD.rotors, 45), "it is turned by 45 degrees to the right"),
    "two swapped": (
        swapped(0, 1),
        "motor order: motor 1 is rear left, on the vehicle front right; motor 2 is front right",
    ),
    "two of other spin swapped": (swapped(0, 2), "motor order: motor 1 is front left"),
    "elsewhere": ([Rotor(0.3, 0.0, 1), *QUAD.rotors[1:]], "rotors elsewhere: motor 1 is front"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_differs_is_said_in_words(case):
    rotors, words = WRONG[case]
    (line, *_) = differences(airframe(rotors), px4())
    assert line.startswith("wrong airframe px4-quad-x: ")
    assert words in line
    assert "CA_ROTORn_PX" in line


@pytest.mark.parametrize("stretch", [(1.0, 1.6), (1.4, 1.0)])
def test_a_quad_that_is_not_square_is_no_difference(stretch):
    long = [Rotor(stretch[0] * r.x, stretch[1] * r.y, r.spin) for r in QUAD.rotors]
    assert differences(airframe(long), px4()) == ()


def test_lengths_that_are_units_tell_no_size():
    """As in the simulator inside PX4."""
    told = px4([Rotor(np.sign(r.x), np.sign(r.y), r.spin) for r in QUAD.rotors])
    assert not told.sized
    assert differences(QUAD, told) == ()
    assert notes(QUAD, told) == ()


def test_another_arm_is_worth_a_word_and_no_more():
    told = px4(QUAD.with_arm(0.2).rotors)
    assert differences(QUAD, told) == ()
    (line,) = notes(QUAD, told)
    assert "arms of 0.25 m" in line
    assert "0.2 m" in line
    assert notes(QUAD, px4(QUAD.with_arm(0.255).rotors)) == ()
    exact = load_airframe("px4-sih")
    assert notes(exact, px4(exact.with_arm(exact.arm * (1.0 + 1e-7)).rotors)) == ()
    assert "arms of 0.25 m" in notes(QUAD, px4(QUAD.with_arm(0.265).rotors))[0]


def test_an_airframe_is_in_the_order_of_motors_whatever_their_outputs():
    functions = {f"PWM_MAIN_FUNC{i}": 100.0 + m for i, m in ((1, 3), (2, 1), (3, 4), (4, 2))}
    told = px4(**functions)
    assert told.outputs == (2, 0, 3, 1)
    by_output = tuple(QUAD.rotors[i] for i in told.outputs)
    assert airframe_of_layout(told, None).rotors == QUAD.rotors
    assert "motor order" in differences(airframe(by_output), told)[0]
    assert differences(QUAD, told) == ()
    (line,) = notes(QUAD, told)
    assert "its outputs drive motors 3, 1, 4, 2" in line


@pytest.mark.parametrize(
    ("autopilot", "parameters"),
    [
        ("px4", {}),
        ("px4", parameters_of(QUAD.rotors, CA_AIRFRAME=1.0)),  # fixed wing
        ("px4", parameters_of(QUAD.rotors, CA_ROTOR_COUNT=5.0)),  # not all have come
        ("px4", parameters_of(QUAD.rotors, CA_ROTOR_COUNT=1e9)),
        ("px4", parameters_of(QUAD.rotors, CA_ROTOR0_KM=0.0)),
        ("px4", parameters_of(QUAD.rotors, CA_ROTOR0_PX=float("inf"))),
        ("px4", parameters_of([Rotor(0.0, 0.0, 1)] * 4)),
        ("px4", {"SYS_AUTOSTART": 2100.0}),
        ("ardupilot", {"FRAME_CLASS": 1.0}),
        ("ardupilot", {"FRAME_CLASS": 15.0, "FRAME_TYPE": 1.0}),
        ("ardupilot", {"FRAME_CLASS": 1.0, "FRAME_TYPE": 4.0}),  # A tail
        ("generic", parameters_of(QUAD.rotors)),
    ],
)
def test_nothing_is_made_up(autopilot, parameters):
    assert reported_layout(autopilot, parameters) is None


# --- in a flight


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A hexa whose recording holds what it was asked for: its parameters."""
    log = tmp_path_factory.mktemp("told") / "hexa.tlog"
    words = ["--airframe", "px4-hexa-x", "--mission", "all-axes", "--duration", "8", "--rate", "50"]
    assert sim_bridge([*words, "--tlog", str(log)]) == 0
    return log


@pytest.mark.slow
def test_a_wrong_airframe_is_refused_with_the_reason_and_without_numbers(flight):
    given = Airframe("mine", QUAD.rotors).with_anchor("mass", 1.5)
    result = analyze_log(flight, given)
    assert result.verdict == "refused"
    assert result.reasons[0].startswith("wrong airframe mine: it has 4 rotors, the vehicle 6")
    for name, estimate in result.parameters.items():
        given_here = name == "mass"
        assert estimate.status == ("given" if given_here else "unobservable")
        # The mass is given to 0.5 %; nothing else has a number.
        assert (estimate.half is not None) is given_here
    layout = result.as_json()["telemetry"]["layout"]
    assert layout["differences"] == [result.reasons[0]]
    assert len(layout["rotors"]) == 6


@pytest.mark.slow
def test_the_airframe_of_a_log_that_tells_it(flight, capsys):
    options = argparse.Namespace(
        airframe=None, arm=None, mass=1.5, k_t=None, t_max=None, prior=[], vehicle=None
    )
    found, _ = airframe_choice.of_log(flight, options)
    assert differences(found, px4(load_airframe("px4-hexa-x").rotors)) == ()
    assert found.anchor() == ("mass", 1.5)
    assert "6 rotors by CA_ROTORn_PX" in capsys.readouterr().err
    assert analyze_log(flight, found).verdict != "refused"


LINE = "gcs-sysid: error: {}: the log does not contain the vehicle's {}: give "
ARM, MASS = "--arm M (center to each motor)", "--mass KG (weighed; or --k-t, or --t-max with"


@pytest.mark.parametrize(
    ("given", "lacking", "named"),
    [
        ([], "layout, size and mass", ("--airframe betaflight-quad-x", ARM, MASS)),
        (["--mass", "1"], "layout and size", ("--airframe betaflight-quad-x", ARM)),
        (["--arm", "0.1"], "layout and mass", ("--airframe betaflight-quad-x", MASS)),
        (["--arm", "0.1", "--k-t", "1e-7"], "layout", ("--airframe betaflight-quad-x",)),
    ],
)
def test_the_first_error_names_all_that_is_missing(tmp_path, capsys, given, lacking, named):
    log = blackbox_of(tmp_path, motors=4)
    assert run(["analyze", str(log), *given]) == 2
    said = capsys.readouterr().err
    assert said.startswith(LINE.format(log, lacking))
    assert said.count("\n") == 1
    for option in ("--airframe betaflight-quad-x", ARM, MASS):
        assert (option in said) is (option in named), option


def test_canted_rotors_of_px4_are_taken_over():
    canted = replace(load_vehicle("px4-hexa-x"), traits=replace(even(6), tilt=0.07))
    table = {p.name: float(p.value) for p in px4_parameters(canted, 1)}
    rotors = reported_layout("px4", table).rotors
    told = Airframe("reported", rotors)
    assert told.cant == pytest.approx(told.arm * np.tan(0.07))
    # One alone is no way to cant rotors: it is left out.
    table["CA_ROTOR0_AX"] = 0.2
    assert Airframe("reported", reported_layout("px4", table).rotors).cant == 0.0
