"""What an installation holds: both commands, and every file that they read."""

import configparser
import fnmatch
import importlib.metadata
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = {"gcs_sysid": ROOT / "src" / "gcs_sysid", "sim_bridge": ROOT / "sim_bridge"}


def data_files():
    """Names in the wheel of all files of the packages that are not Python."""
    for name, folder in PACKAGES.items():
        for path in folder.rglob("*"):
            if path.is_file() and path.suffix not in (".py", ".pyc"):
                yield f"{name}/{path.relative_to(folder).as_posix()}"


def test_every_file_that_is_read_is_package_data():
    patterns = PROJECT["tool"]["setuptools"]["package-data"]["*"]
    files = list(data_files())
    assert len(files) > 20
    left_out = [
        file
        for file in files
        if not any(fnmatch.fnmatch(file.rpartition("/")[2], pattern) for pattern in patterns)
    ]
    assert left_out == []


def backend_is_good():
    """Whether the build backend that pyproject.toml asks for is installed."""
    (asked,) = PROJECT["build-system"]["requires"]
    try:
        version = importlib.metadata.version("setuptools")
    except importlib.metadata.PackageNotFoundError:
        return False
    return int(version.split(".")[0]) >= int(re.fullmatch(r"setuptools>=(\d+)", asked)[1])


@pytest.mark.slow
@pytest.mark.skipif(not backend_is_good(), reason="no build backend: pip install --group dev")
def test_the_wheel_has_both_commands_and_all_their_files(tmp_path):
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    clean = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(ROOT / "src", source / "src", ignore=clean)
    shutil.copytree(ROOT / "sim_bridge", source / "sim_bridge", ignore=clean)
    code = "import setuptools.build_meta as b, sys; b.build_wheel(sys.argv[1])"
    subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        cwd=source,
        check=True,
        capture_output=True,
        timeout=300,
    )
    (wheel,) = tmp_path.glob("*.whl")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        assert set(data_files()) <= set(archive.namelist())
        archive.extractall(site)
    commands = configparser.ConfigParser()
    commands.read(next(site.glob("*.dist-info")) / "entry_points.txt", encoding="utf-8")
    scripts = dict(commands["console_scripts"])
    assert scripts == PROJECT["project"]["scripts"]
    # From the wheel alone, elsewhere, as the scripts do it.
    tries = {"gcs-sysid": "airframe check paper", "sim-bridge": "--duration 0.1 --tlog f --truth t"}
    for script, words in tries.items():
        module, function = scripts[script].split(":")
        code = (
            f"import sys; sys.path.insert(0, {str(site)!r})\nfrom {module} import {function}\n"
            f"assert sys.modules[{module!r}].__file__.startswith({str(site)!r})\n"
            f"sys.argv[1:] = {words.split()!r}\nsys.exit({function}())"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 0, done.stderr
