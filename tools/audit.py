"""Compare the pinned dependencies with known vulnerabilities, without a network.

    python tools/audit.py

Looks for a folder of OSV files (one JSON document a file, as an export of OSV's PyPI advisories
holds them), named by GCS_SYSID_OSV, else `osv/` in the user's cache folder. Without one it says
that it was skipped. Ends with status 1 when a pinned version is affected and not allowed below.
"""

import json
import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

VARIABLE = "GCS_SYSID_OSV"
CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"
ALLOWED: dict[str, str] = {}
"""Advisory's id -> why it does not matter here."""


def cache() -> Path:
    """Where the advisories lie."""
    named = os.environ.get(VARIABLE)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(named) if named else Path(base) / "osv"


def canonical(name: str) -> str:
    """A project's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pinned(text: str) -> dict[str, str]:
    """Project -> version of a constraints file."""
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    pairs = (line.partition("==") for line in lines if line)
    return {canonical(name): version.strip() for name, _, version in pairs}


def affects(affected: Mapping[str, Any], version: str) -> bool:
    """Whether an advisory's entry holds for a version, by OSV's rules."""
    from packaging.version import InvalidVersion, Version

    if version in affected.get("versions", ()):
        return True
    here = Version(version)
    for span in affected.get("ranges", ()):
        if span.get("type") != "ECOSYSTEM":
            continue
        hit = False
        for event in span.get("events", ()):
            (kind, at), *_ = event.items()
            try:
                reached = at == "0" or here >= Version(at)
            except InvalidVersion:
                continue
            if kind == "introduced" and reached:
                hit = True
            past = here > Version(at) if kind == "last_affected" and at != "0" else reached
            if kind in ("fixed", "last_affected") and past:
                hit = False
        if hit:
            return True
    return False


def findings(folder: Path, versions: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """(advisory's id, line) of each pinned version that an advisory names."""
    for path in sorted(folder.glob("*.json")):
        text = path.read_text(encoding="utf-8")
        advisory = json.loads(text)
        if advisory.get("withdrawn"):
            continue
        for affected in advisory.get("affected", ()):
            package = affected.get("package", {})
            name = canonical(str(package.get("name", "")))
            if package.get("ecosystem") != "PyPI" or name not in versions:
                continue
            if affects(affected, versions[name]):
                summary = advisory.get("summary") or "no summary"
                yield advisory["id"], f"{name} {versions[name]}: {advisory['id']}: {summary}"
                break


def main() -> int:
    """Print what was found; 1 when there is anything."""
    folder = cache()
    if not folder.is_dir() or not any(folder.glob("*.json")):
        print(f"audit: skipped, no advisories in {folder} ({VARIABLE} names another folder)")
        return 0
    versions = pinned(CONSTRAINTS.read_text(encoding="utf-8"))
    found = dict(findings(folder, versions))
    bad = {key: line for key, line in found.items() if key not in ALLOWED}
    for key, line in found.items():
        print(f"audit: {line}" + (f" (allowed: {ALLOWED[key]})" if key in ALLOWED else ""))
    print(f"audit: {len(versions)} pinned versions, {len(bad)} findings")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
