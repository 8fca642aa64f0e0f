"""A plugin of pytest: processor time of each quick test; one that takes too long fails the session.

Counted are the setup and the call, this process's threads and the processes that it has waited for, but not
the fixtures that all files share, which are made by whichever test comes first.
"""

import os
from collections.abc import Iterator

import pytest

LISTED_S, ALLOWED_S = 5.0, 15.0
SHARED_BY_ALL = "tests/conftest.py"


def processor_s() -> float:
    """Processor time of this process and of the ended ones that it started [s]."""
    return sum(os.times()[:4])


class ProcessorTime:
    """Measures each test where it runs, and judges all of them where pytest was started."""

    def __init__(self) -> None:
        self.shared_s = 0.0
        self.slowest: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef) -> Iterator[None]:
        start = processor_s()
        try:
            return (yield)
        finally:
            if fixturedef.scope == "session" and fixturedef.func.__code__.co_filename.endswith(SHARED_BY_ALL):
                self.shared_s += processor_s() - start

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self.measure(item))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        return (yield from self.measure(item))

    def measure(self, item: pytest.Item) -> Iterator[None]:
        """Add what happens in between to the properties of a test, which xdist's workers report."""
        start, shared = processor_s(), self.shared_s
        try:
            return (yield)
        finally:
            took = processor_s() - start - (self.shared_s - shared)
            item.user_properties.append(("processor_s", took))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown" and "slow" not in report.keywords:
            taken = (took for name, took in report.user_properties if name == "processor_s")
            self.slowest[report.nodeid] = sum(took for took in taken if isinstance(took, float))

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        quick = session.config.option.markexpr == "not slow"
        if quick and session.exitstatus == pytest.ExitCode.OK and max(self.slowest.values(), default=0.0) > ALLOWED_S:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        listed = sorted(((took, name) for name, took in self.slowest.items() if took > LISTED_S), reverse=True)
        if listed:
            terminalreporter.section("processor time of tests that are not marked slow")
        for took, name in listed:
            fails = f": mark it slow, as it takes more than {ALLOWED_S:.0f} s" if took > ALLOWED_S else ""
            terminalreporter.line(f"{took:5.1f} s {name}{fails}")
