"""What a user knows beforehand, and what an analysis can do with a whole record."""

import json

import pytest

PAPER = ("--airframe", "paper")


@pytest.fixture(scope="module")
def stepped(fly):
    """20 s of all axes, 20 % heavier from the middle on."""
    flight = ("--mission", "all-axes", "--noise", "mems", "--rate", "100", "--duration", "20")
    return fly(*flight, "--mass-step", "10:1.2")


@pytest.mark.slow
def test_a_mass_step_is_told_with_time_and_size(analyze, stepped):
    status, out, _ = analyze(stepped.tlog, *PAPER, "--json", "-")
    result = json.loads(out)
    assert status == 0
    (event,) = [e for e in result["events"] if "detected" in e]
    assert event["kind"] == "mass_change"
    assert event["t"] == pytest.approx(10.0, abs=0.05)
    assert event["detected"] - event["t"] < 0.25 + 0.05
    low, high = event["parameters"]["mass"]["ci95"]
    assert low < 0.3 < high
    assert result["scale"]["anchor"] == "k_T"
    assert result["scale"]["from"].startswith("the flight before 10")
    mass = result["parameters"]["mass"]
    assert mass["value"] == pytest.approx(1.8, rel=0.005)
    assert mass["status"] == "identified"
    (segment,) = result["segments"]
    assert segment["scale"] == {"anchor": "mass", "value": 1.5, "unit": "kg"}
    assert segment["parameters"]["mass"]["status"] == "given"
    assert segment["end"] == event["t"]
    for name in ("Ixx", "Iyy"):
        assert result["parameters"][name]["value"] == pytest.approx(stepped.truth[name], rel=0.03)


@pytest.mark.slow
def test_two_flights_with_a_known_mass_added_give_mass_and_k_t(analyze, fly):
    common = ("--mission", "all-axes", "--noise", "mems", "--rate", "50", "--duration", "12")
    light = fly(*common, "--seed", "1")
    heavy = fly(*common, "--seed", "2", "--mass-step", "0.1:1.2")
    status, out, _ = analyze(light.tlog, heavy.tlog, *PAPER, "--added-mass", "0.3", "--json", "-")
    first, second = json.loads(out)
    assert status == 0
    assert first["scale"] == {"anchor": "added_mass", "value": 0.3, "unit": "kg"}
    for result, mass in ((first, 1.5), (second, 1.8)):
        for name, true in (("mass", mass), ("k_T", 2.05e-4), ("Ixx", 0.0165)):
            estimate = result["parameters"][name]
            assert estimate["value"] == pytest.approx(true, rel=0.03)
            assert abs(estimate["value"] - true) < 2.5 * estimate["std"]
            assert estimate["status"] == "identified"
    part = ("--end", "5")
    status, _, err = analyze(heavy.tlog, light.tlog, *PAPER, "--added-mass", "0.3", *part)
    assert status == 2
    assert "is not heavier" in err


@pytest.mark.slow
def test_offline_shows_the_bound(analyze, paper_flight, tmp_path):
    path = tmp_path / "result.json"
    status, table, _ = analyze(paper_flight.tlog, *PAPER, "--offline", "--json", str(path))
    result = json.loads(path.read_text(encoding="utf-8"))
    assert status == 0
    assert result["estimator"] == "offline"
    for name in ("Ixx", "Izz", "Ixy", "cg_x", "k_M", "moment_ratio"):
        estimate = result["parameters"][name]
        assert 0.0 < estimate["bound"] <= 1.02 * estimate["std"]
        assert "rests_on" not in estimate  # nothing was known beforehand
        assert estimate["value"] == pytest.approx(paper_flight.truth[name], rel=0.03)
    assert "bound" not in result["parameters"]["k_T"]  # the likelihood is that of the rotation
    assert "bound 95 %" in table  # under what is to be looked at first


@pytest.mark.slow
def test_a_prior_tells_izz_in_hover(analyze, fly):
    hover = fly("--mission", "hover", "--noise", "mems", "--rate", "50", "--duration", "12")
    _, out, _ = analyze(hover.tlog, *PAPER, "--prior", "k_M=6.14e-6+-1e-7", "--json", "-")
    result = json.loads(out)
    assert result["priors"] == {"k_M": {"value": 6.14e-6, "std": 1e-7}}
    k_M = result["parameters"]["k_M"]
    assert k_M["value"] == pytest.approx(6.14e-6, rel=0.02)
    assert k_M["rests_on"] == "prior"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--prior", "k_M=1"), "NAME=VALUE±STD"),
        (("--prior", "weight=1+-0.1"), "no prior on 'weight'"),
        (("--prior", "k_M=6e-6±0"), "must be positive"),
        (("--prior", "Ixx=-1±0.1"), "Ixx must be positive"),
        (("--added-mass", "0.3"), "two logs"),
        (("--added-mass", "0.3", "--mass", "1.5"), "sets the scale"),
        (("--offline", "--method", "article"), "forward"),
    ],
)
def test_what_makes_no_sense_is_said(analyze, paper_flight, capsys, words, said):
    logs = (paper_flight.tlog,) * (2 if "--mass" in words else 1)
    try:
        status, _, err = analyze(*logs, *PAPER, *words)
    except SystemExit as ended:
        status, err = ended.code, capsys.readouterr().err
    assert status == 2
    assert said in err
