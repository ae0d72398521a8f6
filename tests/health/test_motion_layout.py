"""Where rotors are by how the vehicle turns: every order of a quad, hexas, coaxial pairs."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.health.airframe_guess import guess_airframe, layout_by_motion
from gcs_sysid.health.assessment import HoverRecords, beside_analysis
from gcs_sysid.health.health_file import document_of
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.judgement.judge import object_to
from gcs_sysid.judgement.status import ROTORS, SPINS
from gcs_sysid.model.airframe import Airframe, Rotor
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.rigid_body import mixer
from gcs_sysid.report.page import health_section
from gcs_sysid.screen.panels import health_lines
from gcs_sysid.session.reported_layout import place_words, usual_layouts
from gcs_sysid.signals.columns import RecordBlock, Track
from gcs_sysid.signals.records import Stream
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.vehicles import MavlinkSystem
from gcs_sysid.web.page_json import why_no_health
from tests.known_results import result_of

RATE = 100.0
PX4 = MavlinkSystem(1, 1, mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4)
BETAFLIGHT = usual_layouts(4)["quad bf-x"]
COAXIAL = tuple(
    Rotor(x, y, spin)
    for spin, corners in ((1, ((1, 1), (1, -1), (-1, -1), (-1, 1))),
                          (-1, ((1, -1), (1, 1), (-1, 1), (-1, -1))))
    for x, y in corners
)  # fmt: skip


def flight(rotors, *, moving=1.0, gusts=0.3, seed=1, extra=0, crosstalk=0.0):
    """A vehicle that its mixer turns to and fro, with gusts, at RATE.

    With crosstalk, it does not pitch but for this share of its yaw.
    """
    random = np.random.default_rng(seed)
    n = int(40.0 * RATE)
    t = 10.0 + np.arange(n) / RATE
    keep = 0.95
    wanted = random.standard_normal((n, 4)) * (1.0, 1.0, 0.2, 0.3)
    for i in range(1, n):
        wanted[i] = keep * wanted[i - 1] + (1.0 - keep) * wanted[i]
    wanted *= 0.1 * moving / wanted[:, 0].std()
    if crosstalk:
        wanted[:, 1] = 0.0
    geometry = Airframe("true", rotors).geometry
    allocation = np.linalg.pinv(mixer(geometry))  # roll, pitch, thrust, yaw to rotors
    thrust = 1.0 + wanted[:, [0, 1, 2, 3]] @ allocation
    thrust /= thrust.mean()
    x, y, spin = geometry
    moment = 5.0 * thrust @ np.column_stack([-y, x, 0.1 * spin])
    if crosstalk:
        moment[:, 1] = crosstalk * moment[:, 2]
    moment -= moment.mean(axis=0)
    slow = np.cumsum(random.standard_normal((n, 3)), axis=0)
    slow *= gusts * moment.std(axis=0) / slow.std(axis=0)
    rates = np.cumsum(moment + slow, axis=0) / RATE
    force = thrust.mean(axis=1)[:, None] * [0.0, 0.0, -9.81]
    speeds = 500.0 * np.sqrt(np.maximum(thrust, 0.05))
    if extra:
        speeds = np.hstack([speeds, np.full((n, extra), 20.0)])
    order = 2 * np.arange(n)
    return [
        RecordBlock(
            (
                Track(Stream.IMU, t, np.hstack([rates, force]), order=order),
                Track(Stream.ROTOR_SPEED, t, speeds, 0, "ESC", order + 1),
                Track(Stream.IN_AIR, t[::10], np.ones((n // 10, 1)), order=order[::10] + 1),
            )
        )
    ]


def layout(blocks, airframe=None, parameters=None):
    guess = guess_airframe(PX4, parameters or {}, airframe, 0.3)
    return layout_by_motion(blocks, guess, "px4", parameters or {})[0]


def places(rotors):
    return [(place_words(rotor), rotor.spin) for rotor in rotors]


@pytest.mark.parametrize("name", sorted(usual_layouts(4)))
def test_any_order_of_four_is_found(name):
    rotors = usual_layouts(4)[name]
    found = layout(flight(rotors))
    assert places(found.airframe.rotors) == places(rotors)
    assert found.shown
    assert found.airframe.arm == pytest.approx(0.3)
    words = found.origin
    assert "as the flight shows" in words or rotors == usual_layouts(4)["quad x"]
    assert "0.3 m from the center" in words


@pytest.mark.parametrize("rotors", [usual_layouts(6)["hexa plus"], COAXIAL])
def test_more_rotors_than_the_vehicle_tells_are_seen(rotors):
    found = layout(flight(rotors))
    assert places(found.airframe.rotors) == places(rotors)


def test_outputs_that_carry_nothing_are_no_rotors():
    found = layout(flight(BETAFLIGHT, extra=4))
    assert places(found.airframe.rotors) == places(BETAFLIGHT)


def test_a_vehicle_that_gusts_alone_turn_shows_no_layout():
    guess = layout(flight(BETAFLIGHT, moving=0.01, gusts=1000.0))
    assert not guess.shown
    assert "assumed" in guess.origin


def test_what_is_given_stays_and_what_is_told_too():
    given = Airframe("mine", usual_layouts(4)["quad x"]).with_arm(0.2)
    found = layout(flight(BETAFLIGHT), given)
    assert found.airframe is given
    assert not found.shown
    assert layout(flight(given.rotors), given).shown
    # PX4's stock parameters have no lengths, but an order.
    told = {"CA_ROTOR_COUNT": 4.0}
    for i, rotor in enumerate(usual_layouts(4)["quad x"]):
        told |= {f"CA_ROTOR{i}_PX": round(rotor.x), f"CA_ROTOR{i}_PY": round(rotor.y)}
        told |= {f"CA_ROTOR{i}_KM": 0.05 * rotor.spin}
    assert places(layout(flight(BETAFLIGHT), None, told).airframe.rotors) == places(given.rotors)


class Told:
    """What a log tells beside its records."""

    vehicle = PX4
    systems = (PX4,)
    parameters: dict[str, float] = {}  # noqa: RUF012
    problems = ()


def health(rotors, **how):
    """Of a flight with Betaflight's motor order, assessed with these rotors."""
    keeper = HoverRecords()
    keeper.begin(Told())
    for block in flight(BETAFLIGHT, **how):
        keeper.add_records(block)
    airframe = Airframe("mine", rotors).with_arm(0.2).with_anchor("mass", 1.0)
    return keeper.health("a.tlog", HealthOptions(airframe))


OTHER_ORDERS = set(usual_layouts(4)) - {"quad bf-x", "quad bf-x-reversed"}
AS_FLOWN = "as flown, motor 1 is rear right, 2 front right, 3 rear left, 4 front left"


@pytest.mark.parametrize("name", sorted(OTHER_ORDERS))
def test_a_motor_order_that_the_motion_contradicts_tells_no_cg(name):
    rotors = usual_layouts(4)[name]
    found = health(rotors, moving=0.1)
    assert found.contradicted
    document = document_of(found)
    assert document["verdict"] == "refused"
    assert document["cg"] is None
    assert (document["rotors"], document["advice"]) == ([], [])
    assert document["autopilot_parameters"] == {}
    assert AS_FLOWN in document["reasons"][0]
    panel = " ".join(text for line in health_lines(document, 79) for text, _ in line)
    assert AS_FLOWN in panel
    assert AS_FLOWN in str(health_section(document))
    assert AS_FLOWN in why_no_health({"health": document})[0]


def test_the_order_as_flown_keeps_its_cg_and_so_does_one_that_gusts_hide():
    for turned in ("", "-reversed"):  # spins do not count, and are named
        found = health(usual_layouts(4)[f"quad bf-x{turned}"], moving=0.1)
        assert found.available
        assert not found.contradicted
        assert [doubt.by for doubt in found.doubts] == [SPINS] * bool(turned)
    assert why_no_health({"health": document_of(found)}) == []
    rolled = flight(BETAFLIGHT, crosstalk=0.1)
    assert layout(rolled, Airframe("mine", BETAFLIGHT)).as_flown == ""
    gusty = layout(flight(BETAFLIGHT, moving=0.01, gusts=1000.0), Airframe("mine", BETAFLIGHT))
    assert gusty.as_flown == ""


def test_an_analysis_refused_by_its_rotors_withholds_the_hover():
    found = health(BETAFLIGHT, moving=0.1)
    why = "the motion does not match these rotors: check motor order"
    note = Objection("gyro spikes", verdict="identified", by="data")
    wrong = Objection(why, verdict="refused", by=ROTORS)
    nothing = result_of({})
    withheld = beside_analysis(found, object_to(nothing, [note, wrong]))
    assert withheld.contradicted
    assert why in withheld.reasons[0]
    # Any other refusal leaves it, and so does the same reason below a result.
    elsewhere = Objection("no attitude (ATTITUDE)", verdict="refused", by="data")
    assert beside_analysis(found, object_to(nothing, [elsewhere])) == found
    assert beside_analysis(found, object_to(nothing, [replace(wrong, verdict="partial")])) == found


def test_frames_of_ardupilot():
    vehicle = MavlinkSystem(1, 1, mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    plus = guess_airframe(vehicle, {"FRAME_CLASS": 1.0, "FRAME_TYPE": 0.0}, None, None)
    assert [place_words(r) for r in plus.airframe.rotors] == ["right", "left", "front", "rear"]
    assert not plus.assumed
    with pytest.raises(InputError, match="FRAME_CLASS 7 and FRAME_TYPE 1 are not a known frame"):
        guess_airframe(vehicle, {"FRAME_CLASS": 7.0, "FRAME_TYPE": 1.0}, None, None)
    plane = replace(vehicle, vehicle_type=mavlink.MAV_TYPE_FIXED_WING)
    with pytest.raises(InputError, match="fixed wing, and no multirotor"):
        guess_airframe(plane, {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}, None, 0.3)


def test_rotors_that_change_places_in_flight_are_named():
    own = (replace(BETAFLIGHT[0], x=-0.1), *BETAFLIGHT[1:])
    blocks = flight(own)
    speeds = blocks[0].tracks[1].values
    speeds[2500:, [0, 1]] = speeds[2500:, [1, 0]]
    assert "for a part" in layout(blocks, Airframe("given", own)).as_flown
