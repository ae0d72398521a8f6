"""Compare the pinned dependencies with known vulnerabilities, without a network.

    python tools/audit.py [--release]

Looks for a folder of OSV files (one JSON document a file, as an export of OSV's PyPI advisories
holds them), named by GCS_SYSID_OSV, else `osv/` in the user's cache folder. Ends with status 1 when
a pinned version is affected and not allowed below. Where it cannot check (no folder, no advisory of
PyPI in it, a file that cannot be read) it says so and, with --release, ends with status 2: so too
where the newest advisory is older than 30 days before the day of the check.
"""

import argparse
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

VARIABLE = "GCS_SYSID_OSV"
CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"
ALLOWED: dict[str, str] = {}
"""Advisory's id -> why it does not matter here."""
MAX_AGE = timedelta(days=30)
"""PyPI's advisories change every day: a folder without a newer one is an old copy."""


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


def findings(advisories: list[Any], versions: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """(advisory's id, line) of each pinned version that an advisory names."""
    for advisory in advisories:
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


class CannotCheckError(Exception):
    """Nothing, or not enough, to check against."""


def read(folder: Path) -> list[Any]:
    """All advisories of a folder.

    Raises:
        CannotCheckError: there are none for PyPI, or a file is not one.
    """
    advisories = []
    for path in sorted(folder.glob("*.json")) if folder.is_dir() else []:
        try:
            advisory = json.loads(path.read_text(encoding="utf-8"))
            packages = [affected["package"] for affected in advisory.get("affected", ())]
            advisory["id"]
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise CannotCheckError(f"{path.name} is no OSV advisory ({error!r})") from error
        if any(package.get("ecosystem") == "PyPI" for package in packages):
            advisories.append(advisory)
    if not advisories:
        raise CannotCheckError(f"no advisories in {folder} ({VARIABLE} names another folder)")
    return advisories


def newest(advisories: list[Any]) -> datetime:
    """When the last of them was changed; the beginning of time where none says."""
    stamps = [datetime.fromisoformat(a["modified"]) for a in advisories if a.get("modified")]
    known = [s if s.tzinfo else s.replace(tzinfo=UTC) for s in stamps]
    return max(known, default=datetime.min.replace(tzinfo=UTC))


def main(argv: Sequence[str] = (), today: datetime | None = None) -> int:
    """Print what was found; 1 when there is anything, 2 when a release could not be checked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--release", action="store_true", help="fail where it cannot check")
    options = parser.parse_args(argv)
    try:
        advisories = read(cache())
        since = newest(advisories)
        if options.release and since < (today or datetime.now(UTC)) - MAX_AGE:
            raise CannotCheckError(
                f"the newest advisory in {cache()} is of {since:%Y-%m-%d}; "
                f"a release needs one of the last {MAX_AGE.days} days"
            )
    except CannotCheckError as problem:
        print(f"audit: {'not possible' if options.release else 'skipped'}: {problem}")
        return 2 if options.release else 0
    versions = pinned(CONSTRAINTS.read_text(encoding="utf-8"))
    found = dict(findings(advisories, versions))
    bad = {key: line for key, line in found.items() if key not in ALLOWED}
    for key, line in found.items():
        print(f"audit: {line}" + (f" (allowed: {ALLOWED[key]})" if key in ALLOWED else ""))
    print(
        f"audit: {len(versions)} pinned versions, {len(advisories)} advisories, {len(bad)} findings"
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
