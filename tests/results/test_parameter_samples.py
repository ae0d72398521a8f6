"""Samples of a result's covariance, its flight model, and how notebooks show it."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.errors import InputError, NoAnswerError
from gcs_sysid.model.airframe import parse_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.rigid_body import are_physical
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.history import Acceleration, History
from tests.known_results import result_of

VALUES = {
    "mass": (1.5, 0.0), "Ixx": (0.0165, 1e-4), "Iyy": (0.0167, 1e-4), "Izz": (0.0294, 6e-4),
    "Ixy": (0.00135, 5e-5), "Iyz": (0.00254, 5e-5), "Ixz": (-0.00166, 5e-5), "cg_x": (0.1, 1e-4),
    "cg_y": (0.05, 1e-4), "k_T": (2.05e-4, 1e-6), "k_M": (6.14e-6, 1.2e-7),
    "rotational_damping": (1e-5, 1e-4),
}  # fmt: skip
INERTIA = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz")
ROTORS = [
    {"x": x, "y": y, "spin": spin}
    for x, y, spin in ((0.25, 0.25, "ccw"), (-0.25, -0.25, "ccw"), (0.25, -0.25, "cw"),
                       (-0.25, 0.25, "cw"))
]  # fmt: skip


def result(std_given=0.0, **changed):
    """Of the article's vehicle; Izz and k_M err nearly together."""
    values = VALUES | changed
    names = [name for name, (_, std) in values.items() if std]
    std = np.array([values[name][1] for name in names])
    correlation = np.eye(len(names))
    i, j = names.index("Izz"), names.index("k_M")
    correlation[i, j] = correlation[j, i] = 0.95
    estimates = {
        name: Estimate(value, std, REGISTRY[name].unit, "identified" if std else "given",
                       std_given=std_given * std,
                       not_negative=REGISTRY[name].sign == "not negative")
        for name, (value, std) in values.items()
    }  # fmt: skip
    return result_of(
        estimates,
        source="a <flight>.tlog",
        timing={"rotor_delay": Estimate(0.001, 1e-4, "s", "identified")},
        airframe={"name": "x", "rotors": ROTORS},
        covariance={"names": names, "matrix": (correlation * np.outer(std, std)).tolist()},
    )


def test_samples_have_the_covariance():
    r = result()
    samples = r.samples(20_000, seed=3)
    assert samples["Izz"].std() == pytest.approx(6e-4, rel=0.03)
    assert samples["cg_x"].mean() == pytest.approx(0.1, abs=4e-6)
    assert np.corrcoef(samples["Izz"], samples["k_M"])[0, 1] == pytest.approx(0.95, abs=0.01)
    assert abs(np.corrcoef(samples["Ixx"], samples["k_M"])[0, 1]) < 0.03
    # Given is given, and what the covariance does not name varies by itself.
    assert set(samples["mass"]) == {1.5}
    assert samples["rotor_delay"].std() == pytest.approx(1e-4, rel=0.03)
    # What cannot be negative is not.
    assert samples["rotational_damping"].min() == 0.0
    again = r.samples(20_000, seed=3)
    assert np.array_equal(samples.table, again.table)
    assert not np.array_equal(samples.table, r.samples(20_000, seed=4).table)


def test_what_was_given_may_be_left_out():
    r = result(std_given=0.8)
    assert r.samples(20_000, 1)["Ixx"].std() == pytest.approx(1e-4, rel=0.03)
    assert r.samples(20_000, 1, given=False)["Ixx"].std() == pytest.approx(0.6e-4, rel=0.03)


def test_wide_samples_are_still_rigid_bodies():
    samples = result(Izz=(0.0294, 0.02), Ixy=(0.00135, 0.008)).samples(500, 1)
    inertia = np.stack([samples[name] for name in INERTIA], axis=1)
    assert are_physical(inertia).all()
    assert (samples["k_M"] > 0.0).all()
    assert len(inertia) == 500


def test_samples_that_cannot_be_had_are_refused():
    with pytest.raises(NoAnswerError, match="hardly any draw"):
        result(Izz=(0.2, 1e-4)).samples(10)
    with pytest.raises(NoAnswerError, match="no covariance"):
        replace(result(), covariance={}).samples(10)
    with pytest.raises(InputError, match="malformed"):
        replace(result(), covariance={"names": ["Ixx"], "matrix": [[1.0, 2.0]]}).samples(10)
    with pytest.raises(InputError, match="1 or more"):
        result().samples(0)
    with pytest.raises(KeyError):
        result().samples(1)["thrust"]


def test_the_model_has_the_numbers_of_result_and_samples():
    r = result()
    m = r.model()
    assert m.inertia.tolist() == [VALUES[name][0] for name in INERTIA]
    assert m.thrust.tolist() == [2.05e-4] * 4
    assert m.geometry[2].tolist() == [1.0, 1.0, -1.0, -1.0]
    samples = r.samples(7, 1)
    several = r.model(samples)
    assert several.inertia.shape == (7, 6)
    assert several.damping[:, 0].tolist() == samples["rotational_damping"].tolist()
    each = [{"k_T": Estimate(2.05e-4 * s, 1e-6, "N s^2", "identified"),
             "k_M": Estimate(6.14e-6, 1e-7, "N m s^2", "identified")}
            for s in (0.9, 1.1, 1.0, 1.0)]  # fmt: skip
    uneven = replace(r, rotors=tuple(each)).model()
    assert uneven.thrust == pytest.approx(2.05e-4 * np.array([0.9, 1.1, 1.0, 1.0]))
    by_axis = dict(r.parameters) | {"yaw_damping": Estimate(0.004, 1e-4, "N m s", "identified")}
    assert replace(r, parameters=by_axis).model().damping.tolist() == [1e-5, 1e-5, 0.004]


def test_the_models_rotors_lie_where_the_fit_has_them():
    offsets = 1e-3 * np.arange(8.0).reshape(2, 4)
    moved = replace(result(), telemetry={"rotor_offsets": {"value": offsets.tolist()}})
    assert moved.model().geometry[:2] == pytest.approx(result().model().geometry[:2] + offsets)
    for wrong in ({"value": [1.0]}, {"std": 1.0}, [0.0], {"value": [["x"] * 4] * 2}):
        with pytest.raises(InputError, match="rotor_offsets is malformed"):
            replace(moved, telemetry={"rotor_offsets": wrong}).model()


def test_canted_rotors_turn_by_thrust_too():
    r = result()
    airframe = parse_airframe({"name": "x", "rotor": ROTORS}, "here")
    canted = replace(
        airframe,
        rotors=tuple(
            replace(rotor, axis=(-rotor.spin * rotor.y, rotor.spin * rotor.x, -5.0))
            for rotor in airframe.rotors
        ),
    )
    expected = 6.14e-6 + 2.05e-4 * 0.125 / 5.0  # (x^2 + y^2) / 5
    m = replace(r, airframe=canted.as_json()).model()
    assert m.torque == pytest.approx(np.full(4, expected))


def test_commands_turn_thrust_by_the_moment_ratio():
    own = {n: e for n, e in result().parameters.items() if n not in ("k_T", "k_M")}
    own |= {"T_max": Estimate(9.0, 0.1, "N", "identified"),
            "moment_ratio": Estimate(0.03, 1e-3, "m", "identified"),
            "thrust_curve": Estimate(0.4, 0.01, "1", "identified")}  # fmt: skip
    lag = {"motor_lag": Estimate(0.04, 1e-3, "s", "identified", not_negative=True)}
    m = replace(result(), rotor_input=RotorInput.COMMAND, parameters=own, timing=lag).model()
    assert m.torque == pytest.approx(np.full(4, 9.0 * 0.03))
    assert (float(m.thrust_curve), float(m.motor_lag)) == (0.4, 0.04)


def test_a_model_without_yaw_says_what_to_fly():
    parameters = dict(result().parameters) | {"Izz": Estimate(None, None, "kg m^2", "unobservable")}
    with pytest.raises(NoAnswerError, match=r"needs Izz, .* fly yaw and gyroscopic torque"):
        replace(result(), parameters=parameters).model()
    with pytest.raises(InputError, match="rotor positions"):
        replace(result(), airframe={}).model()


def test_identified_parameters_have_a_number():
    r = result()
    assert r.identified("Izz").ci95 == r.parameters["Izz"].ci95
    assert r.identified("rotor_delay").value == 0.001
    assert r.identified("rotational_damping").ci95[0] == 0.0
    weak = dict(r.parameters) | {"Ixy": Estimate(1.0, 1.0, "kg m^2", "weak")}
    with pytest.raises(InputError, match="Ixy is weak"):
        replace(r, parameters=weak).identified("Ixy")
    with pytest.raises(InputError, match="no 'Jzz'; it has mass"):
        r.identified("Jzz")


def test_it_prints_on_one_screen():
    lines = repr(replace(result(), reasons=tuple(f"reason {i} " * 20 for i in range(9)))).split(
        "\n"
    )
    assert len(lines) <= 30
    assert max(map(len, lines)) <= 80
    assert any(line.split()[:2] == ["Izz", "0.0294"] for line in lines)
    assert "5 more in .reasons" in "\n".join(lines)


def test_html_is_escaped():
    page = replace(result(), reasons=("<script>",))._repr_html_()
    assert "a &lt;flight&gt;.tlog" in page
    assert "&lt;script&gt;" in page
    assert page.count("<tr>") == 1 + len(VALUES) + 1


@pytest.mark.parametrize(
    ("library", "use"),
    [
        ("pandas", lambda r: r.to_dataframe()),
        ("pandas", lambda r: r.samples(2).to_dataframe()),
        ("matplotlib", lambda r: r.plot()),
    ],
)
def test_what_is_not_installed_is_named(monkeypatch, library, use):
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"{library}.figure", raising=False)
    with pytest.raises(InputError, match=rf"needs {library}: pip install .gcs-sysid\[notebook\]"):
        use(result())


def test_data_frames_have_the_numbers():
    pytest.importorskip("pandas")
    table = result(std_given=0.5).to_dataframe()
    assert table.loc["Izz", "value"] == 0.0294
    assert table.loc["Izz", "std_given"] == 3e-4
    assert table.loc["rotational_damping", "low95"] == 0.0
    assert result().samples(5).to_dataframe().shape == (5, len(VALUES) + 1)


def test_plots_draw_what_there_is():
    pytest.importorskip("matplotlib")
    r = result()
    assert r.plot().axes[0].get_title() == "correlation of the errors"
    t = np.arange(3.0)
    kept = replace(
        r,
        history=History(t, {"Izz": np.full(3, 0.03)}, {"Izz": np.full(3, 0.001)}),
        prediction=Acceleration(t, np.ones((3, 3)), np.ones((3, 3))),
    )
    assert len(kept.plot().axes) == 4  # with the scale of colors
    line = kept.plot("convergence").axes[0].lines[0]
    assert line.get_ydata() == pytest.approx(np.full(3, 0.03 / 0.0294))


@pytest.mark.parametrize(
    ("kind", "says"),
    [("convergence", "history=True"), ("prediction", "history=True"), ("bode", "no kind 'bode'")],
)
def test_plots_that_cannot_be_drawn_say_why(kind, says):
    pytest.importorskip("matplotlib")
    with pytest.raises(InputError, match=says):
        result().plot(kind)
