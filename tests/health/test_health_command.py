"""`gcs-sysid health` as one runs it: text, JSON, parameter files, picture, and what is refused."""

import contextlib
import io
import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest

from gcs_sysid.cli.health_command import health_text
from gcs_sysid.cli.program import run
from gcs_sysid.health import assessment
from gcs_sysid.health.assessment import ReadLog
from gcs_sysid.health.health_file import read_baseline
from gcs_sysid.health.health_trend import trend_text
from gcs_sysid.health.vehicle_health import HealthOptions
from gcs_sysid.inspection.inspector import inspect_log
from gcs_sysid.model.airframe import load_airframe
from tests.health.conftest import HOVER

QUANTITY = {"value", "std", "ci95", "unit", "std_given", "std_data"}


@pytest.fixture(scope="module")
def files(flight, tmp_path_factory):
    """What the command writes and prints of the flight."""
    folder, out = tmp_path_factory.mktemp("health"), io.StringIO()
    words = ["--json", "h.json", "--picture", "h.svg"]
    words = [str(folder / word) if "." in word else word for word in words]
    with contextlib.redirect_stdout(out):
        assert run(["health", str(flight.tlog), "--airframe", "paper", *words]) == 0
    (folder / "out.txt").write_text(out.getvalue())
    return folder


@pytest.mark.slow
def test_text_json_and_picture(flight, files):
    out = (files / "out.txt").read_text()
    for word in ("CG along", "thrust share", "full thrust", "k_T", "assumed", "CA_ROTOR0_PX"):
        assert word in out
    # A path is as long as it is.
    lines = [line for line in out.splitlines() if not line.startswith("/")]
    assert max(map(len, lines)) < 80
    told = json.loads((files / "h.json").read_text())
    assert told["schema"] == "gcs-sysid-health/1"
    assert told["seconds_of_hover"] > 20.0
    for place in (*told["cg"].values(), told["yaw_imbalance"], told["hover_throttle"], told["k_T"]):
        assert set(place) == QUANTITY
        assert place["ci95"][0] <= place["value"] <= place["ci95"][1]
    assert len(told["rotors"]) == 4
    assert sum(rotor["thrust_share"]["value"] for rotor in told["rotors"]) == pytest.approx(1.0)
    truth = flight.truth
    for axis in "xy":
        low, high = told["cg"][axis]["ci95"]
        assert low < truth[f"cg_{axis}"] < high
        # The emulator's rotors are alike: without what is assumed of them a millimeter is enough.
        assert told["cg"][axis]["value"] == pytest.approx(truth[f"cg_{axis}"], abs=1e-3)
    assert told["k_T"]["value"] == pytest.approx(truth["k_T"], rel=0.01)
    root = ET.fromstring((files / "h.svg").read_text())
    assert root.tag.endswith("svg")
    words = " ".join(root.itertext())
    assert "center of gravity" in words
    assert f"{100.0 * told['rotors'][2]['thrust_share']['value']:.1f} %" in words


@pytest.mark.slow
def test_the_second_flight_is_held_against_the_first(fly, flight, files, capsys):
    weak = fly(*HOVER[:-1], "4", "--physics", "weakening=2:0:0.06:0.1")
    options = ["--airframe", "paper", "--baseline", str(files / "h.json")]
    assert run(["health", str(weak.tlog), *options]) == 0
    assert "rotor 2 gives" in capsys.readouterr().out
    assert run(["health", str(flight.tlog), str(weak.tlog), "--airframe", "paper"]) == 0
    text = capsys.readouterr().out
    assert "Over the flights" in text
    assert "rotor 2 gives" in text.partition("Over the flights")[2]


@pytest.mark.slow
def test_flights_of_two_vehicles_are_not_held_against_each_other(flight, files, tmp_path, capsys):
    written = tmp_path / "one.json"
    told = json.loads((files / "h.json").read_text())
    told["load"]["value"] = [3.0 * value for value in told["load"]["value"]]
    written.write_text(json.dumps(told))
    words = ["--airframe", "paper", "--baseline", str(written)]
    assert run(["health", str(flight.tlog), *words]) == 2
    assert "rotors do 3.0 times more for the same thrust" in capsys.readouterr().err
    # One that nobody named is left out, and so is the flight from the trend.
    own = replace(read_baseline(written), asked=False)
    health = ReadLog(flight.tlog).health(HealthOptions(load_airframe("paper"), baseline=own))
    assert health.available
    assert health.condition is None
    assert "another vehicle's" in health.apart
    assert "not compared with" in health_text(health)
    assert trend_text([health, replace(health, apart="")]) == []


@pytest.mark.slow
def test_slow_rotors_get_health_from_analyze_and_inspect(fly, tmp_path, capsys):
    slow = fly(*HOVER[:4], "--rate", "10", "--seed", "5")
    out = tmp_path / "r.json"
    assert run(["analyze", str(slow.tlog), "--airframe", "paper", "--json", str(out)]) == 1
    text = capsys.readouterr()
    assert "cannot identify from this" in text.err
    assert "From hover only:" in text.out
    result = json.loads(out.read_text())
    assert result["verdict"] == "refused"
    assert result["health"]["cg"]["x"]["value"] == pytest.approx(slow.truth["cg_x"], abs=2e-3)
    found = inspect_log(slow.tlog)
    assert (found.verdict, found.obtainable) == ("no", "health")
    assert found.hover > 20.0
    # Without an airframe PX4's own parameters or the vehicle's type tell it.
    assert ReadLog(slow.tlog).health(HealthOptions(arm=0.25)).available


@pytest.mark.slow
def test_a_wrong_motor_order_tells_no_cg_anywhere(fly, tmp_path, capsys):
    turned = fly(*HOVER[:6], "--airframe", "ardupilot-quad-x", "--seed", "5", "--duration", "22")
    out, report = tmp_path / "r.json", tmp_path / "r.html"
    rotors = load_airframe("ardupilot-quad-x").rotors
    tables = "".join(
        f"[[rotor]]\nx = {r.x}\ny = {r.y}\nspin = {'ccw' if r.spin > 0 else 'cw'!r}\n"
        for r in (rotors[2], rotors[1], rotors[0], rotors[3])
    )
    file = tmp_path / "swapped.toml"
    file.write_text(f"name = 'swapped'\n{tables}")
    wrong = [str(turned.tlog), "--airframe", str(file), "--mass", "1.5"]
    assert run(["analyze", *wrong, "--json", str(out), "--report", str(report)]) == 1
    text = capsys.readouterr()
    says = "as flown, motor 1 is front right, 2 rear left, 3 front left, 4 rear right"
    assert says in text.err
    assert "From hover only" not in text.out
    health = json.loads(out.read_text())["health"]
    assert (health["verdict"], health["cg"], health["autopilot_parameters"]) == (
        "refused",
        None,
        {},
    )
    assert says in health["reasons"][0]
    assert says in report.read_text("utf-8")
    assert run(["health", *wrong]) == 1
    assert says in " ".join(capsys.readouterr().out.split())
    assert run(["health", str(turned.tlog), "--airframe", "ardupilot-quad-x"]) == 0


@pytest.mark.slow
def test_a_span_of_the_log_is_kept_to(flight, files):
    part = ReadLog(flight.tlog).health(HealthOptions(load_airframe("paper")), (10.0, 25.0))
    assert part.seconds < 16.0 < json.loads((files / "h.json").read_text())["seconds_of_hover"]


@pytest.mark.slow
def test_of_a_log_of_many_hours_the_beginning_is_judged_and_said(flight, monkeypatch):
    airframe = load_airframe("paper")
    monkeypatch.setattr(assessment, "TUNING", replace(assessment.TUNING, most_samples=500))
    part = ReadLog(flight.tlog).health(HealthOptions(airframe))
    assert 10.0 < part.seconds < 20.0  # 500 samples at 25 Hz
    assert part.assumptions[-1] == "hover of the log's first 500 IMU samples"


def one_line(capsys):
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("gcs-sysid: error: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["missing.tlog"], "missing.tlog"),
        (["a.tlog", "--params", "p.csv"], ".params"),
        (["a.tlog", "--k-t", "1e-5"], "--airframe"),
        (["a.tlog", "--mass", "1", "--battery-mass", "2"], "--battery-mass"),
        (["a.tlog", "--baseline", "none.json"], "none.json"),
        (["a.tlog", "--baseline", "list.json"], "health LOG --json"),
        (["a.tlog", "--picture", "nowhere/p.svg"], "nowhere"),
    ],
)
def test_wrong_usage_is_one_line(tmp_path, monkeypatch, capsys, options, word):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.tlog").write_bytes(b"")
    (tmp_path / "list.json").write_text("[1]")
    assert run(["health", *options]) == 2
    assert word in one_line(capsys)


@pytest.mark.slow
def test_the_real_quad_with_slow_logging(shared_logs):
    log = shared_logs / "real" / "quiver_00000087.bin"
    health = ReadLog(log).health(HealthOptions(arm=0.75, mass=18.0))
    assert [r.thrust_share.value for r in health.rotors] == pytest.approx(
        [0.219, 0.232, 0.255, 0.294], abs=0.005
    )
    assert health.yaw_imbalance.value == pytest.approx(-0.098, abs=0.01)
    assert health.scale[1].value == pytest.approx(2.41e-4, rel=0.02)
    # A breeze moved the center of thrust; its part is not the airframe's.
    assert -0.035 < health.center.at_force[0] < -0.02
    assert health.center.at_force[0] < health.cg[0].value < 0.0


@pytest.mark.slow
def test_every_flight_of_the_real_quads_has_an_answer(shared_logs):
    airframe = load_airframe(str(shared_logs / "real" / "cinerat.toml"))
    places = [
        ReadLog(shared_logs / "real" / f"LOG00{n}.BFL").health(HealthOptions(airframe)).cg
        for n in (259, 264, 277)
    ]
    for axis in (0, 1):
        values = [place[axis].value for place in places]
        assert max(values) - min(values) < 3e-3
