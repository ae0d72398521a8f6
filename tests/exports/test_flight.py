"""From a recorded flight to MuJoCo: the whole way, against what is true of the vehicle."""

import json

import numpy as np
import pytest

from gcs_sysid.cli.program import run

from .known import TURN

mujoco = pytest.importorskip("mujoco")


@pytest.mark.slow
def test_an_emulated_flight_becomes_its_vehicle_in_mujoco(paper_flight, tmp_path, capsys):
    result, model = tmp_path / "result.json", tmp_path / "quad.xml"
    log = str(paper_flight.tlog)
    assert run(["analyze", log, "--airframe", "paper", "--json", str(result)]) == 0
    told = json.loads(result.read_text())
    assert [rotor["spin"] for rotor in told["airframe"]["rotors"]] == ["ccw", "ccw", "cw", "cw"]
    assert run(["export", str(result), "--to", "mjcf", "-o", str(model)]) == 0
    capsys.readouterr()
    assert f"recorded {told['telemetry']['recorded']}" in model.read_text()
    body = mujoco.MjModel.from_xml_path(str(model)).body("base")
    truth = paper_flight.truth
    assert body.mass[0] == truth["mass"]
    assert TURN @ body.ipos == pytest.approx([truth["cg_x"], truth["cg_y"], 0.0], abs=1e-4)
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, body.iquat)
    axes = axes.reshape(3, 3)
    J = TURN @ axes @ np.diag(body.inertia) @ axes.T @ TURN
    for name, at in {"Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2), "Ixz": (0, 2)}.items():
        assert J[at] == pytest.approx(truth[name], rel=0.04), name
