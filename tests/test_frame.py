"""What the tests stand on: a test that waits for a process without end is ended, and its processes too."""

import subprocess
import sys

import pytest

from tests.helpers.time_limit import TimeLimit


def test_a_process_that_a_test_waits_for_is_killed_after_the_limit(request: pytest.FixtureRequest):
    limit = TimeLimit(0.2)
    waiting = limit.pytest_runtest_protocol(request.node)
    next(waiting)
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
        assert process.wait(60) < 0
    with pytest.raises(StopIteration):
        waiting.send(None)
    assert "time.sleep(600)" in limit.awaited[request.node.nodeid]
