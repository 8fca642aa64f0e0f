"""Web and live: the page is for this machine alone, and serves itself alone; a viewer that is mute costs little."""

import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import Running, deepgps, find_marked, finish, has_ended, start
from tests.faults.material import Material, Run, copy

LOCAL = {"0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F"}
"""127.0.0.1 and its like as /proc/net/tcp writes them."""
HOSTS = ("evil.example", "127.0.0.1.evil.example", "localhost.evil.example:{}", "evil.example:{}", "10.0.0.1:{}", "")
PATHS = (
    *("/../../../../etc/passwd", "/%2e%2e/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/..%2f..%2f..%2fetc/passwd"),
    *("/....//....//etc/passwd", "/%00/etc/passwd", "/..\\..\\etc\\passwd", "file:///etc/passwd", "/etc/passwd"),
    *("/recording.rrd", "/scenario.yaml", "/metrics.json", "/.lock", "/%252e%252e/etc/passwd"),
)
MORE_S = 2.0
SLOW = 1.5
"""How much slower the same command may be for no reason, on a busy machine."""


def list_tests(material: Material) -> list[Test]:
    """One page that is served and asked, and runs that are shown to what does not answer."""
    run = material.runs["landmarks"]
    return [
        Test("web", "view --web: where it listens", 1, _served(run, _listens)),
        Test("web", "view --web: foreign Host", 2, _served(run, _asks_as_host)),
        Test("web", "view --web: paths that lead out", 2, _served(run, _leads_out)),
        Test("web", "view --web: foreign Origin", 1, _served(run, _asks_from_elsewhere)),
        Test("web", "view --web: 60 connections that say nothing", 1, _served(run, _floods)),
        Test("web", "--live to what takes and never answers", 2, _show_to(run, _swallow), alone=True),
        Test("web", "--live to what never takes", 1, _show_to(run, lambda listener: None), alone=True),
        Test("web", "--live to what hangs up", 1, _show_to(run, _hang_up), alone=True),
        Test("web", "--live to what talks rubbish", 1, _show_to(run, _talk), alone=True),
    ]


def _served(run: Run, ask: Callable[[Case, Running, int, int], str]) -> Callable[[Case], Verdict]:
    """Serve a run, ask, end it by SIGTERM; ``ask`` (case, command, page's port, data's port) returns what is wrong."""

    def attempt(case: Case) -> Verdict:
        copy(run.stages["finished"], case.folder / "run")
        running = start(["view", "run", "--web"], cwd=case.folder)
        try:
            ports = _wait_for_ports(running)
            wrong = ask(case, running, *ports) if ports else "no address within a minute"
        finally:
            running.process.send_signal(signal.SIGTERM)
            ended = finish(running, time_s=90.0)
        if wrong or ended.left or "Traceback" in ended.text:
            kind, _, detail = (wrong or "process left behind or traceback").partition(": ")
            return Verdict(kind, False, f"{detail}; {ended.show()}")
        return Verdict("as it should be", True)

    return attempt


def _wait_for_ports(running: Running) -> tuple[int, int] | None:
    end = time.monotonic() + 60
    while time.monotonic() < end and not has_ended(running):
        found = re.search(r"http://127\.0\.0\.1:(\d+)/\S*127\.0\.0\.1%3A(\d+)", running.out.read_text())
        if found:
            return int(found[1]), int(found[2])
        time.sleep(0.1)
    return None


def _listens(case: Case, running: Running, page: int, data: int) -> str:
    inodes = {inode for pid in find_marked(running.mark) for inode in _sockets(pid)}
    found = []
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            local, state, inode = (line.split()[n] for n in (1, 3, 9))
            if inode in inodes and (state == "0A" or table.startswith("udp")):
                found.append(local)
    if len(found) < 2:
        return f"not found: listens at {len(found)} places, not at page and data"
    return "".join(f"listens to others: {local} " for local in found if local.split(":")[0] not in LOCAL)


def _sockets(pid: int) -> Iterator[str]:
    with suppress(OSError):
        for handle in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                if found := re.match(r"socket:\[(\d+)\]", str(handle.readlink())):
                    yield found[1]


def _asks_as_host(case: Case, running: Running, page: int, data: int) -> str:
    own = _request(page, "/", f"Host: 127.0.0.1:{page}")
    if " 200 " not in own.partition("\r\n")[0]:
        return f"the page does not answer: {own[:80]!r}"
    for host in HOSTS:
        said = _request(page, "/", f"Host: {host.format(page)}")
        if " 200 " in said.partition("\r\n")[0]:
            return f"a foreign Host gets the page: {host!r}"
    return ""


def _leads_out(case: Case, running: Running, page: int, data: int) -> str:
    for path in case.rng.sample(PATHS, 9):
        for port in (page, data):
            said = _request(port, path, f"Host: 127.0.0.1:{port}")
            if "root:" in said or (" 200 " in said.partition("\r\n")[0] and port == page):
                return f"a path gets a file: {path} at port {port}, {said[:60]!r}"
    return ""


def _asks_from_elsewhere(case: Case, running: Running, page: int, data: int) -> str:
    for port in (page, data):
        for kind in ("GET", "OPTIONS", "POST"):
            asked = "Origin: http://evil.example\r\nAccess-Control-Request-Method: POST"
            said = _request(port, "/", f"Host: 127.0.0.1:{port}\r\n{asked}", kind).lower()
            if re.search(r"access-control-allow-origin: *(\*|http://evil)", said):
                return f"a foreign Origin is allowed: {kind} at port {port}"
    return ""


def _floods(case: Case, running: Running, page: int, data: int) -> str:
    idle = [socket.create_connection(("127.0.0.1", page), 5) for _ in range(60)]
    try:
        said = _request(page, "/", f"Host: 127.0.0.1:{page}")
        return "" if " 200 " in said.partition("\r\n")[0] else "the page no longer answers"
    finally:
        for one in idle:
            one.close()


def _request(port: int, path: str, headers: str, kind: str = "GET") -> str:
    """What the server answers, the first of it; empty where it hangs up."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), 10) as line:
        line.settimeout(10)
        line.sendall(f"{kind} {path} HTTP/1.1\r\n{headers}\r\nConnection: close\r\n\r\n".encode())
        return line.recv(4000).decode(errors="replace")
    return ""


def _show_to(run: Run, answer: Callable[[socket.socket], None]) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        for name in ("plain", "shown"):
            copy(run.stages["trained"], case.folder / name)
        plain = deepgps("evaluate", run.source, "--out", "plain", cwd=case.folder)
        with _listening(answer) as port:
            words = ["evaluate", run.source, "--out", "shown", "--live", f"127.0.0.1:{port}"]
            shown = deepgps(*words, cwd=case.folder)
        more = shown.wall_s - plain.wall_s
        detail = f"{more:+.1f} s: {shown.show()}"
        if shown.fell:
            return Verdict(shown.fell, False, detail)
        if shown.wall_s > SLOW * plain.wall_s + MORE_S:
            return Verdict(f"{more:.0f} s more", False, detail)
        return Verdict("goes on" if shown.code == 0 else "refused", True)

    return attempt


@contextmanager
def _listening(answer: Callable[[socket.socket], None]) -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=answer, args=(listener,), daemon=True).start()
        yield listener.getsockname()[1]


def _swallow(listener: socket.socket) -> None:
    lines = []
    with suppress(OSError):
        while True:
            lines.append(listener.accept())


def _hang_up(listener: socket.socket) -> None:
    with suppress(OSError):
        while True:
            listener.accept()[0].close()


def _talk(listener: socket.socket) -> None:
    with suppress(OSError):
        while True:
            line = listener.accept()[0]
            line.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 999999\r\n\r\n" + b"\xff\x00rubbish" * 500)
