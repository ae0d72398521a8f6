"""A flight of a vehicle that was neither weighed nor measured: values per kg and per m."""

from dataclasses import replace
from pathlib import Path

import pytest

import gcs_sysid
from gcs_sysid.cli.program import run
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import assemble
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.results.comparison import compare
from gcs_sysid.results.result_file import read_result

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.tlog"
PAPER = load_airframe("paper")
UNWEIGHED = replace(PAPER, mass=None)
OF_ANY_SIZE = replace(UNWEIGHED, placeholder=PAPER.rotors)
FEW_SECONDS = {"start": 0.0, "end": 30.0}


@pytest.fixture(scope="module")
def weighed():
    return gcs_sysid.analyze(SAMPLE, PAPER, **FEW_SECONDS)


@pytest.fixture(scope="module")
def relative():
    return gcs_sysid.analyze(SAMPLE, OF_ANY_SIZE, **FEW_SECONDS)


@pytest.mark.slow
def test_values_times_mass_and_arm_are_those_of_the_vehicle(weighed, relative):
    assert relative.scale is None
    assert relative.verdict == weighed.verdict
    assert relative.assumptions == weighed.assumptions == ()
    for name in ("Ixx", "Iyy", "Izz", "k_T", "k_M", "cg_x", "moment_ratio"):
        parameter, found, known = (
            REGISTRY[name], relative.parameters[name], weighed.parameters[name]
        )  # fmt: skip
        factor = PAPER.mass if parameter.scale != "none" else 1.0
        factor *= PAPER.arm if parameter.theta else 1.0
        assert abs(factor * found.value - known.value) < 0.1 * known.std, name
        assert found.status == known.status, name
        assert factor * found.std_data == pytest.approx(known.std_data, rel=0.05), name
    units = {name: relative.parameters[name].unit for name in ("Ixx", "k_T", "cg_x")}
    assert units == {"Ixx": "kg m^2/(kg m)", "k_T": "N s^2/kg", "cg_x": "m/m"}
    assert any("per kg of the mass and per m of the arm" in reason for reason in relative.reasons)


@pytest.mark.slow
def test_nothing_takes_them_for_a_vehicle(relative, weighed, tmp_path, capsys):
    replace(relative, assumptions=({"what": "arm"},)).write(tmp_path / "r.json")
    read = read_result(tmp_path / "r.json")
    assert read.assumptions == ({"what": "arm"},)
    assert read.parameters["Ixx"].unit == "kg m^2/(kg m)"
    with pytest.raises(InputError, match="give --mass KG and --arm M"):
        assemble(read)
    assert run(["twin", str(tmp_path / "r.json"), str(SAMPLE)]) == 2
    assert "give --mass KG and --arm M" in capsys.readouterr().err
    assert compare(read, weighed).verdict == "cannot_tell"
    again = compare(read, replace(relative, source="another"))
    assert again.differences["Ixx"].verdict == "no_change_seen"


def test_priors_in_proportion_to_the_mass_need_it():
    lengths = UNWEIGHED.with_prior("moment_ratio", 0.03, 0.01)
    assert lengths.in_own_units().own_units == ("mass",)
    with pytest.raises(InputError, match="a prior of k_M needs the mass"):
        UNWEIGHED.with_prior("k_M", 6e-6, 1e-7).in_own_units()
