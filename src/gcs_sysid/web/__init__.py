"""The screen in browsers: one session, and as many viewers as look.

The process with the session serves its snapshots on a local port (`share`). For each browser the
web server (`site`) starts a viewer: a process with the screen alone, which takes the snapshots
from there and sends back what its user does.
"""
