"""Rate and attitude loops of the autopilots around an identified vehicle: margins and gains.

To add an autopilot: its law in `rate_loops` (`RateLoop.controllers`, its parameters and mixer) and,
independent of it, in `sim_bridge/rate_controllers.py`; `tests/control/test_rate_loops.py` holds the
one against the other.
"""
