"""Write requirements.lock: the program's dependencies with the hashes of all their files.

    python tools/lock.py

Versions are those of constraints.txt. The lock holds every file that an index has of a version,
for each system and Python, and no address: pip takes the files from the user's own index and
refuses others. To install by it:

    pip install --require-hashes -r requirements.lock
    pip install --no-deps gcs-sysid
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
HEAD = """\
# All files of the program's dependencies by their hashes, for every system; by: make lock
# pip install --require-hashes -r requirements.lock
"""


def main() -> int:
    """Resolve and write; 2 where that failed."""
    done = subprocess.run(
        [
            *(sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--universal"),
            *("--generate-hashes", "--no-header", "--no-annotate"),
            *("--python-version", "3.11"),
            *("--constraint", "constraints.txt", "pyproject.toml"),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        print(f"lock: {done.stderr.strip()}", file=sys.stderr)
        return 2
    if "://" in done.stdout:
        print("lock: an address is in it; nothing was written", file=sys.stderr)
        return 2
    LOCK.write_text(HEAD + done.stdout, encoding="utf-8", newline="\n")
    print(f"{LOCK.name}: {done.stdout.count('==')} projects, {done.stdout.count('--hash')} files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
