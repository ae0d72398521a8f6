"""Parameters of the autopilot by flights: none that may be right is set."""

import json
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink import mavparm

from benchmarks.params import of_vehicle
from gcs_sysid.__main__ import main
from gcs_sysid.errors import InputError
from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.autopilot_parameters import Proposal, determined, proposal_file
from gcs_sysid.health.barometer import thrust_pressure
from gcs_sysid.health.command_curve import Curve
from gcs_sysid.health.drive_health import motor_current
from gcs_sysid.health.hover import windows_of
from gcs_sysid.health.vehicle_health import Finding, Health, HealthOptions, HoverCommand
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Quantity
from sim_bridge.sensor_faults import SensorFaults
from testbed.hover_flights import LAYOUTS, ORDINARY, fly, pressure_in, streams_in
from testbed.vehicles import draw

FLIGHTS = ("00000077", "00000096", "00000108", "00000122")
"""Of one vehicle, at 52 to 58 V."""


@pytest.fixture(scope="module")
def quiver(shared_log):
    logs = [shared_log(f"field/quiver/{number}.BIN") for number in FLIGHTS]
    return [ReadLog(log).health(HealthOptions(arm=0.67)) for log in logs]


def by_name(found):
    return {one.name: one for one in found}


def test_what_is_set_is_nearer_to_the_truth_wherever_the_old_value_lies():
    random = np.random.default_rng(3)
    verdicts, moved_away = Counter(), 0
    for _ in range(6_000):
        truth, std, old = random.uniform(0.0, 1.0), 10.0 ** random.uniform(-3.0, -1.0), None
        old = truth + random.choice([0.0, 3.0, 10.0]) * std * random.standard_normal()
        new = Quantity(truth + std * random.standard_normal(), std, "1")
        then = random.choice([None, old + std, 1.3 * old])
        one = Proposal("MOT_THST_HOVER", new, old, use=0.15, then=then)
        verdicts[one.verdict] += 1
        if one.verdict == "set":
            moved_away += abs(one.new - truth) > abs(old - truth)
        if one.verdict != "cannot tell":
            assert new.half <= 0.15
    assert moved_away <= 0.001 * verdicts["set"]
    assert min(verdicts[word] for word in ("set", "leave", "cannot tell")) > 300


def test_what_is_not_known_is_not_set_and_the_flight_that_shows_it_is_named():
    unknown = Proposal("A", None, 1.0, lacks="no climbs", fly="climb")
    wide = Proposal("B", Quantity(3.0, 0.5, "1"), 1.0, "by hover", use=0.1, fly="fly longer")
    unlogged = Proposal("C", Quantity(3.0, 0.1, "1"), None)
    right = Proposal("D", Quantity(3.0, 0.1, "1"), 3.1)
    kept = Proposal("E", Quantity(3.0, 0.1, "1"), 1.0, keep="with the gains alone")
    found = [(one.verdict, one.action) for one in (unknown, wide, unlogged, right, kept)]
    assert found == [
        ("cannot tell", "climb"),
        ("cannot tell", "fly longer"),
        ("cannot tell", "log the autopilot's parameters"),
        ("leave", ""),
        ("leave", ""),
    ]
    assert "lies in the interval" in right.reason
    # A throttle that means another thrust once the curve is set goes with it, where that is nearer.
    moved = [
        Proposal("F", Quantity(value, 0.1, "1"), 3.0, then=4.0) for value in (3.9, 3.1, 4.9, 3.5)
    ]
    assert [one.verdict for one in moved] == ["set", "leave", "set", "leave"]
    assert (moved[0].new, moved[2].new) == (4.0, 4.9)


def test_flights_of_one_vehicle_agree_and_show_that_voltage_is_made_up_for_twice(quiver):
    """Its speeds do not fall with the battery: MOT_BAT_VOLT_MAX moved the hover by the charge."""
    curves = [health.curve.c for health in quiver]
    mean = np.average([c.value for c in curves], weights=[c.std**-2.0 for c in curves])
    assert max(abs(c.value - mean) / c.std for c in curves) < 2.5
    for health in quiver:
        x = health.hover_command
        # The autopilot's own throttle is that of the outputs, by curve, voltage and air.
        air = x.throttle / x.thrust(health.parameters["MOT_THST_EXPO"], x.voltage)
        assert air == pytest.approx(0.797, abs=0.008)
    found = by_name(determined(quiver))
    assert found["MOT_BAT_VOLT_MAX"].verdict == "set"
    assert found["MOT_BAT_VOLT_MAX"].quantity.value == 0.0
    # Its notch follows no lower than 80 Hz, and the rotors turn with 68.
    assert found["INS_HNTCH_FREQ"].verdict == found["INS_HNTCH_BW"].verdict == "set"
    assert 40.0 < found["INS_HNTCH_FREQ"].new < 68.0
    hover = found["MOT_THST_HOVER"].quantity
    low, high = hover.ci95
    alone = [by_name(determined([one, quiver[0]]))["MOT_THST_HOVER"] for one in quiver[1:]]
    for other in alone:
        assert other.quantity.ci95[0] < high
        assert other.quantity.ci95[1] > low
    assert found["MOT_THST_HOVER"].flights == len(FLIGHTS)


def test_the_command_prints_and_writes_what_is_to_be_set(quiver, tmp_path, capsys):
    file, document = tmp_path / "new.param", tmp_path / "new.json"
    logs = [health.source for health in quiver[:2]]
    words = ["params", *logs, "--arm", "0.67", "-o", str(file), "--json", str(document)]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) < 80 for line in lines)
    assert any(line[:16] == "MOT_BAT_VOLT_MAX" and line.endswith("  set") for line in lines)
    made = json.loads(document.read_text())
    assert made["schema"] == "gcs-sysid-params/1"
    verdicts = {row["name"]: row["verdict"] for row in made["parameters"]}
    written = [line for line in file.read_text().splitlines() if not line.startswith("#")]
    assert [line.partition(",")[0] for line in written] == [
        name for name, verdict in verdicts.items() if verdict == "set"
    ]
    loaded = mavparm.MAVParmDict()  # MAVProxy's own reader, whose format Mission Planner's is
    assert loaded.load(str(file))
    assert len(loaded) == len(written)
    assert all(row["fly"] for row in made["parameters"] if row["verdict"] == "cannot tell")


def test_what_contradicts_a_flight_comes_first_and_nothing_of_it_is_set(quiver, shared_log, capsys):
    finding = Finding("motor 3", "reaches 30 % less speed", "look at it", spoils=True)
    assert determined([replace(quiver[0], findings=(finding,))]) == ()
    both = determined([quiver[1], replace(quiver[0], apart="another vehicle's rotors")])
    assert {one.flights for one in both if one.quantity is not None} == {1}
    # Motor order of another autopilot.
    wrong = shared_log("px4-esc-cg.tlog")
    words = ["params", str(wrong), "--airframe", "betaflight-quad-x", "--arm", "0.24"]
    assert main(words) == 1
    assert "does not count: " in capsys.readouterr().out.splitlines()[0]


def test_a_flight_of_px4_s_own_simulator_has_nothing_to_set(shared_log, capsys):
    log = str(shared_log("px4-esc-cg.tlog"))
    assert main(["params", log]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line[:1].isupper()]
    verdicts = {row[0]: row[-1] for row in rows}
    assert verdicts["THR_MDL_FAC"] == verdicts["MPC_THR_HOVER"] == "leave"
    assert "set" not in verdicts.values()


def hovering(autopilot, parameters, **fields):
    """A vehicle of the layout given, whose CG is in the middle."""
    still, airframe = Quantity(0.0, 1e-3, "m"), load_airframe("betaflight-quad-x")
    return Health(
        "a.log", autopilot=autopilot, airframe=airframe, cg=(still, still), parameters=parameters,
        **fields,
    )  # fmt: skip


def test_thrust_linear_is_left_with_what_it_would_do_to_the_gains():
    curve = Curve(Quantity(0.6, 0.02, "1"), "speeds over commands")
    command, now = HoverCommand(0.4, 0.16, 0.01), {"thrust_linear": 0.0, "motor_poles": 14.0}
    health = hovering("generic", now, curve=curve, hover_command=command)
    found = by_name(determined([health]))
    linear = found["thrust_linear"]
    assert linear.verdict == "leave"
    thrust = 0.4 * 0.4 + 0.6 * 0.16
    assert thrust * (1.0 + 0.01 * linear.quantity.value * (1.0 - thrust) ** 2) == pytest.approx(0.4)
    assert "gains" in linear.reason
    for turning, verdict in ((None, "cannot tell"), (14.0 / 12.0, "cannot tell"), (1.0, "leave")):
        poles = by_name(determined([replace(health, turning=turning)]))["motor_poles"]
        assert poles.verdict == verdict
        assert ("12 poles" in poles.reason) == (turning == 14.0 / 12.0)
    text = proposal_file([health], determined([health]), ".txt")
    assert "# Nothing is to be set." in text
    assert all(line.startswith("#") for line in text.splitlines())
    with pytest.raises(InputError, match=r"\.txt"):
        proposal_file([health], determined([health]), ".params")
    with pytest.raises(InputError, match=r"\.params"):
        proposal_file([Health("a.ulg", autopilot="px4")], (), ".txt")
    whole = Proposal("MC_BAT_SCALE_EN", Quantity(0.0, 0.0, ""), 1.0)
    text = proposal_file([replace(health, autopilot="px4")], (whole,), ".params")
    assert "1\t1\tMC_BAT_SCALE_EN\t0\t6\n" in text


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["a.tlog", "-o", "p.csv"], ".params"),
        (["a.tlog", "-o", "nowhere/p.param"], "nowhere"),
        (["none.tlog"], "none.tlog"),
        (["a.tlog", "--t-max", "3"], "--airframe"),
    ],
)
def test_wrong_usage_is_one_line(tmp_path, monkeypatch, capsys, options, word):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.tlog").write_bytes(b"")
    assert main(["params", *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert word in said.err


@pytest.mark.slow  # flights of a vehicle; benchmarks.params flies forty
@pytest.mark.parametrize("number", [1, pytest.param(5, marks=pytest.mark.thorough)])
def test_emulated_vehicles_get_what_is_true_and_keep_what_is_right(number, tmp_path):
    found, truth = of_vehicle(number, tmp_path, "px4", speeds=True)
    known = [one for one in found if one.quantity is not None and one.name in truth]
    held = [abs(one.quantity.value - truth[one.name]) <= one.quantity.half for one in known]
    assert np.mean(held) > 0.85
    for one in known:
        if one.verdict == "set":
            assert abs(one.new - truth[one.name]) < abs(one.now - truth[one.name])


def test_the_line_of_motor_currents_is_one_for_all_motors_and_moves_as_a_whole():
    t, at = np.arange(0.0, 60.0, 0.5), np.arange(-1.0, 61.0, 0.1)
    thrust, commanded = (np.tile(0.4 + 0.05 * np.sin(x[:, None]), 4) for x in (t, at))
    flown = SimpleNamespace(t=t, half=0.5, commands=thrust, squares=0.0 * thrust, idle=t < 0.0)
    currents = 6.9 * commanded + 0.4 + np.random.default_rng(1).normal(0.0, 0.1, commanded.shape)
    streams = SimpleNamespace(flight=SimpleNamespace(start=5.0), extras={})
    streams.extras["motor currents"] = at + 5.0, currents
    line = motor_current(streams, flown, 0.0)

    def verdicts(slope, idle, line=line):
        now = {"MOTFAIL_C2T": slope, "MOTFAIL_IDLE": idle}
        found = by_name(determined([hovering("px4", now, motor_current=line)]))
        return [(found[f"MOTFAIL_{n}"].verdict, found[f"MOTFAIL_{n}"].new) for n in ("C2T", "IDLE")]

    (what, slope), (idle, left) = verdicts(35.0, 0.0)
    assert (what, idle) == ("set", "leave")
    assert (slope, left) == pytest.approx((6.9, 0.4), abs=0.3)
    assert [what for what, _ in verdicts(6.9, 0.4)] == ["leave", "leave"]
    assert [what for what, _ in verdicts(6.9, 2.9)] == ["leave", "set"]
    # C2T alone would lower the line in hover, where it was right.
    (what, _), (idle, moved) = verdicts(3.0, 1.96)
    assert (what, idle) == ("set", "set")
    assert moved == pytest.approx(0.4, abs=0.2)
    assert [what for what, _ in verdicts(35.0, 0.0, None)] == ["cannot tell", "cannot tell"]


def of_notch(autopilot, **now):
    """Proposals for a vehicle whose rotors turn with 100 Hz at a throttle of 0.25."""
    command, turning = HoverCommand(0.25, 0.0625, 0.01, throttle=0.25), Quantity(100.0, 0.5, "Hz")
    now |= {"MOT_THST_EXPO": 0.0}
    fields = {"hover_command": command, "hover_frequency": turning}
    return by_name(determined([hovering(autopilot, now, **fields)]))


def test_a_notch_is_set_where_the_rotors_are_and_one_for_something_else_is_left():
    def harmonic(**now):
        named = {f"INS_HNTCH_{name}": value for name, value in now.items()}
        found = of_notch("ardupilot", INS_HNTCH_ENABLE=1.0, INS_HNTCH_BW=40.0, **named)
        return found["INS_HNTCH_FREQ"], found.get("INS_HNTCH_BW")

    by_throttle, width = harmonic(MODE=1.0, REF=1.0, FREQ=80.0)
    assert by_throttle.verdict == "set"
    assert by_throttle.new * np.sqrt(0.25) == pytest.approx(100.0, rel=0.01)
    assert width.new / by_throttle.new == pytest.approx(0.5)
    follows, _ = harmonic(MODE=3.0, REF=1.0, FREQ=120.0)
    assert follows.verdict == "set"
    assert follows.new == pytest.approx(100.0 * np.sqrt(0.5))
    for low in (harmonic(MODE=3.0, REF=1.0, FREQ=60.0), harmonic(MODE=0.0, REF=0.0, FREQ=40.0)):
        assert low[0].verdict == "leave"
        assert low[1] is None
    assert of_notch("generic", dshot_bidir=1.0, rpm_filter_harmonics=3.0, rpm_filter_min_hz=130.0)[
        "rpm_filter_min_hz"
    ].verdict == "set"  # fmt: skip


@pytest.mark.parametrize(("seed", "full"), [(0, -120.0), (1, 1e-3), (2, 200.0)])
def test_pressure_for_thrust_is_set_where_climbs_show_it(tmp_path, seed, full):
    drawn, log = draw(seed, LAYOUTS), tmp_path / "a.tlog"
    fly(log, drawn, ORDINARY, seed, sensor_faults=SensorFaults(thrust_pressure=full))
    streams, read = streams_in(log, drawn.airframe, speeds=False), pressure_in(log)
    windows, c = windows_of(streams, len(drawn.airframe.rotors)), float(drawn.vehicle.thrust_curve)
    assert thrust_pressure(streams, windows, c) is None
    streams = replace(streams, extras={"pressure": read})
    assert thrust_pressure(streams, windows.part(windows.t < 8.0), c) is None
    for stuck in (0.0, 95000.0):
        lost = replace(streams, extras={"pressure": (read[0], 0.0 * read[1] + stuck)})
        assert thrust_pressure(lost, windows, c) is None
    found = thrust_pressure(streams, windows, c)
    assert abs(found.full.value - full) < found.full.half < 25.0
    for autopilot, name, unit in (
        ("ardupilot", "BARO1_THST_SCALE", 1.0), ("px4", "SENS_BARO_K_T", 1.0 / found.meter),
    ):  # fmt: skip
        known = {"barometer": found, "hover_thrust": Quantity(0.4, 0.01, "1")}
        cases = (({name: 0.0}, known), ({name: unit * full}, known), ({name: 0.0}, {}), ({}, known))
        rows = [by_name(determined([hovering(autopilot, now, **of)])) for now, of in cases]
        of_zero = "set" if abs(full) > 1.0 else "leave"
        assert [row[name].verdict for row in rows[:3]] == [of_zero, "leave", "cannot tell"]
        assert name not in rows[3]
        assert abs(rows[0][name].new - unit * full) < unit * found.full.half
