"""The clock that limits are read from, and another in its place."""

from __future__ import annotations

import re
import threading
import time
from pathlib import Path

import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from lin_freq_ocp.base import now, use_clock


def test_by_itself_it_is_that_of_the_system():
    with use_clock(time.perf_counter):  # as without the suite's
        before, between, after = time.perf_counter(), now(), time.perf_counter()
    assert before <= between <= after


def test_another_clock_is_read_by_all_threads_until_it_is_taken_away():
    seen = []
    with use_clock(Clock(2.0)):
        thread = threading.Thread(target=lambda: seen.append(now()))
        thread.start()
        thread.join()
        with use_clock(Clock(0.5)):
            seen.append(now())
        seen.append(now())
    assert seen == [2.0, 0.5, 4.0]


def test_after_an_error_the_clock_before_is_back():
    with use_clock(Clock(3.0)):
        with pytest.raises(ZeroDivisionError), use_clock(Clock(1.0)):
            raise ZeroDivisionError
        assert now() == 3.0


def test_nothing_else_in_the_package_reads_the_time():
    package = Path(lfo.__file__).parent
    readers = [
        path for path in package.rglob("*.py") if re.search(r"^import time$|^from time ", path.read_text(), re.M)
    ]
    assert [str(path.relative_to(package)) for path in readers] == ["base/clock.py"]
