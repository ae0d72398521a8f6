"""What the doctor says of the machine itself."""

import pytest

from gcs_sysid.setup_help.checks import (
    SetupFinding,
    Sign,
    as_text,
    check_packages,
    check_python,
    check_recordings,
    check_terminal,
    worst,
)


@pytest.mark.parametrize(
    ("version", "sign"), [("3.11.0", Sign.OK), ("3.14.1", Sign.OK), ("3.9.18", Sign.PROBLEM)]
)
def test_python(version, sign):
    finding = check_python(version, ">=3.11")
    assert finding.sign is sign
    assert version in finding.text
    assert ("3.11 or newer" in finding.text) is (sign is Sign.PROBLEM)


def test_this_python_and_its_packages_are_good():
    assert check_python().sign is Sign.OK
    finding = check_packages()
    assert finding.sign is Sign.OK, finding.text
    for name in ("numpy", "scipy", "pymavlink", "pyserial", "textual"):
        assert name in finding.text


def test_packages_that_lack_or_are_old():
    versions = {"numpy": "1.24.9", "scipy": "1.11", "textual": "10.0.0rc1", "odd": "2.0"}
    requirements = [
        *("numpy>=1.26", "scipy>=1.11.0", "textual>=8", "pyserial>=3.5", "odd"),
        *('pytest>=8; extra == "dev"', 'drake>=1.40; extra == "exports"'),
    ]
    finding = check_packages(requirements, versions.get)
    assert finding.sign is Sign.PROBLEM
    assert finding.text == "numpy is 1.24.9, 1.26 or newer is needed; pyserial is not installed"
    (advice,) = finding.advice
    assert advice.endswith('-m pip install "numpy>=1.26" "pyserial>=3.5"')


def terminal(**known):
    usual = {
        "is_terminal": True,
        "size": (120, 40),
        "encoding": "utf-8",
        "environment": {"TERM": "xterm-256color"},
    }
    return check_terminal(**(usual | known))


def test_a_terminal_as_it_should_be():
    finding = terminal()
    assert (finding.sign, finding.text) == (Sign.OK, "120x40, UTF-8, 256 colors")
    assert "16 million" in terminal(environment={"COLORTERM": "truecolor"}).text
    assert "NO_COLOR" in terminal(environment={"NO_COLOR": "1"}).text


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"is_terminal": False}, "run it in a terminal"),
        ({"size": (79, 40)}, "80 columns"),
        ({"size": (80, 23)}, "24 lines"),
        ({"encoding": "cp1252"}, "UTF"),
        ({"environment": {"TERM": "dumb"}}, "--headless"),
    ],
)
def test_a_terminal_that_is_not(known, said):
    finding = terminal(**known)
    assert finding.sign is Sign.WARNING
    assert any(said in advice for advice in finding.advice)


def test_recordings_can_be_written(tmp_path):
    finding = check_recordings(tmp_path / "logs")
    assert finding.sign is Sign.OK
    assert str(tmp_path / "logs") in finding.text
    assert list(tmp_path.iterdir()) == []  # only tried


def test_recordings_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    for folder in (tmp_path / "file", tmp_path / "none" / "logs"):
        finding = check_recordings(folder)
        assert finding.sign is Sign.PROBLEM
        assert any("--record" in advice for advice in finding.advice)


def test_findings_as_text():
    findings = [
        SetupFinding("a", Sign.OK, "fine"),
        SetupFinding("b", Sign.PROBLEM, "word " * 20, ["a command that is kept whole " * 4]),
    ]
    lines = as_text(findings, 60, unicode=True).splitlines()
    assert lines[0] == "✓ ok       a: fine"
    assert lines[1].startswith("✗ problem  b: word")
    assert lines[-1].strip() == "-> " + "a command that is kept whole " * 3 + (
        "a command that is kept whole"
    )
    assert max(map(len, lines[:-1])) <= 60
    assert as_text(findings, 60, unicode=False).isascii()
    assert worst(findings) is Sign.PROBLEM
    assert worst([]) is Sign.OK
    assert findings[0].as_json() == {"topic": "a", "sign": "ok", "text": "fine", "advice": []}
