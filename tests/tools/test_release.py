"""Release notes from the changelog, the README of the package, the lock."""

import fnmatch
import re
import runpy
import shutil
import subprocess
from datetime import date
from pathlib import Path

import pytest
from setuptools import dist

from tools import release_notes

ROOT = Path(__file__).parents[2]
CHANGES = """# Changelog

## Unreleased

### Changed
- One [thing](docs/a.md).

- Two.

### Added
- Three.

### Changed
- Four.

## 0.1.0 - 2026-01-01

First.
"""


def test_notes_join_headings_and_lose_relative_links():
    assert release_notes.notes(CHANGES, "0.2.0") == (
        "# gcs-sysid 0.2.0\n\n## Added\n- Three.\n\n## Changed\n- One thing.\n- Two.\n- Four.\n"
    )
    assert release_notes.notes(CHANGES, "0.1.0") == "# gcs-sysid 0.1.0\n\nFirst.\n"


def test_a_release_is_cut_once_and_everywhere(tmp_path):
    (tmp_path / "src" / "gcs_sysid").mkdir(parents=True)
    (tmp_path / "CHANGELOG.md").write_text(CHANGES)
    (tmp_path / "src/gcs_sysid/__init__.py").write_text('"""x"""\n__version__ = "0.1.0"\n')
    (tmp_path / "CITATION.cff").write_text("title: x\nversion: 0.1.0\ndate-released: 2026-01-01\n")
    before = release_notes.notes(CHANGES, "0.2.0")
    release_notes.cut(tmp_path, "0.2.0", date(2026, 2, 3))
    text = (tmp_path / "CHANGELOG.md").read_text()
    assert "## Unreleased\n\n## 0.2.0 - 2026-02-03\n" in text
    assert release_notes.notes(text, "0.2.0") == before
    assert '__version__ = "0.2.0"' in (tmp_path / "src/gcs_sysid/__init__.py").read_text()
    cited = (tmp_path / "CITATION.cff").read_text()
    assert cited == "title: x\nversion: 0.2.0\ndate-released: 2026-02-03\n"
    with pytest.raises(ValueError, match="already"):
        release_notes.cut(tmp_path, "0.2.0", date(2026, 2, 3))
    with pytest.raises(ValueError, match="nothing under"):
        release_notes.cut(tmp_path, "0.3.0", date(2026, 2, 3))


def test_bad_versions_are_one_line(capsys):
    assert release_notes.main(["next"]) == 2
    assert "like 0.2.0" in capsys.readouterr().err


@pytest.fixture
def package_readme(monkeypatch):
    monkeypatch.setattr(dist.Distribution, "parse_command_line", lambda self: False)

    def readme(url="", raw=""):
        monkeypatch.setenv("GCS_SYSID_URL", url)
        monkeypatch.setenv("GCS_SYSID_RAW_URL", raw)
        monkeypatch.setattr("sys.argv", ["setup.py", "--version"])
        return runpy.run_path(str(ROOT / "setup.py"))["readme"]()

    return readme


def test_the_readme_of_the_package_needs_no_repository(package_readme):
    text = package_readme()
    assert re.findall(r"\]\((?!https?:)", text) == []
    assert "<!--" not in text
    assert "![" not in text
    whole = package_readme("https://host/x", "https://raw/x")
    assert "(https://host/x/docs/truth.md)" in whole
    assert "(https://raw/x/docs/screen.svg)" in whole
    assert re.findall(r"\]\((?!https?:)", whole) == []


def test_the_lock_has_the_pins_their_hashes_and_no_address():
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "://" not in text
    pins = set((ROOT / "constraints.txt").read_text(encoding="utf-8").lower().split())
    locked = re.findall(r"^([\w.-]+==\S+)", text, re.MULTILINE)
    assert {"numpy", "pymavlink", "textual"} <= {pin.partition("==")[0] for pin in locked}
    assert [
        pin for pin in locked if pin.replace("_", "-") not in {p.replace("_", "-") for p in pins}
    ] == []
    for block in re.split(r"^(?=[\w.-]+==)", text, flags=re.MULTILINE)[1:]:
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", block), block.splitlines()[0]


def test_the_version_is_told_alike_everywhere():
    import gcs_sysid

    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {gcs_sysid.__version__}\n" in cited


def test_every_file_of_the_top_folder_is_in_the_sdist():
    manifest = (ROOT / "MANIFEST.in").read_text(encoding="utf-8").splitlines()
    patterns = [p for line in manifest if line.startswith("include") for p in line.split()[1:]]
    # setuptools takes these unasked.
    patterns += ["pyproject.toml", "setup.py", "setup.cfg", "LICENSE", "MANIFEST.in", "PKG-INFO"]
    git = ("git", "-C", str(ROOT), "ls-files", "--", ":(glob)*")
    done = subprocess.run(git, capture_output=True, text=True) if shutil.which("git") else None
    if done is None or done.returncode:
        pytest.skip("no repository here")
    names = done.stdout.split()
    assert "pyproject.toml" in names
    assert [n for n in names if not any(fnmatch.fnmatch(n, p) for p in patterns)] == []
