"""`gcs-sysid tune` and `export --ensemble`: what they print, write and return."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from gcs_sysid.cli.program import run
from gcs_sysid.judgement.plausibility import of_turning
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameter_file import read_parameter_file
from tests.known_results import estimates, result_of

COMMON = {
    "Ixx": 0.0165, "Iyy": 0.017, "Izz": 0.029, "Ixy": 1e-4, "Iyz": 1e-4, "Ixz": -1e-4,
    "cg_x": 0.01, "cg_y": -0.02, "moment_ratio": 0.03, "rotational_damping": 0.01,
}  # fmt: skip
BY = {
    "speed": {"k_T": 2e-4, "k_M": 6e-6, "rotor_inertia": 3e-5},
    "command": {"T_max": 10.0, "thrust_curve": 0.3},
}
NOW = {
    f"MC_{axis}{name}": value
    for axis in ("ROLL", "PITCH")
    for name, value in (("RATE_P", 0.09), ("RATE_I", 0.2), ("RATE_D", 0.002), ("_P", 6.5))
} | {"MC_YAWRATE_P": 0.1, "MC_YAWRATE_I": 0.05, "MC_YAW_P": 1.4, "MC_YAWRATE_FF": 0.01,
     "THR_MDL_FAC": 0.3}  # fmt: skip


def result(by, weak=(), autopilot="px4", **changes):
    values, weak = COMMON | BY[by] | changes, dict.fromkeys(weak, "weak")
    timing = {"rotor_delay": Estimate(-0.007, 2e-4, "s", "identified")}
    if by == "command":
        timing |= {"motor_lag": Estimate(0.03, 5e-4, "s", "identified")}
    return result_of(
        {"mass": Estimate(1.5, 0.01, "kg", "given"), **estimates(values, 0.01, statuses=weak)},
        source=f"{by}.tlog", vehicle={"sysid": 1, "compid": 1, "autopilot": autopilot},
        rotor_input=by, timing=timing, airframe=load_airframe("paper").as_json(),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result("speed").write(tmp_path / "speed.json")
    result("command").write(tmp_path / "command.json")
    lines = [f"1\t1\t{name}\t{value}\t9" for name, value in NOW.items()]
    (tmp_path / "now.params").write_text("# Onboard parameters\n" + "\n".join(lines) + "\n")
    return tmp_path


FEW = ("--draws", "10")


@pytest.mark.slow
def test_gains_now_and_proposed(files, capsys):
    more = ["--with", "command.json", "--json", "t.json", "--bode", "b.svg", *FEW]
    assert run(["tune", "speed.json", "now.params", *more]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert re.search(r"^MC_ROLLRATE_P +0\.09 +0\.\d+$", out, re.MULTILINE)
    assert "(identified, from command" in out
    document = json.loads((files / "t.json").read_text())
    assert document["schema"] == "gcs-sysid-tune/1"
    # -rotor_delay less half a period of the loop.
    assert document["delay"]["value"] == pytest.approx(0.007 - 0.00125)
    now, proposed = (document["margins"][n]["roll"] for n in ("now", "proposed"))
    assert now["attitude_loop_closed"]["phase_deg"]["value"] < 45.0
    for axis in document["margins"]["proposed"].values():
        assert axis["attitude_loop_closed"]["phase_deg"]["worst"] >= 45.0
        assert axis["attitude_loop_closed"]["gain_db"]["worst"] >= 6.0
    assert (
        proposed["attitude_loop_closed"]["phase_deg"]["low"]
        < (proposed["attitude_loop_closed"]["phase_deg"]["high"])
    )
    gains = document["parameters"]
    assert gains["now"]["MC_ROLLRATE_P"] == 0.09
    for name, value in NOW.items():
        if name in gains["proposed"]:
            assert 0.5 * value <= gains["proposed"][name] <= 2.0 * value
    assert gains["proposed"]["MC_YAWRATE_FF"] == 0.01
    assert document["leave"] is None
    assert re.search(r"note: proposed gains on .*roll.* keep at least [45]\d deg and \d", out)
    picture = ElementTree.fromstring((files / "b.svg").read_text())
    names = [element.tag.rpartition("}")[2] for element in picture.iter()]
    # Two sets of gains, three axes, magnitude and phase: a line and a band each.
    assert names.count("polyline") == names.count("polygon") == 12


@pytest.mark.slow
def test_gains_that_keep_the_margins_are_left_as_they_are(files, capsys):
    write = ("--to", "px4-params", "--set", "rotor_inertia=3e-5+-3e-6", *FEW)
    assert run(["tune", "command.json", *write, "-o", "good.params"]) == 0
    capsys.readouterr()
    assert run(["tune", "command.json", "good.params", *write, "-o", "none.params"]) == 1
    out = capsys.readouterr().out
    assert "leave it: the present gains on roll, pitch, yaw keep at least" in out
    assert "MC_ROLLRATE_P" not in out
    assert not (files / "none.params").exists()


@pytest.mark.slow
def test_an_axis_that_a_step_does_not_mend_is_left_as_it_is(files, capsys):
    hot = {**NOW, "MC_ROLLRATE_P": 0.4}
    lines = [f"1\t1\t{name}\t{value}\t9" for name, value in hot.items()]
    (files / "hot.params").write_text("\n".join(lines) + "\n")
    assert run(["tune", "speed.json", "hot.params", "--with", "command.json", *FEW]) == 0
    out = capsys.readouterr().out
    assert "no gains on roll within a factor of 2 of the present ones are sure" in out
    assert re.search(r"^MC_PITCHRATE_P +0\.09 +0\.\d+$", out, re.MULTILINE)
    assert "MC_ROLL" not in out
    assert max(map(len, out.splitlines())) < 80


def test_speeds_that_the_imu_contradicts_carry_no_gains(files, capsys):
    (shaken,) = of_turning(1.17)
    replace(result("speed"), objections=(shaken,)).write(files / "shaken.json")
    assert run(["tune", "command.json", "now.params", "--with", "shaken.json", *FEW]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "leave it: the IMU is shaken at 1.17 times the rotor speeds read; count" in out
    assert "proposed" not in out
    indi = ("--to", "indi", "-o", "g.txt")
    assert run(["tune", "command.json", "--with", "shaken.json", *indi]) == 1
    assert "g.txt is not written, leave it: the IMU is shaken" in capsys.readouterr().err


@pytest.mark.slow
def test_a_file_for_qgroundcontrol_and_one_for_mission_planner(files, capsys):
    assert run(["tune", "command.json", "--to", "px4-params", "-o", "g.params", *FEW]) == 0
    values = read_parameter_file(files / "g.params")
    assert values["MC_ROLLRATE_K"] == 1.0
    assert 0.01 < values["MC_ROLLRATE_P"] < 1.0
    assert len(values) == 18
    args = ["tune", "command.json", "--to", "ardupilot-param", "-o", "g.param", *FEW]
    assert run(args) == 0
    values = read_parameter_file(files / "g.param")
    assert {"ATC_RAT_RLL_P", "ATC_ANG_YAW_P", "ATC_RAT_PIT_D"} <= values.keys()
    assert "rotor inertia is not identified" in capsys.readouterr().out
    assert run(args) == 2
    assert "g.param exists; --force overwrites it" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gain"), [("betaflight", "{}_{}"), ("inav", "mc_{}_{}")])
def test_lines_for_a_cli(name, gain, files, capsys):
    own = ["--autopilot", name, "--to", f"{name}-cli", "-o", "g.txt"]
    assert run(["tune", "command.json", *own, *FEW]) == 0
    settings = read_parameter_file(files / "g.txt")
    assert {gain.format(x, axis) for x in "pid" for axis in ("roll", "pitch")} <= settings.keys()
    assert all(value.is_integer() for value in settings.values())
    assert settings[gain.format("d", "yaw")] == 0.0
    assert (files / "g.txt").read_text().endswith("\nsave\n")
    out = capsys.readouterr().out
    assert f"{name}, rate loop {8000 if name == 'betaflight' else 2000} Hz" in out
    assert "rotor_inertia" not in out or "rotor inertia is not identified" in out


@pytest.mark.slow
def test_adrc_has_the_slope_of_the_acceleration_and_bandwidths_that_keep_the_margins(files, capsys):
    assert run(["tune", "command.json", "--to", "betaflight-adrc", "-o", "a.txt", *FEW]) == 0
    found = read_parameter_file(files / "a.txt")
    # A quad X: a PID sum of 1000 on roll is a command of one on each rotor, up or down.
    u, rotors = found["adrc_hover_throttle"] / 100.0, load_airframe("paper").rotors
    torque = sum(abs(r.y) for r in rotors) * 10.0 * (0.7 + 0.6 * u)
    slope = np.degrees(torque / COMMON["Ixx"]) / 1000.0 / 0.03
    assert found["adrc_b0_roll"] == pytest.approx(slope, rel=0.05)
    assert 10.0 < found["adrc_wc_roll"] < found["adrc_wo_roll"]
    assert "keep at least" in capsys.readouterr().out


def test_a_flight_that_parts_from_the_model_gets_no_gains(files, shared_log, capsys):
    log = str(shared_log("px4-sih-default.ulg"))  # of another vehicle
    write = ("--json", "tune.json", "--bode", "loops.svg", "-o", "new.params", "--to", "px4-params")
    tried = ("--what-if", "gains=now.params", "--what-if", "thrust=0.8", "--what-if", "payload=10g")
    assert run(["tune", "command.json", log, *write, *tried, *FEW]) == 1
    out, err = capsys.readouterr()
    assert "what if: MC_ROLLRATE_P = 0.09, MC_ROLLRATE_D = 0.002, MC_ROLL_P = 6.5" in out
    assert "more, 0.01 kg besides, 80 % of the thrust, along" in " ".join(out.split())
    assert "leave it: the measured response departs from the model's on roll" in out
    assert "nothing is claimed: the flight contradicts the model" in out
    assert "flown" in out
    assert "new.params is not written" in err
    assert not (files / "new.params").exists()
    document = json.loads((files / "tune.json").read_text())
    assert document["objections"][0]["by"] == "frequency response"
    roll = document["response"]["roll"]["torque"]
    assert roll["instrument"].startswith("rate set-points")
    assert len(roll["omega_rad_s"]) == len(roll["magnitude_low"]) == len(roll["model_phase_high"])
    assert "circle" in (files / "loops.svg").read_text()
    indi = ("--with", "speed.json", "--to", "indi", "-o", "g.txt")
    assert run(["tune", "command.json", log, *indi, *FEW]) == 1
    assert "g.txt is not written, leave it: the measured" in capsys.readouterr().err
    assert not (files / "g.txt").exists()


@pytest.mark.thorough
def test_a_recorded_flight_is_reproduced_and_flown_with_a_payload(files, shared_log, capsys):
    truth = {
        "Ixx": 0.025, "Iyy": 0.025, "Izz": 0.03, "T_max": 5.0, "moment_ratio": 0.02,
        "rotational_damping": 0.025, "rotor_inertia": 1e-12, "k_T": 1e-5,
    }  # fmt: skip
    exact = estimates(truth, 0.01) | {"mass": Estimate(1.0, 0.01, "kg", "given")}
    sih = replace(result("command"), parameters=exact)
    replace(sih, airframe=load_airframe("px4-sih").as_json()).write(files / "sih.json")
    log = str(shared_log("px4-sih-default.ulg"))
    write = ["--to", "frequency-response", "-o", "response.csv", "--json", "t.json"]
    lag = ("--delay", "0.003+-0.001", "--set", "motor_lag=0.05+-0.001", "--bode", "b.svg")
    change = ("--what-if", "payload=0.2@0.02,0,0.05", "--what-if", "thrust=0.8")
    assert run(["tune", "sih.json", log, *lag, *write, *change, *FEW]) == 0
    out = capsys.readouterr().out
    assert "what if: 0.2 kg besides, 80 % of the thrust, along the rate set-points" in out
    tried = json.loads((files / "t.json").read_text())["what_if"]
    assert tried["axes"].keys() == {"roll", "pitch", "yaw"}
    for axis in tried["axes"].values():
        error = {name: each["value"] for name, each in axis["error_rad_s"].items()}
        assert error["now"] == pytest.approx(error["flown"], rel=0.1)
        assert error["then"] > 1.03 * error["flown"]
        assert len(axis["shown_rad_s"]["then_low"]) == len(tried["shown_s"])
    share = tried["rotor_limit_share"]
    assert share["flown"]["value"] < share["then"]["value"] < 0.2
    assert "what if: 0.2 kg" in (files / "b.svg").read_text()
    head, *rows = (files / "response.csv").read_text().splitlines()
    assert head.startswith("axis,omega_rad_s,magnitude")
    assert {row.split(",")[0] for row in rows} == {"roll", "pitch", "yaw"}


def test_indi_matrices(files, capsys):
    speeds = ("--with", "speed.json")
    assert run(["tune", "command.json", *speeds, "--to", "indi", "-o", "g.txt"]) == 0
    said = capsys.readouterr().err
    assert re.search(r"the effect is surely roll 0\.7\d to 1\.0\d, pitch .*to 80 % of", said)
    assert "set indi_act_g1_roll = " in (files / "g.txt").read_text()
    assert run(["tune", "command.json", *speeds, "--to", "paparazzi", "-o", "g.xml"]) == 0
    assert "STABILIZATION_INDI_" in (files / "g.xml").read_text()
    assert "INDI has no place for" in capsys.readouterr().err
    assert run(["tune", "command.json", "--to", "indi", "-o", "none.txt"]) == 1
    assert "no INDI without the rotors' inertia" in capsys.readouterr().err


def test_what_a_result_does_not_carry_is_said_with_the_flight_that_helps(files, refused):
    error = refused(["tune", "speed.json"], 1)
    assert error.startswith("gcs-sysid: speed.json: no gains from this result: T_max, motor_lag")
    assert "analyze a flight with commands" in error
    result("command", weak=("Ixx",)).write(files / "weak.json")
    assert "Ixx (weak)" in refused(["tune", "weak.json"], 1)
    reasons = ("the motion does not match these rotors; check motor order", "weak: Ixx")
    bad = replace(result("command"), verdict="refused", reasons=reasons)
    bad.write(files / "no.json")
    assert refused(["tune", "no.json"], 1).endswith(f"is refused: {reasons[0]}\n")
    given = ["--set", "motor_lag=0.03+-0.003", "--set", "rotor_speed_max=220"]
    result("speed", weak=("k_T",)).write(files / "unit.json")  # full thrust is by k_T
    assert "k_T (weak) not identified" in refused(["tune", "unit.json", *given], 1)
    assert run(["tune", "speed.json", *given, *FEW]) == 0


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["command.json", "none.params"], "none.params"),
        (["command.json", "--to", "px4-params"], "--to and -o go together"),
        (["command.json", "--to", "px4-params", "-o", "g.txt"], "NAME.params"),
        (["command.json", "--to", "px4-params", "-o", "g.params", "--autopilot", "ardupilot"],
         "not for --autopilot"),
        (["command.json", "now.params", "--autopilot", "ardupilot"], "holds no ATC_"),
        (["command.json", "--set", "motor_lag=x"], "must be a number"),
        (["command.json", "--delay", "7"], "0 to 0.2 s"),
        (["command.json", "now.params", "--what-if", "thrust=0.8"], "give the LOG"),
        (["command.json", "--what-if", "payload=1@2"], "payload=KG[@X,Y,Z]"),
        (["command.json", "--what-if", "payload=0"], "must be positive"),
        (["command.json", "--to", "indi", "-o", "-", "--what-if", "thrust=0.8"], "apply to gains"),
        (["speed.json", "--with", "other.json"], "Ixx = 0.0165 and 0.033"),
    ],
)  # fmt: skip
def test_wrong_usage_is_one_line_and_status_2(files, refused, args, says):
    result("command", Ixx=0.033, Izz=0.04).write(files / "other.json")
    assert says in refused(["tune", *args])


@pytest.mark.parametrize(
    "line", ["MC_ROLLRATE_P", "1\t1\tMC_ROLLRATE_P\tx\t9", "MC_ROLLRATE_P,nan", "§§ 1"]
)
def test_a_damaged_parameter_file_is_refused_with_its_line(files, capsys, line):
    (files / "bad.param").write_text(f"# comment\n{line}\n")
    assert run(["tune", "command.json", "bad.param"]) == 2
    assert "bad.param: line 2" in capsys.readouterr().err


def test_an_ensemble_is_a_file_each(files, capsys):
    args = ["export", "speed.json", "--to", "urdf", "-o", "quad.urdf", "--ensemble", "4"]
    assert run(args) == 0
    found = sorted(path.name for path in files.glob("*.urdf"))
    assert found == [f"quad-{i:03}.urdf" for i in range(1, 5)]
    masses = {re.search(r'ixx="([^"]*)"', (files / name).read_text())[1] for name in found}
    assert len(masses) == 4
    assert run(args) == 2
    assert "quad-001.urdf exists" in capsys.readouterr().err
    assert run([*args[:4], "-o", "-", "--ensemble", "2"]) == 2
