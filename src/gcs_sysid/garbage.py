"""Python's garbage collector, kept from what stays."""

import gc

_SELDOM = 100
"""Middle collections to a full one; Python's default is 10."""


def spare_what_stays() -> None:
    """Exempt all there is now from collections, and have full ones less often.

    A full collection walks all that a program holds. With a screen that took 0.1 s every ten
    seconds, in which no datagram was read and no key answered; modules and style sheets are most
    of it, and they stay. To be called by the owner of the process, once everything is loaded.
    """
    gc.collect()
    gc.freeze()
    young, middle, _ = gc.get_threshold()
    gc.set_threshold(young, middle, _SELDOM)
