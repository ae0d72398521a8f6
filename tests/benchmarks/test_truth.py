"""The truth benchmark: what it draws, how it judges, and a short form of it."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

# The benchmarks are no part of the installed package.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.truth import page
from gcs_sysid.model.parameters import GRAVITY
from sim_bridge.simulated_vehicle import hover_thrusts
from testbed import independent, recordings
from testbed.judge import against, judge
from testbed.vehicles import HEAVIEST, LAYOUTS, LIGHTEST, draw


def cells(text: str) -> dict[str, dict[str, str]]:
    """Rows of a table of Markdown, by the first column."""
    head, _, *rows = (
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    )
    return {row[0]: dict(zip(head, row, strict=True)) for row in rows}


@pytest.mark.parametrize("number", range(24))
def test_drawn_vehicles_can_be_built_and_flown(number: int) -> None:
    drawn = draw(number)
    v = drawn.vehicle
    assert LIGHTEST <= v.mass <= HEAVIEST
    a, b, c = np.linalg.eigvalsh(
        [[v.Ixx, v.Ixy, v.Ixz], [v.Ixy, v.Iyy, v.Iyz], [v.Ixz, v.Iyz, v.Izz]]
    )
    assert a > 0.0
    assert a + b > c
    assert sum(r.spin for r in v.rotors) == 0
    assert 0.2 * v.T_max < min(hover_thrusts(v)) < max(hover_thrusts(v)) < 0.6 * v.T_max
    assert sum(hover_thrusts(v)) == pytest.approx(v.mass * GRAVITY)
    assert np.mean([math.hypot(r.x, r.y) for r in v.rotors]) == pytest.approx(drawn.arm)


def test_all_layouts_and_sizes_are_drawn() -> None:
    drawn = [draw(number) for number in range(60)]
    assert {d.layout for d in drawn} == set(LAYOUTS)
    masses = [d.vehicle.mass for d in drawn]
    assert min(masses) < 0.5
    assert max(masses) > 8.0
    # Another scenario's vehicle of the same number is the same one.
    assert draw(7) == draw(7)


def test_an_interval_is_held_against_the_nearest_true_value() -> None:
    assert against(1.1, 0.05, 1.0) == {
        "error": pytest.approx(0.1),
        "z": pytest.approx(2.0),
        "holds": False,
    }
    assert against(1.1, 0.06, 1.0)["holds"]
    assert against(1.1, 0.01, [1.0, 1.2]) == {"error": 0.0, "z": 0.0, "holds": True}
    assert against(1.3, 0.01, [1.0, 1.2])["z"] == pytest.approx(10.0)


def test_a_table_counts_what_holds() -> None:
    good = {"status": "identified", "error": 0.01, "z": 1.0, "holds": True}
    bad = {"status": "identified", "error": -0.2, "z": -8.0, "holds": False}
    weak = {"status": "weak", "error": 0.5, "z": 0.5, "holds": True}
    outcomes = [
        {
            "verdict": "identified",
            "vehicle": "one",
            "parameters": {"Ixx": good, "Izz": bad, "k_T": weak},
            "events": [{"t": 1.0, "kind": "change"}],
            "r_squared": 0.9,
            "whiteness": 4.0,
        },
        {"verdict": "error", "vehicle": "two", "error": "KeyError: 'k_T' (before)"},
    ]
    (row,) = cells("\n".join(page.lines({"a": {"outcomes": outcomes}}))).values()
    assert row["verdicts"] == "1i 1e"
    assert row["`identified` that hold"] == "50 % of 2"
    assert row["all that hold"] == "67 % of 3"
    assert row["moments claimed"] == "33 % of 6"
    assert (row["largest z of any claim"], row["false changes"]) == ("8", "1")
    text = page.page({"a": {"says": "the model", "outcomes": outcomes}})
    assert "{{" not in text
    assert "| a | one | Izz | -20 % | 8 | identified | 0.9 | 4 |" in text
    assert "KeyError: 'k_T'" in text


def test_a_refusal_is_an_outcome(tmp_path: Path) -> None:
    empty = tmp_path / "empty.tlog"
    empty.write_bytes(b"")
    out = judge(empty, draw(0).airframe, {})
    assert out["verdict"] == "refused"
    assert str(tmp_path) not in json.dumps(out)


def test_truths_are_read_in_every_spelling(tmp_path: Path) -> None:
    path = tmp_path / "x.truth.json"
    path.write_text(json.dumps({
        "autopilot": "PX4", "mass": 1.0, "ixx": 0.02, "cg_m": [0.01, -0.02, 0.0], "t_max": 5.0,
        "q_max": 0.1, "kdw": 0.02, "k_T": [1.0, 1.2], "events": [{"mass_after": 1.4}],
    }))  # fmt: skip
    truth = recordings.truth_of(tmp_path / "x.tlog")
    changes = recordings.is_changed_in_flight(tmp_path / "x.tlog")
    assert changes
    assert truth["Ixx"] == 0.02
    assert (truth["cg_y"], truth["moment_ratio"]) == (-0.02, pytest.approx(0.02))
    assert (truth["k_T"], truth["rotational_damping"]) == ([1.0, 1.2], 0.02)
    assert "autopilot" not in truth


@pytest.mark.parametrize("name", ["rotorpy", "mujoco"])
def test_other_physics_moves_as_ours_in_the_first_moments(name: str) -> None:
    """Within 40 ms there is hardly any speed for the air to act on: both start off alike."""
    pytest.importorskip(name)
    from sim_bridge.dynamics import Dynamics, State
    from sim_bridge.simulation import trim

    vehicle = independent.plain(draw(1).vehicle)
    plant = independent.PLANTS[name][1](vehicle, trim(vehicle))
    ours, state = Dynamics(vehicle), trim(vehicle)
    targets = [s * f for s, f in zip(state.speeds, (1.1, 0.9, 1.02, 1.0), strict=True)]
    for _ in range(20):
        plant.advance(targets, 0.002)
    for _ in range(40):
        state = ours.step(state, targets)
    theirs: State = plant.state
    assert max(map(abs, state.rates)) > 0.05
    np.testing.assert_allclose(theirs.speeds, state.speeds, rtol=1e-6)
    np.testing.assert_allclose(theirs.rates, state.rates, rtol=0.05, atol=1e-3)
    np.testing.assert_allclose(theirs.quaternion, state.quaternion, atol=1e-4)
    np.testing.assert_allclose(theirs.velocity, state.velocity, rtol=0.05, atol=1e-4)
    _, force = ours.imu(state, targets)
    np.testing.assert_allclose(plant.force(), force, rtol=0.01, atol=0.01)
