"""`python -m gcs_sysid` and the command `gcs-sysid`."""

import sys
from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    from gcs_sysid.cli.program import run
    from gcs_sysid.processes import compute_in_one_thread

    compute_in_one_thread()
    return run(sys.argv[1:] if argv is None else argv)


if __name__ == "__main__":
    sys.exit(main())
