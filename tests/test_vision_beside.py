"""The second eye's thread does what it is given, one piece at a time, and hides no error."""

import threading

import pytest

from fsw.vision.beside import Beside


def test_work_is_done_on_another_thread_before_wait_returns() -> None:
    beside, where = Beside("eye"), []
    for number in range(50):
        beside.begin(lambda n: where.append((n, threading.current_thread().name)), number)
        beside.wait()
    beside.close()
    assert where == [(number, "eye") for number in range(50)]


def test_an_error_is_the_callers_and_the_next_work_is_done() -> None:
    beside, done = Beside("eye"), []

    def fail() -> None:
        raise ValueError("no image")

    beside.begin(fail)
    with pytest.raises(ValueError, match="no image"):
        beside.wait()
    beside.begin(done.append, 1)
    beside.wait()
    beside.close()
    assert done == [1]


def test_close_ends_the_thread_and_may_be_called_again() -> None:
    before = threading.active_count()
    beside = Beside("eye")
    assert threading.active_count() == before + 1
    beside.close()
    beside.close()
    assert threading.active_count() == before
