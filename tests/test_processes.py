"""How many threads linear algebra takes."""

import os
import subprocess
import sys

import pytest

from gcs_sysid.processes import ONE_THREAD

_SHOWN = """
import os, sys
from gcs_sysid.__main__ import main
assert "numpy" not in sys.modules  # which reads them when it is loaded
try:
    main(["--version"])
except SystemExit:
    pass
print([os.environ.get(name) for name in %r])
"""


@pytest.mark.parametrize(
    ("given", "taken"), [({}, ["1", "1", "1"]), ({"OPENBLAS_NUM_THREADS": "4"}, [None, "4", None])]
)
def test_commands_compute_in_one_thread_unless_the_user_says_otherwise(given, taken):
    known = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    words = [sys.executable, "-c", _SHOWN % (ONE_THREAD,)]
    done = subprocess.run(words, env=known | given, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == str(taken)
