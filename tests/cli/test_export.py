"""`gcs-sysid export` and `compare`: what they print, write and return."""

import json
from dataclasses import replace

import pytest

from gcs_sysid.cli.program import run
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.parameters import PARAMETERS
from tests.known_results import MASS, estimates, result_of

ERROR = "gcs-sysid: error: "
VALUES = {
    "Ixx": 0.0165, "Iyy": 0.017, "Izz": 0.029, "Ixy": 1e-4, "Iyz": 1e-4, "Ixz": -1e-4,
    "cg_x": 0.01, "cg_y": -0.02, "k_T": 2e-4, "k_M": 6e-6, "moment_ratio": 0.03,
}  # fmt: skip


def result(source="a.tlog", airframe="paper", **changes):
    return result_of(
        MASS | estimates(VALUES | changes, share=1e-3),
        source=source,
        airframe=load_airframe(airframe).as_json(),
    )


@pytest.fixture(autouse=True)
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result().write(tmp_path / "a.json")
    result("b.tlog").write(tmp_path / "same.json")
    result("b.tlog", cg_x=0.02).write(tmp_path / "moved.json")
    result("b.tlog", airframe="px4-hexa-x").write(tmp_path / "hexa.json")
    nothing = estimates(dict.fromkeys(PARAMETERS))
    refused = replace(
        result("c.tlog"), verdict="refused", reasons=("too short",), parameters=nothing
    )
    refused.write(tmp_path / "refused.json")
    return tmp_path


def test_a_file_is_written_and_nothing_is_printed(files, capsys):
    assert run(["export", "a.json", "--to", "urdf", "-o", "quad.urdf"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert all(line.startswith("gcs-sysid: note: ") for line in err.splitlines())
    assert "<robot" in (files / "quad.urdf").read_text()


def test_standard_output(capsys):
    assert run(["export", "a.json", "--to", "mjcf", "-o", "-", "--name", "mine"]) == 0
    out, _ = capsys.readouterr()
    assert out.startswith("<!--")
    assert '<mujoco model="mine">' in out


def test_what_the_data_do_not_tell_is_status_1(files, refused, capsys):
    error = refused(["export", "a.json", "--to", "px4-sih", "-o", "quad.params"], 1)
    assert error.startswith("gcs-sysid: a.json: px4-sih needs T_max")
    assert not (files / "quad.params").exists()
    more = ["--set", "rotor_speed_max=200"]
    assert run(["export", "a.json", "--to", "px4-sih", "-o", "quad.params", *more]) == 0
    assert "SIH_T_MAX\t8\t" in (files / "quad.params").read_text()
    capsys.readouterr()
    assert "mass, Ixx" in refused(["export", "refused.json", "--to", "urdf", "-o", "x.urdf"], 1)


def test_a_prior_of_the_airframe_fills_a_gap(files, capsys):
    table = json.loads((files / "a.json").read_text())
    table["parameters"]["Ixy"] |= {"status": "unobservable"}
    (files / "gap.json").write_text(json.dumps(table))
    assert run(["export", "gap.json", "--to", "urdf", "-o", "x.urdf"]) == 1
    assert "--set Ixy=VALUE" in capsys.readouterr().err
    rotors = "".join(
        f'[[rotor]]\nx = {r["x"]}\ny = {r["y"]}\nspin = "{r["spin"]}"\n'
        for r in table["airframe"]["rotors"]
    )
    (files / "mine.toml").write_text(f'name = "mine"\n{rotors}\n[prior]\nIxy = [0.002, 1e-4]\n')
    more = ["--airframe", "mine.toml"]
    assert run(["export", "gap.json", "--to", "urdf", "-o", "x.urdf", *more]) == 0
    text = (files / "x.urdf").read_text()
    assert 'ixy="-0.002"' in text
    assert "(airframe mine)" in text


CASES = {
    "no target": (["export", "a.json", "-o", "x"], "--to"),
    "no file": (["export", "a.json", "--to", "urdf"], "--output"),
    "unknown target": (["export", "a.json", "--to", "stl", "-o", "x"], "'stl'"),
    "missing result": (["export", "no.json", "--to", "urdf", "-o", "x"], "no.json"),
    "unknown name": (["export", "a.json", "--to", "urdf", "-o", "x", "--set", "Q=1"], "'Q'"),
    "no value": (["export", "a.json", "--to", "urdf", "-o", "x", "--set", "mass"], "NAME=VALUE"),
    "not a number": (["export", "a.json", "--to", "urdf", "-o", "x", "--set", "mass=?"], "'?'"),
    "arm alone": (["export", "a.json", "--to", "urdf", "-o", "x", "--arm", "1"], "--airframe"),
    "other airframe": (
        ["export", "a.json", "--to", "urdf", "-o", "x", "--airframe", "px4-hexa-x"],
        "6",
    ),
    "no folder": (["export", "a.json", "--to", "urdf", "-o", "no/x"], "no/x"),
    "six for rotorpy": (["export", "hexa.json", "--to", "rotorpy", "-o", "x"], "rotorpy flies 4"),
    "one to compare": (["compare", "a.json"], "B.json"),
    "missing to compare": (["compare", "a.json", "no.json"], "no.json"),
    "other rotors": (["compare", "a.json", "hexa.json"], "4 rotors"),
    "compare to nowhere": (["compare", "a.json", "same.json", "--json", "no/x"], "no/x"),
}


@pytest.mark.parametrize(("argv", "names"), CASES.values(), ids=CASES.keys())
def test_wrong_usage_gives_one_line(argv, names, refused):
    error = refused(argv)
    assert error.startswith(ERROR)
    assert names in error


def test_the_same_vehicle(capsys):
    assert run(["compare", "a.json", "same.json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "\nNo change seen in Ixx, Iyy" in out
    assert "Undetermined: mass (given in both)." in out
    assert "scale of both: mass = 1.5 kg" in out
    assert max(map(len, out.splitlines())) < 80


def test_a_changed_vehicle(capsys):
    assert run(["compare", "a.json", "moved.json"]) == 0
    out, _ = capsys.readouterr()
    assert "\nThe vehicle has changed: cg_x.\n" in out
    row = next(line for line in out.splitlines() if line.startswith("cg_x"))
    numbers = ["0.010000", "0.020000", "0.0100", "4.4e-05", "+100"]
    assert row.split() == ["cg_x", *numbers, "m", "≠"]


def test_nothing_to_compare_is_status_1(capsys):
    assert run(["compare", "a.json", "refused.json"]) == 1
    out, err = capsys.readouterr()
    assert "Undetermined: no parameter is identified in both results." in out
    assert err == "gcs-sysid: cannot compare: no parameter is identified in both\n"


def test_comparison_as_json(files, capsys):
    assert run(["compare", "a.json", "moved.json", "--json", "-"]) == 0
    table = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert table["schema"] == "gcs-sysid/compare/1"
    assert table["verdict"] == "changed"
    assert table["before"]["source"] == "a.tlog"
    assert table["parameters"]["cg_x"]["verdict"] == "changed"
    assert table["parameters"]["cg_x"]["difference"] == pytest.approx(0.01)
    assert table["parameters"]["Ixx"]["verdict"] == "no_change_seen"
    assert table["parameters"]["mass"]["verdict"] == "cannot_tell"
    assert run(["compare", "a.json", "moved.json", "--json", "c.json"]) == 0
    assert "The vehicle has changed" in capsys.readouterr().out
    assert json.loads((files / "c.json").read_text()) == table
