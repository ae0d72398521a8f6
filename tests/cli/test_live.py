"""The headless output of `live`."""

from gcs_sysid.cli.headless import events_after
from gcs_sysid.results.snapshot import Event


def test_each_event_is_told_once_though_old_ones_are_dropped():
    kept = 5
    all_events = [Event(float(i // 3), "mark") for i in range(23)]  # equal ones are not the same
    told, last = [], None
    for n in range(0, len(all_events) + 1, 2):
        for event in events_after(last, tuple(all_events[max(0, n - kept) : n])):
            told.append(event)
            last = event
    assert [id(event) for event in told] == [id(event) for event in all_events[:22]]
