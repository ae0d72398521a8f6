"""Commands that do their work: what they print, write and return."""

import json
import re
import signal
import subprocess
import sys

import pytest

from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import PARAMETERS, TIMING
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.result_view import result_table
from gcs_sysid.telemetry.tlog import TlogReader
from gcs_sysid.telemetry.tlog_writer import TlogWriter
from tests.known_results import result_of

PAPER = ("--airframe", "paper")
ESTIMATE_KEYS = {*("value", "std", "std_data", "std_given", "ci95", "unit", "status", "objections")}
RESULT_KEYS = {
    *("schema", "verdict", "reasons", "source", "vehicle", "scale", "rotor_input"),
    *("parameters", "timing", "events", "segments", "validation", "telemetry"),
}


def read_strict(text):
    """JSON without NaN and infinity."""
    return json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in the JSON"))


def check_contract(result):
    """A result is as INTERFACE.md says."""
    assert result.keys() >= RESULT_KEYS
    assert result["schema"] == "gcs-sysid/1"
    assert result["verdict"] in ("identified", "partial", "refused")
    assert all(isinstance(reason, str) for reason in result["reasons"])
    assert result["reasons"] or result["verdict"] == "identified"
    assert result["vehicle"].keys() == {"sysid", "compid", "autopilot"}
    assert result["scale"] == {"anchor": "mass", "value": 1.5, "unit": "kg"}
    assert result["rotor_input"] in ("speed", RotorInput.COMMAND)
    for table, known in (("parameters", PARAMETERS), ("timing", TIMING)):
        assert result[table].keys() <= known.keys()
        for name, estimate in result[table].items():
            assert estimate.keys() == ESTIMATE_KEYS
            assert estimate["unit"] == known[name].unit
            assert estimate["status"] in ("identified", "given", "zero", "weak", "unobservable")
            value, std = estimate["value"], estimate["std"]
            if value is None:
                assert estimate["ci95"] is None
            else:
                low = value - 1.96 * std
                if known[name].sign == "not negative":
                    low = max(low, 0.0)
                expected = pytest.approx([low, value + 1.96 * std], abs=1e-4 * std)
                assert estimate["ci95"] == expected
    for event in result["events"]:
        assert event.keys() >= {"t", "kind"}


@pytest.fixture
def no_imu(paper_flight, tmp_path):
    """A recording without its IMU messages."""
    path = tmp_path / "no-imu.tlog"
    with TlogWriter(path) as writer:
        for time_us, frame in TlogReader(paper_flight.tlog):
            if frame.message_id != 105:  # HIGHRES_IMU
                writer.write(time_us, [frame])
    return path


@pytest.mark.slow
def test_table_shows_truth_and_error_beside_json_in_a_file(analyze, paper_flight, tmp_path):
    path = tmp_path / "result.json"
    truth = ("--truth", paper_flight.truth_file)
    status, out, err = analyze(paper_flight.tlog, *PAPER, *truth, "--json", path)
    assert (status, err) == (0, "")
    assert out.startswith("identified: ")
    result = read_strict(path.read_text())
    check_contract(result)
    assert result["verdict"] == "identified"
    assert result["source"] == str(paper_flight.tlog)
    for name in ("mass", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y", "k_T", "k_M"):
        assert result["parameters"][name]["value"] == pytest.approx(
            paper_flight.truth[name], rel=0.05
        )
    head, *rows = (line for line in out.splitlines()[2:] if not line.startswith("-"))
    assert head.split()[0] == "parameter"
    assert "truth" in head
    assert "error %" in head
    table = {row.split()[0]: row.split() for row in rows if row}
    expected = {n for n, p in PARAMETERS.items() if p.in_result("speed")}
    assert set(table) == expected
    for name in ("Ixx", "Izz", "k_M"):
        value, half, truth, error = (float(table[name][k]) for k in (1, 2, -2, -1))
        assert truth == pytest.approx(paper_flight.truth[name], rel=1e-5)
        # The value is rounded to two digits of its interval, the error to two decimals.
        rounding = 0.005 + 100 * 0.05 * half / value
        assert error == pytest.approx(100 * (value / truth - 1), abs=rounding)
    assert max(map(len, rows)) < 110


@pytest.mark.parametrize(("with_truth", "with_bounds"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_the_table_fits_a_terminal_of_80_columns(with_truth, with_bounds):
    bound = 1.2e-6 if with_bounds else None
    estimates = {
        name: Estimate(-1.23456e-4, 3.4e-10, p.unit, "identified", bound)
        for name, p in PARAMETERS.items()
    }
    estimates["mass"] = Estimate(1.5, 0.0, "kg", "given")
    estimates["rotor_inertia"] = Estimate(None, None, "kg m^2", "unobservable")
    truth = dict.fromkeys(PARAMETERS, -2.34567e-4) if with_truth else None
    reasons = ("a reason that is longer than what is left of a line: " + "word " * 20,)
    result = result_of(estimates, verdict="partial", reasons=reasons, scale=None)
    table = result_table(result, truth, 80)
    lines = table.splitlines()
    assert max(map(len, lines)) <= 80
    head = next(line for line in lines if line.startswith("parameter"))
    kept = {"value", "± 95 %", "unit", "status"} | ({"truth", "error %"} if with_truth else set())
    assert all(column in head for column in kept)
    assert table.count("word") == 20
    free = result_table(result, truth)
    assert max(map(len, free.splitlines())) > 80
    assert "-0.000123456" in free


@pytest.mark.slow
def test_parts_of_two_logs_make_a_list(analyze, paper_flight):
    part = ("--start", "20", "--end", "28")
    status, out, _ = analyze(paper_flight.tlog, paper_flight.tlog, *PAPER, *part, "--json", "-")
    results = read_strict(out)
    assert status == 0
    assert results[0] == results[1]
    check_contract(results[1])
    assert 4.0 < results[0]["telemetry"]["used_seconds"] <= 8.0


def test_a_log_without_imu_is_refused_with_the_reason(analyze, no_imu):
    status, out, err = analyze(no_imu, *PAPER, "--json", "-")
    assert status == 1
    assert err.startswith(f"gcs-sysid: {no_imu}: cannot identify from this: ")
    assert err.count("\n") == 1
    assert "no IMU" in err
    result = read_strict(out)
    check_contract(result)
    assert result["verdict"] == "refused"
    assert any("no IMU" in reason for reason in result["reasons"])
    status, out, err = analyze(no_imu, *PAPER)
    assert (status, out) == (1, "")
    assert "no IMU" in err


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    ["forward-td", "article", pytest.param("article-stepwise", marks=pytest.mark.thorough)],
)
def test_methods_for_study(analyze, paper_flight, method):
    status, out, _ = analyze(paper_flight.tlog, *PAPER, "--method", method, "--json", "-")
    result = read_strict(out)
    assert status == 0
    izz = result["parameters"]["Izz"]
    if method == "forward-td":
        assert izz["value"] == pytest.approx(paper_flight.truth["Izz"], rel=0.06)
    else:  # drawn to zero, and not claimed
        assert abs(izz["value"]) < 0.5 * paper_flight.truth["Izz"]
        assert izz["status"] != "identified"


def program(*argv):
    return [sys.executable, "-m", "gcs_sysid", *map(str, argv)]


@pytest.mark.slow
def test_live_where_nobody_speaks_says_so_and_goes_on(tmp_path):
    """It is stopped by Ctrl-C, after it has said that it listens."""
    argv = program("live", "udpin:127.0.0.1:45873", *PAPER, "--headless", "--json", "-")
    process = subprocess.Popen(
        argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    first = process.stderr.readline()
    assert first == "listening on udpin:127.0.0.1:45873: no vehicle yet\n"
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert re.search(r"nothing received: logs/.*\.tlog was not kept", err)
    assert not list((tmp_path / "logs").glob("*.tlog"))
    (line,) = out.splitlines()
    result = read_strict(line)
    assert result["verdict"] == "refused"
    assert "no heartbeat" in result["reasons"][0]


@pytest.mark.slow
def test_demo_ends_with_estimate_truth_and_error(analyze, tmp_path):
    record, lines = tmp_path / "demo.tlog", tmp_path / "demo.json"
    argv = ("demo", "--headless", "--speed", "max", "--duration", "9")
    done = subprocess.run(
        program(*argv, "--record", record, "--json", lines),
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=300,
    )
    assert done.returncode == 0
    assert " s  coach: " in done.stderr
    head = next(text for text in done.stdout.splitlines() if text.startswith("parameter"))
    assert "truth" in head
    assert "error %" in head
    row = next(text for text in done.stdout.splitlines() if text.startswith("Ixx")).split()
    assert abs(float(row[-1])) < 3.0
    results = [read_strict(text) for text in lines.read_text().splitlines()]
    assert len(results) > 4
    for result in results[1:]:
        check_contract(result)
    # The recording, analyzed, says the same.
    status, out, err = analyze(record, *PAPER, "--json", "-")
    assert (status, err) == (0, "")
    check_contract(read_strict(out))
    last, analyzed = results[-1]["parameters"], read_strict(out)["parameters"]
    assert last.keys() == analyzed.keys()
    for name, estimate in last.items():
        assert estimate["value"] == pytest.approx(analyzed[name]["value"], rel=1e-9, abs=0.0)
