"""`python -m sim_bridge`."""

import sys

from sim_bridge.cli import main as run


def main() -> None:
    """Run the command and exit with its status."""
    sys.exit(run())


if __name__ == "__main__":
    main()
