"""Work in steps: its order, its bound, and that it can be left."""

import pytest

from gcs_sysid.steps import Pending, finished


def work(name, log, steps=3):
    for step in range(steps):
        log.append((name, step))
        yield
    log.append((name, "done"))


def test_the_outcome_comes_after_the_last_step():
    def counting():
        for _ in range(3):
            yield
        return 7

    assert finished(counting()) == 7


def test_steps_are_done_one_by_one_in_order():
    log, pending = [], Pending(3)
    assert not pending.step()
    pending.add(work("a", log, 1))
    pending.add(work("b", log, 1))
    seen = []
    while pending.step():
        seen.append(len(log))
    assert seen == [1, 2, 3]
    assert log == [("a", 0), ("a", "done"), ("b", 0), ("b", "done")]


def test_beyond_the_bound_the_oldest_is_finished_at_once():
    log, pending = [], Pending(2)
    for name in "abc":
        pending.add(work(name, log))
    assert log[-1] == ("a", "done")
    assert all(name == "a" for name, _ in log)
    pending.finish()
    assert log[-1] == ("c", "done")
    assert not pending


def test_what_is_dropped_is_not_done():
    log, pending = [], Pending(2)
    pending.add(work("a", log))
    pending.step()
    pending.drop()
    assert not pending
    assert not pending.step()
    assert log == [("a", 0)]


def test_what_fails_is_left_and_the_rest_goes_on():
    def failing():
        yield
        raise ArithmeticError

    log, pending = [], Pending(2)
    pending.add(failing())
    pending.add(work("b", log))
    pending.step()
    with pytest.raises(ArithmeticError):
        pending.step()
    pending.finish()
    assert log[-1] == ("b", "done")
