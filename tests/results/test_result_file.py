"""Results read back, and files that are none."""

import json

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.results.result_data import Scale
from gcs_sysid.results.result_file import parse_result, read_result
from tests.known_results import result_of

RESULT = result_of(
    {
        "mass": Estimate(1.5, 0.01, "kg", "identified", bound=0.005),
        "Izz": Estimate(0.03, 0.003, "kg m^2", "weak", rests_on="prior"),
        "Ixz": Estimate(None, None, "kg m^2", "unobservable"),
    },
    verdict="partial",
    reasons=("weak: Izz",),
    source="flight.tlog",
    scale=Scale("k_T", 2e-4, "N s^2", 1e-6, "the flight before 31.0 s"),
    timing={"rotor_delay": Estimate(0.001, 0.0001, "s", "identified")},
    airframe={"name": "mine", "rotors": []},
)


def test_what_was_written_is_read(tmp_path):
    RESULT.write(tmp_path / "r.json")
    assert read_result(tmp_path / "r.json") == RESULT


def test_a_path_may_be_text_and_a_missing_one_is_one_line():
    with pytest.raises(InputError, match="No such file"):
        read_result("nowhere.json")


def test_the_last_line_of_a_live_session_counts(tmp_path):
    earlier = RESULT.as_json() | {"source": "earlier"}
    lines = [json.dumps(earlier), RESULT.dumps(indent=None)]
    (tmp_path / "live.json").write_text("\n".join(lines) + "\n")
    assert read_result(tmp_path / "live.json").source == "flight.tlog"


def test_parameters_of_a_later_version_are_passed_over():
    later = RESULT.as_json()
    later["parameters"]["color"] = {"value": "red"}
    assert parse_result(later, "r.json") == RESULT


def test_a_list_of_one_is_that_one():
    assert parse_result([RESULT.as_json()], "r.json") == RESULT
    with pytest.raises(InputError, match="2 results"):
        parse_result([RESULT.as_json()] * 2, "r.json")


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", "{}", '{"schema": "other/1"}', "[" * 100_000, "\x00"]
)
def test_files_that_are_no_result(tmp_path, text):
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(InputError, match=r"r\.json"):
        read_result(tmp_path / "r.json")


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "latin.json").write_bytes(b'{"a": "\xe9"}')
    for name in ("none.json", "latin.json", "."):
        with pytest.raises(InputError):
            read_result(tmp_path / name)


@pytest.mark.parametrize(
    "change",
    [
        {"verdict": "splendid"}, {"rotor_input": 3}, {"parameters": []}, {"reasons": "none"},
        {"parameters": {"mass": 1.5}}, {"parameters": {"mass": {"value": "1.5"}}},
        {"parameters": {"mass": {"value": 1.5, "std": -1.0, "status": "given"}}},
        {"parameters": {"mass": {"value": True, "std": 0.0, "status": "given"}}},
        {"parameters": {"mass": {"value": 1.5, "std": 0.0, "status": "perhaps"}}},
        {"parameters": {"mass": {"value": 10**400, "std": 0.0, "status": "given"}}},
        {"scale": {"anchor": "height", "value": 1.0}}, {"scale": {"anchor": "mass", "value": 0.0}},
    ],
)  # fmt: skip
def test_results_with_something_wrong_in_them(change):
    with pytest.raises(InputError, match=r"^r\.json: "):
        parse_result(RESULT.as_json() | change, "r.json")


def test_not_a_number_is_refused(tmp_path):
    (tmp_path / "r.json").write_text('{"schema": "gcs-sysid/1", "a": NaN}')
    with pytest.raises(InputError, match="NaN"):
        read_result(tmp_path / "r.json")
