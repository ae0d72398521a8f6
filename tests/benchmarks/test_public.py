"""The public benchmark: what it gives out, how it scores, and that each entry can do its work."""

import re

import numpy as np
import pytest

from benchmarks.public import entries, score
from benchmarks.public.flight import Flight, Stretch, flight_of
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.airframe import Airframe, Rotor
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.records import Samples
from gcs_sysid.signals.rotor_units import RotorSource
from gcs_sysid.signals.sampling import SampleBlock

TRUTH = {
    "Ixx": 0.012, "Iyy": 0.014, "Izz": 0.022, "Ixy": 0.0, "Iyz": 0.0, "Ixz": 0.0,
    "k_T": 2e-5, "k_M": 3e-7, "cg_x": 0.004, "cg_y": -0.003,
}  # fmt: skip
MASS, DT, ARM = 1.0, 0.004, 0.25


@pytest.fixture(scope="module")
def flight():
    """Euler's equations by hand: 10 s of sines on all axes, gyro noise of 2 mrad/s."""
    n, hover = 2500, np.sqrt(MASS * 9.80665 / 4 / TRUTH["k_T"])
    t = DT * np.arange(n)
    x, y = ARM * np.array([0.7, -0.7, 0.7, -0.7]), ARM * np.array([0.7, -0.7, -0.7, 0.7])
    spin = np.array([1.0, 1.0, -1.0, -1.0])
    pulls = [0.03 * np.sin(2 * np.pi * f * t) for f in (1.3, 1.7, 0.5)]
    mixes = np.stack([-np.sign(y), np.sign(x), 3.0 * spin])
    # The last is a trim against the CG's offset.
    trim = -TRUTH["cg_y"] / np.mean(np.abs(y)) * mixes[0] + TRUTH["cg_x"] / np.mean(x**2) * x
    speeds = hover * np.sqrt(1.0 + np.stack(pulls, axis=1) @ mixes + trim)
    signals, _ = rb.rotor_signals(np.stack([x, y, spin]), speeds)
    J = np.array([TRUTH[name] for name in ("Ixx", "Iyy", "Izz")])
    rates = np.zeros((n, 3))
    for k in range(n - 1):
        roll, pitch, thrust, yaw = 0.5 * (signals[k] + signals[k + 1])
        M = np.array(
            [
                TRUTH["k_T"] * (roll + TRUTH["cg_y"] * thrust),
                TRUTH["k_T"] * (pitch - TRUTH["cg_x"] * thrust),
                TRUTH["k_M"] * yaw,
            ]
        )
        w = rates[k]
        middle = w + 0.5 * DT * (M - np.cross(w, J * w)) / J
        rates[k + 1] = w + DT * (M - np.cross(middle, J * middle)) / J
    random = np.random.default_rng(1)
    force = np.zeros((n, 3))
    force[:, 2] = -TRUTH["k_T"] * signals[:, 2] / MASS
    stretch = Stretch(t, rates + 0.002 * random.standard_normal(rates.shape), force, speeds)
    return Flight(DT, (stretch,), False, x, y, spin, MASS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("entry", "package", "bars"),
    [
        (entries.least_squares, None, {"Ixx": 0.02, "Iyy": 0.02}),
        (entries.augmented_ekf, "filterpy", {"Ixx": 0.03, "Iyy": 0.03, "k_T": 0.01, "cg_x": 0.01}),
        (entries.mujoco_sysid, "mujoco.sysid", {"Ixx": 0.01, "Iyy": 0.01, "cg_y": 0.01}),
    ],
)
def test_an_entry_finds_what_euler_was_given(flight, entry, package, bars):
    if package:
        pytest.importorskip(package)
    if entry is entries.mujoco_sysid:
        from mujoco import sysid

        if not hasattr(sysid, "optimize"):
            pytest.skip("mujoco.sysid without its own dependencies")
    judged = score.judge(entry(flight), TRUTH, ARM)
    for name, bar in bars.items():
        assert judged[name]["error"] < bar, name


def test_errors_are_shares_of_what_matters():
    truth = {"Ixx": 2.0, "Iyy": 4.0, "Ixy": 0.0, "cg_x": 0.0, "k_T": [1.0, 3.0]}
    judged = score.judge(
        {"Ixy": (0.3, 0.1), "cg_x": (0.01, 0.1), "k_T": (5.0, 0.5), "Iyy": (np.nan, 1.0)},
        truth,
        0.5,
    )
    assert judged["Ixy"]["error"] == pytest.approx(0.1)
    assert judged["cg_x"] == {
        "error": pytest.approx(0.02), "z": pytest.approx(0.1), "holds": True
    }  # fmt: skip
    assert judged["k_T"]["error"] == pytest.approx(1.0)
    assert not judged["k_T"]["holds"]
    assert "Iyy" not in judged


def claim(error, holds=True):
    return {"error": error, "z": 0.0, "holds": holds}


FLOWN = [
    {
        "group": "the model",
        "flight": "a 0",
        "possible": ["Ixx", "Iyy", "k_T", "k_M"],
        "estimators": {
            "gcs-sysid": {"claims": {"Ixx": claim(0.02), "Iyy": claim(0.01)}, "seconds": 2.0},
            "other": {
                "claims": {n: claim(0.01) for n in ("Ixx", "Iyy")} | {"k_T": claim(0.2, False)},
                "seconds": 1.0,
            },
            "third": {
                "claims": {"Ixx": claim(0.03), "k_T": claim(0.01), "k_M": claim(0.04),
                           "Iyy": claim(0.06)},
            },
            "broken": {"error": "ValueError: no"},
        },
    }
]  # fmt: skip


def test_the_score_counts_what_a_user_can_rely_on():
    other = score.totals(FLOWN, "other")
    assert (other["score"], other["claimed"], other["false"]) == (0.5, 3, 1)
    assert other["holds"] == pytest.approx(2 / 3)
    assert score.totals(FLOWN, "third")["score"] == 0.75
    assert score.totals(FLOWN, "broken")["score"] == 0.0


def test_our_row_says_who_is_better():
    text = score.page(FLOWN)
    assert "{{" not in text
    assert "| the model (1) | **gcs-sysid** (better: third) | 50 % | 2 of 4 |" in text
    (row,) = (line for line in text.splitlines() if line.startswith("| the model | Ixx |"))
    assert row == "| the model | Ixx | 2 % / 1 % (1) **worse** | 2 % / 3 % (1) | – |"
    assert "Ours is the larger in 1 cells." in text
    assert "- a 0, broken: ValueError: no" in text


def block(t, flying, source, rotors=4):
    n = len(t)
    full = np.ones((n, 4))
    samples = Samples(
        full[:, :3], full[:, :3], np.ones((n, rotors)), full, full[:, :3], full[:, :3]
    )
    return SampleBlock(t, samples, np.full(n, flying), 0.01, False, source)


def test_stretches_end_at_gaps_and_on_the_ground():
    airframe = Airframe("x", tuple(Rotor(1.0, 1.0, 1) for _ in range(4)), mass=1.0)
    source = RotorSource(RotorInput.SPEED, "ESC_STATUS", "why")
    times = [0.01 * np.arange(a, b) for a, b in ((0, 300), (300, 500), (500, 800), (900, 1000))]
    blocks = [
        block(t, flying, source) for t, flying in zip(times, (True, True, False, True), strict=True)
    ]
    given = flight_of(blocks, airframe)
    assert given is not None
    assert [len(s.t) for s in given.stretches] == [500]  # 1 s after the gap is too short
    assert not given.commands
    blocks[0].samples.force[100] = np.nan
    assert [len(s.t) for s in flight_of(blocks, airframe).stretches] == [399]
    assert flight_of(blocks[2:3], airframe) is None


def test_ones_own_entry_of_the_page_is_taken(tmp_path, flight):
    text = score.TEMPLATE.read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(code.splitlines()) <= 30
    mine = tmp_path / "mine.py"
    mine.write_text(code, encoding="utf-8")
    claims = entries.load(f"{mine}:hover_thrust")(flight)
    assert claims["k_T"][0] == pytest.approx(TRUTH["k_T"], rel=1e-3)
