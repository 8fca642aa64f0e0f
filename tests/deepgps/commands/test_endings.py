"""How a command ends: by a signal, by a fault of its own, or without anyone who reads what it prints."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from deepgps.terminal.failures import FAULT_PREFIX, Fault, explain, working_in
from deepgps.terminal.signals import Stopped
from sim.errors import InputError, WorkError
from tests.helpers.command import MINI, deepgps, drop_progress, wait_until

LINES = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}
AGAIN = "; the same command continues where it stopped"


@pytest.fixture(scope="module")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenario") / "mini.yaml"
    path.write_text(MINI)
    return path


def start(*words: str, cwd: Path) -> subprocess.Popen[str]:
    """Start the command in a session of its own, as a terminal does."""
    command = [sys.executable, "-m", "deepgps.commands.main", *words]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # whoever starts the tests may ignore these, as a shell does for what runs in the background, and nohup
    heard = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGINT, signal.SIGHUP)}
    try:
        return subprocess.Popen(command, cwd=cwd, start_new_session=True, **pipes)
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)


def catches(process: int, number: signal.Signals) -> bool:
    """Whether a process has a handler of its own for a signal, as Python alone has none for SIGHUP."""
    status = Path(f"/proc/{process}/status").read_text().split()
    return bool(int(status[status.index("SigCgt:") + 1], 16) >> (number - 1) & 1)


def find_session(session: int) -> list[str]:
    """Processes of a session that have not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, number, *_ = path.read_text().rpartition(")")[2].split()
        except (OSError, ValueError):
            continue
        if int(number) == session and state != "Z":
            found.append(path.parent.name)
    return found


def wait_until_gone(session: int) -> bool:
    end = time.monotonic() + 5
    while find_session(session) and time.monotonic() < end:
        time.sleep(0.05)
    return not find_session(session)


@pytest.mark.parametrize(
    ("number", "seconds"),
    [(signal.SIGINT, 0.0), (signal.SIGINT, 1.0), (signal.SIGINT, 3.0), (signal.SIGTERM, 0.3), (signal.SIGHUP, 2.0)],
)
def test_a_signal_to_all_processes_is_one_line_and_leaves_none(
    mini: Path, tmp_path: Path, number: signal.Signals, seconds: float
) -> None:
    process = start("collect", str(mini), "--drive.samples", "20000", "--out", "run", cwd=tmp_path)
    wait_until(lambda: catches(process.pid, signal.SIGHUP), process)
    time.sleep(seconds)
    os.killpg(process.pid, number)
    time.sleep(0.05)
    os.killpg(process.pid, number)  # a second one changes nothing
    out, said = process.communicate(timeout=60)
    assert (process.returncode, out) == (128 + number, "")
    assert drop_progress(said) == [LINES[number] + AGAIN]
    assert wait_until_gone(process.pid)


SWALLOWING = """
import time
from deepgps.terminal import signals
signals.LIMIT_S = 0.5
signals.leave_at_signals()
signals.stop_at_signals()
while True:
    try:
        print("ready", flush=True)
        time.sleep(10)
    except KeyboardInterrupt:
        pass
"""


def test_a_signal_that_a_package_swallows_ends_the_process_a_little_later() -> None:
    command = [sys.executable, "-c", SWALLOWING]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        process.terminate()
        assert process.communicate(timeout=30)[1] == "terminated\n" and process.returncode == 143


@pytest.mark.slow
def test_a_signal_to_the_first_process_ends_all_and_counts_the_time(mini: Path, tmp_path: Path) -> None:
    process = start("collect", str(mini), "--drive.samples", "20000", "--out", "run", cwd=tmp_path)
    wait_until(lambda: list(tmp_path.glob("run/recording.collecting/*.npz")), process)
    process.terminate()
    _, said = process.communicate(timeout=60)
    assert (process.returncode, drop_progress(said)) == (143, ["terminated" + AGAIN])
    assert wait_until_gone(process.pid)
    assert "collect" in (tmp_path / "run" / "timing.json").read_text()


READERS = [
    (["--help"], ">&-", 0),
    (["--help"], "| true", 0),
    (["run", "--help"], "| head -1", 0),
    (["run", "--help"], ">/dev/full", 1),
    (["fly"], "2>&-", 2),
    (["fly"], "2>/dev/full", 2),
    (["fly"], "<&- >&-", 2),
    (["fly"], "2>&1 | true", 2),
]


@pytest.mark.parametrize(("words", "rest", "code"), READERS)
def test_output_that_nobody_reads_is_dropped(tmp_path: Path, words: list[str], rest: str, code: int) -> None:
    line = f"{sys.executable} -m deepgps.commands.main {' '.join(words)} {rest}; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == code
    assert len(done.stderr.splitlines()) <= 1 and "Errno" not in done.stderr and "ignored" not in done.stderr


@pytest.mark.parametrize("environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C"}, {"COLUMNS": "0"}])
def test_any_terminal_can_print_any_name(tmp_path: Path, environment: dict[str, str]) -> None:
    done = deepgps("run", "é空.yaml", cwd=tmp_path, **environment)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1 and ".yaml: no such file" in done.stderr


def fail(error: Exception) -> Exception:
    """The error with a traceback, as it is when it is caught."""
    try:
        raise error
    except Exception as raised:
        return raised


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (InputError("camera.rings 3"), 2, "camera.rings 3"),
        (WorkError("no renderer"), 1, "no renderer"),
        (PermissionError(13, "Permission denied", "a/b"), 1, "a/b: Permission denied"),
        (MemoryError("Unable to allocate 9 TiB"), 1, "the memory of this machine is not enough (Unable to"),
        (KeyboardInterrupt(), 130, "interrupted" + AGAIN),
    ],
)
def test_what_ends_a_command_is_said_in_one_line(error: BaseException, code: int, text: str) -> None:
    found, _, said = explain(error, ["run"])
    assert found == code and said.startswith(text) and "\n" not in said


def test_the_signal_counts_and_not_what_became_of_its_exception() -> None:
    for error in (Stopped(2), KeyboardInterrupt(), TypeError("half imported"), WorkError("died")):
        assert explain(error, ["run"], signal.SIGTERM)[::2] == (143, "terminated" + AGAIN)


def test_a_full_disk_names_the_folder_and_what_is_free(tmp_path: Path) -> None:
    with pytest.raises(Fault) as caught, working_in(tmp_path):
        raise OSError(28, "No space left on device")
    code, _, said = explain(caught.value, ["run"])
    assert code == 1 and said.startswith(f"{tmp_path}: No space left on device (") and said.endswith(" MB free)")


@pytest.mark.parametrize(
    "error", [KeyError("rms_m"), RecursionError("deep"), UnicodeDecodeError("utf-8", b"x", 0, 1, "y")]
)
def test_a_fault_says_where_its_traceback_is_and_touches_no_file(tmp_path: Path, error: Exception) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(Fault) as caught, working_in(tmp_path):
        raise error
    code, kind, said = explain(caught.value, ["run", "tiny"])
    (written,) = tmp_path.glob(f"{FAULT_PREFIX}*.txt")
    assert (code, kind) == (1, "failed") and str(written) in said and "\n" not in said
    text = written.read_text()
    assert "Traceback" in text and type(error).__name__ in text and "['run', 'tiny']" in text
    assert (tmp_path / "mine.txt").read_text() == "mine" and len(list(tmp_path.iterdir())) == 2


def test_a_fault_without_a_folder_is_written_among_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert str(tmp_path / FAULT_PREFIX) in explain(fail(ZeroDivisionError("x")), ["run"])[2]
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    assert "its traceback is lost" in explain(fail(ZeroDivisionError("x")), ["run"])[2]
