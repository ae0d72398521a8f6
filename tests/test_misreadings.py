"""What misled new users, each as they met it. `docs/misreadings.md` names the test of each."""

import re
import shlex
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from gcs_sysid.cli.airframe_choice import command_for
from gcs_sysid.cli.commands import build_parser
from gcs_sysid.cli.program import run
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results import words
from gcs_sysid.results.result_view import figures, result_table
from gcs_sysid.results.snapshot import LinkState
from gcs_sysid.results.words import PLAIN
from gcs_sysid.screen.snapshot_view import headline, level_of, named, short_headline, sign_of
from gcs_sysid.screen.view import View
from gcs_sysid.session.reported_layout import ReportedLayout, on_circle
from tests.known_results import result_of
from tests.screen import fake

ROOT = Path(__file__).parents[1]
SAMPLE = str(ROOT / "logs" / "sample.tlog")
PAGE = ROOT / "docs" / "misreadings.md"


def rows_of(text: str) -> dict[str, list[str]]:
    """Parameter -> the other words of its row."""
    lines = [line.split() for line in text.splitlines() if line and not line.startswith("- ")]
    return {words[0]: words[1:] for words in lines}


def printed(capsys, *argv: str) -> str:
    status = run(list(argv))
    out, error = capsys.readouterr()
    assert status == 0, error
    return out


@pytest.mark.slow
def test_a_built_in_layout_needs_its_arm(capsys):
    out = printed(capsys, "analyze", SAMPLE, "--airframe", "px4-quad-x", "--mass", "1.5")
    assert out.startswith("partial: ")
    assert "give --arm M" in out
    assert {rows_of(out)[name][-1] for name in ("Ixx", "Iyy", "Izz")} == {"weak"}


@pytest.mark.slow
def test_grams_and_a_reinterpreted_unit_are_partial_and_say_why(capsys):
    out = printed(capsys, "analyze", SAMPLE, "--airframe", "paper", "--mass", "1500")
    assert out.startswith("partial: ")
    assert "give --mass in kg" in out
    assert "rotor speeds were read as rad/s" in out
    assert {row[-1] for row in rows_of(out).values() if len(row) > 3} <= {"weak", "given", "status"}


@pytest.mark.slow
def test_a_mass_that_only_another_unit_explains_identifies_no_inertia(capsys):
    """Ten times too heavy is no implausible mass for the arm."""
    out = printed(capsys, "analyze", SAMPLE, "--airframe", "paper", "--mass", "15")
    assert out.startswith("partial: ")
    assert "rotor speeds were read as rad/s" in out
    rows = rows_of(out)
    assert {rows[name][-1] for name in ("Ixx", "Iyy", "Izz", "k_T", "k_M")} == {"weak"}
    assert rows["cg_x"][-1] == "identified"


@pytest.mark.slow
def test_zero_has_a_limit_and_no_percentage(capsys):
    rows = rows_of(printed(capsys, "analyze", SAMPLE, "--airframe", "paper"))
    assert rows["rotational_damping"][:2] == ["~0", "(<"]
    assert rows["rotor_inertia"][-1] == "zero"
    assert not any(float(r[2]) > 100.0 for r in rows.values() if r[-1] == "identified")


@pytest.mark.parametrize("name", ["rotational_damping", "rotor_inertia", "linear_drag"])
def test_damping_rotor_inertia_and_drag_are_never_negative(name):
    estimate = Estimate(-0.4, 0.73, "", "zero", not_negative=True).bounded
    assert estimate.value == 0.0
    assert estimate.ci95[0] == 0.0
    assert figures(estimate).short == "~0 (< 1.4)"
    assert words.REGISTRY[name].sign == "not negative"


@pytest.mark.slow
def test_a_hover_claims_no_drag(capsys, fly):
    flight = fly("--mission", "hover", "--duration", "12", "--seed", "3", "--rate", "100")
    rows = rows_of(printed(capsys, "analyze", str(flight.tlog), "--airframe", "paper"))
    assert rows["k_T"][-1] == "identified"
    for name in ("linear_drag", "Ixx", "Izz", "k_M"):
        assert (rows[name][0], rows[name][-1]) == ("-", "unobservable"), name


def test_an_unobservable_row_has_no_numbers():
    estimates = {
        "Ixx": Estimate(0.016, 0.0002, "kg m^2", "identified", std_given=0.0001),
        "Izz": Estimate(0.03, 0.02, "kg m^2", "unobservable", std_given=0.0006),
    }
    result = result_of(estimates, verdict="partial")
    rows = rows_of(result_table(result, None, None))
    assert rows["Ixx"] == ["0.01600", "0.00039", "2.4", "0.00020", "kg", "m^2", "identified"]
    assert rows["Izz"] == ["-", "-", "-", "kg", "m^2", "unobservable"]


LAYOUT = ReportedLayout(on_circle("quad-x"), False, "how the vehicle turns", shown=True)


@pytest.mark.parametrize(
    ("layout", "suggestion", "given", "options"),
    [
        (None, None, [], "--airframe FILE.toml --arm M --mass KG"),
        (None, "betaflight-quad-x", [], "--airframe betaflight-quad-x --arm M --mass KG"),
        (LAYOUT, "betaflight-quad-x", [], "--arm M --mass KG"),
        (replace(LAYOUT, sized=True), None, [], "--mass KG"),
        (LAYOUT, None, ["--arm", "110mm", "--mass", "0.5+-1%"], "--arm 0.11 --mass 0.5+-1%"),
        (None, None, ["--airframe", "paper", "--k-t", "1e-5"], "--airframe paper --k-t 1e-05"),
        (LAYOUT, None, ["--airframe", "px4-quad-x"], "--airframe px4-quad-x --arm M --mass KG"),
    ],
)
def test_inspect_proposes_a_command_that_fits_the_log(layout, suggestion, given, options):
    parsed = build_parser().parse_args(["analyze", "a log.bin", *given])
    command = command_for("a log.bin", layout, parsed, suggestion)
    assert command == f"gcs-sysid analyze 'a log.bin' {options}"
    build_parser().parse_args(shlex.split(command.replace(" M", " 0.1").replace(" KG", " 1"))[1:])


def test_the_headline_follows_the_target():
    identified = replace(fake.snapshot(), result=replace(fake.result(), verdict="identified"))
    assert headline(identified) == "IDENTIFIED TO ±190 %"  # 5 of 10 within the target
    assert (sign_of(identified), level_of(identified)) == ("~", "partial")
    assert short_headline(identified) == "±190 %"
    assert "TO" in headline(replace(identified, target=0.5))  # Izz is weak all the same
    good = {n: replace(e, status="identified") for n, e in fake.estimates().items() if e.value}
    result = replace(fake.result(), verdict="identified", parameters=good)
    reached = replace(identified, result=result, target=5.0)
    assert headline(reached) == short_headline(reached) == "IDENTIFIED"
    assert (sign_of(reached), level_of(reached)) == ("✓", "identified")


@pytest.mark.parametrize(
    ("share", "target", "text"),
    [(0.02004, 0.02, "2.1 %"), (0.02, 0.02, "2.0 %"), (0.0962, 0.02, "9.6 %"),
     (0.100049, 0.1, "11 %"), (0.019996, 0.02, "2.0 %"), (0.02004, None, "2.0 %")],
)  # fmt: skip
def test_what_is_above_the_target_never_reads_as_within_it(share, target, text):
    assert PLAIN.percent(share, target=target) == text
    assert named([("Ixy", share)], 40, target=target) == f"Ixy ±{text}"


@pytest.mark.parametrize("picture", ["screen.svg", "pilot.svg"])
def test_the_pictures_claim_nothing_absurd(picture):
    text = re.sub(r"<[^>]*>", " ", (ROOT / "docs" / picture).read_text("utf-8"))
    text = re.sub(r"&#160;|\s+", " ", text)
    assert not re.search(r"(rotor_inertia|damping|drag)\s+-", text)
    assert not re.search(r"\d{3,} % . identified|>999", text)


@pytest.mark.slow
def test_a_session_without_a_vehicle_refuses_nothing(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{free.getsockname()[1]}"
    argv = ["live", url, "--airframe", "paper", "--duration", "0.3", "--headless"]
    assert run(argv) == 1
    out, error = capsys.readouterr()
    assert out.startswith("nothing identified from udpin:")
    assert "no heartbeat of any autopilot received" in out
    assert "refused" not in out + error
    assert list(tmp_path.glob("logs/*.tlog")) == []


def test_after_the_stream_the_screen_gives_no_orders():
    """That no advice is made then: `test_nobody_is_told_to_fly_what_nobody_sees`."""
    ended = replace(fake.snapshot(), link=fake.link(LinkState.ENDED))
    assert View(ended, {}, "", {}).notice()[0].startswith("Stream ended, numbers are final")


def test_the_screen_names_statuses_and_parameters_as_the_result_does():
    assert set(words.STATUS) == {"given", "identified", "zero", "weak", "unobservable"}
    short = {name: words.label(name) for name in words.REGISTRY if words.label(name) != name}
    assert short == {"rotational_damping": "rot_damping"}  # thirteen letters in a table


@pytest.mark.parametrize(
    ("argv", "near"),
    [
        (["analize", SAMPLE], "did you mean analyze?"),
        (["analyze", SAMPLE, "--amr", "1"], "did you mean --arm?"),
        (["analyze", SAMPLE, "--masss", "1"], "did you mean --mass?"),
        (["analyze", SAMPLE, "--airframe", "papr"], "did you mean paper?"),
        (["analyze", SAMPLE, "--airframe", "paper", "--prior", "kM=1+-1"], "did you mean k_M?"),
        (["export", "r.json", "--to", "px4sih", "-o", "x"], "did you mean px4-sih?"),
    ],
)
def test_misspelt_words_are_answered_with_the_nearest(capsys, argv, near):
    assert run(argv) == 2
    error = capsys.readouterr().err
    assert near in error
    assert error.count("\n") == 1


def test_both_spellings_are_accepted(capsys):
    refused = []
    for spelling in ("analyze", "analyse"):
        assert run([spelling, "gone.tlog", "--airframe", "paper"]) == 2
        refused.append(capsys.readouterr().err)
    assert refused[0] == refused[1]
    assert "gone.tlog" in refused[0]


def test_every_test_that_the_table_names_is_there():
    named = set(re.findall(r"`(?:\w+\.py::)?(test_\w+)`", PAGE.read_text("utf-8")))
    assert len(named) >= 12
    files = [path.read_text("utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    missing = [name for name in named if not any(f"def {name}(" in text for text in files)]
    assert missing == []
    own = set(re.findall(r"def (test_\w+)\(", Path(__file__).read_text("utf-8")))
    assert own - named == {"test_every_test_that_the_table_names_is_there"}
