"""A plugin of pytest: no test waits for ever for a process, whose end it would otherwise await without a limit."""

import shlex
from collections.abc import Iterator
from contextlib import suppress
from threading import Timer

import psutil
import pytest

LIMIT_S = 900.0
"""Longest wall time of a test with its fixtures, on the slowest and busiest machine."""


class TimeLimit:
    """Kills the processes of a test that takes too long, so that it goes on; it fails, and names them."""

    def __init__(self, limit_s: float = LIMIT_S) -> None:
        self.limit_s = limit_s
        self.awaited: dict[str, str] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        timer = Timer(self.limit_s, self.end_processes, [item])
        timer.daemon = True
        timer.start()
        try:
            return (yield)
        finally:
            timer.cancel()

    def end_processes(self, item: pytest.Item) -> None:
        """Kill all processes below this one."""
        lines = [f"took longer than {self.limit_s:.0f} s, with these processes under way, which were killed:"]
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                lines.append(shlex.join(process.cmdline()))
                process.kill()
        self.awaited[item.nodeid] = "\n".join(lines)
        item.add_report_section("call", "time limit", self.awaited[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        result = yield
        if item.nodeid in self.awaited:
            pytest.fail(self.awaited[item.nodeid])
        return result
