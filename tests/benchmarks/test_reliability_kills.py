"""The judge of recordings whose sessions were killed."""

import pytest

from benchmarks.reliability.kills import ALLOWED, judge

SENT = [(0.1 * n, f"frame {n}".encode()) for n in range(50)]
KILLED = 5.0


def judged(recorded, *, readable=True):
    return judge(3.0, KILLED, SENT, recorded, readable=readable)


def test_a_whole_recording_is_good():
    kill = judged([b"from before", *(raw for _, raw in SENT)])
    assert (kill.sent, kill.recorded, kill.missing) == (50, 50, 0.0)
    assert kill.good


@pytest.mark.parametrize(("kept", "good"), [(45, True), (41, True), (39, False), (0, False)])
def test_the_end_that_is_missing_is_measured(kept, good):
    kill = judged([raw for _, raw in SENT[:kept]])
    assert kill.recorded == kept
    assert kill.missing == pytest.approx(KILLED - SENT[kept][0])
    assert kill.good is good
    assert kill.good is (kill.missing <= ALLOWED)


def test_what_cannot_be_read_is_not_good():
    kill = judged([raw for _, raw in SENT], readable=False)
    assert kill.missing == 0.0
    assert not kill.good
