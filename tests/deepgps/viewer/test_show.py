"""The viewer by Rerun's program: for this machine alone, ended with its command; a picture shows the error field."""

import os
import shutil
import signal
import socket
import sys
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import psutil
import pytest
from PIL import Image

from deepgps.evaluation.error_field import read_all_headings, split_by_acceptance
from deepgps.reports.plots import colours_of
from deepgps.runs.run_folder import VIEWED
from deepgps.viewer import connect
from deepgps.viewer.connect import HOST, open_viewer, start_viewer, wait_for_port
from deepgps.viewer.run import write_run
from deepgps.viewer.show import choose_ports, choose_tab, serve
from sim.errors import InputError, WorkError
from tests.helpers.command import deepgps_here, read_line, started
from tests.helpers.synthetic_run import write_synthetic_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic_run(tmp_path_factory.mktemp("run"), samples=60, spacing_m=0.4)


def listening(process: int) -> set[tuple[str, int]]:
    """Addresses at which a process and those that it started listen."""
    family = [psutil.Process(process), *psutil.Process(process).children(recursive=True)]
    found = [one.laddr for member in family for one in member.net_connections("tcp") if one.status == "LISTEN"]
    return {(address.ip, address.port) for address in found}


def test_a_page_and_its_data_are_for_this_machine_alone_and_end_with_what_serves_them(run: Path) -> None:
    page = next(port for port in range(20000, 60000, 10) if is_free(port) and is_free(port + 1))
    before, addresses, family = listening(os.getpid()), [], set()
    others = set(psutil.Process().children(recursive=True))

    def look(said: str) -> None:
        address = said.splitlines()[0].removeprefix("open ")
        assert address == f"http://{HOST}:{page}/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{page + 1}%2Fproxy&theme=dark"
        assert listening(os.getpid()) - before == {(HOST, page), (HOST, page + 1)}
        with urlopen(address, timeout=30) as answer:
            assert answer.status == 200 and b"re_viewer" in answer.read()
        addresses.append(address)
        family.update(set(psutil.Process().children(recursive=True)) - others)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        serve([run], choose_ports(page), look)
    assert family and not any(map(psutil.Process.is_running, family))
    with pytest.raises(URLError):
        urlopen(addresses[0], timeout=5)


@pytest.mark.slow
def test_ctrl_c_ends_the_command_and_the_viewer(run: Path) -> None:
    with started(sys.executable, "-m", "deepgps.commands.main", "view", str(run), "--web") as process:
        assert read_line(process, "the address of the page").startswith(f"open http://{HOST}:")
        family = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 128 + signal.SIGINT
        assert process.stderr and process.stderr.read() == "interrupted\n"
        assert family and not any(map(psutil.Process.is_running, family))


def is_free(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex((HOST, port)) != 0


def test_every_viewer_listens_at_this_machine_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whatever starts one names its address, and with that address it listens nowhere else."""
    port = connect.find_free_port()
    with start_viewer(port, ["--serve-grpc"], "") as viewer:
        wait_for_port(port, viewer)
        assert listening(viewer.pid) == {(HOST, port)}
    assert is_free(port)
    said = tmp_path / "said"
    program = tmp_path / "rerun"
    program.write_text(f'#!/bin/sh\necho "$@" >> {said}\nexit 1\n')
    program.chmod(0o755)
    monkeypatch.setattr(connect, "find_viewer", lambda: str(program))
    monkeypatch.setenv("DISPLAY", ":99")
    with pytest.raises(WorkError):
        open_viewer()
    with pytest.raises(WorkError), start_viewer(port, [], "") as viewer:
        viewer.wait(30)
    assert [line.startswith(f"--bind {HOST} --port ") for line in said.read_text().splitlines()] == [True, True]


def test_a_viewer_that_fails_is_one_line_with_its_reason_and_a_cure(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\necho warning >&2; echo 'Error: no adapter' >&2; echo help >&2; exit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr(connect, "find_viewer", lambda: str(program))
    with pytest.raises(WorkError) as caught, start_viewer(1, [], "do this") as viewer:
        viewer.wait(30)
    assert str(caught.value) == "the Rerun viewer exited with code 3 (Error: no adapter); do this"


def test_what_is_not_possible_is_one_clear_line(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(run)
    cut = Path(shutil.copytree(run, tmp_path / "cut")) / VIEWED
    cut.write_bytes(cut.read_bytes()[:-1000])
    cut.with_name(f"{VIEWED}.sha256").unlink()  # as a version before checksums left it
    mine, nothing = tmp_path / "mine.png", tmp_path / "nothing"
    nothing.mkdir()
    mine.write_bytes(b"\x89PNG mine")
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent")
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nonexistent")
    with socket.create_server((HOST, 0)) as taken:
        port = str(taken.getsockname()[1])
        for code, words, said in (
            (
                2,
                (run, "--web", "--port", port),
                f"--port {port}: port {port} is not available (Address already in use)",
            ),
            (2, (run, "--web", "--port", str(int(port) - 1)), f"port {port} is not available"),
            (2, (run, "--port", "9090"), "--port needs --web"),
            (2, (run, "--tab", "drive"), "--tab needs --screenshot"),
            (2, (nothing, "--web"), f"{nothing} is no run folder"),
            (2, (cut.parent, "--web"), "run.rrd is truncated or no recording"),
            (2, (run, "--screenshot", mine), "mine.png exists, and deepgps did not write it"),
            (1, (run, "--screenshot", tmp_path / "new.png"), "Vulkan driver, such as Mesa's: apt-get install mesa-vul"),
        ):
            done = deepgps_here("view", *map(str, words), cwd=tmp_path)
            assert done.returncode == code and len(done.stderr.splitlines()) == 1 and said in done.stderr, done.stderr
    assert mine.read_bytes() == b"\x89PNG mine" and not (tmp_path / "new.png").exists()
    for number in (0, -1, 65535, 70000):
        with pytest.raises(InputError, match="must be between 1 and 65534"):
            choose_ports(number)


def test_any_tab_is_brought_to_the_front_and_an_unknown_one_is_refused_with_those_there_are() -> None:
    tabs = {"contents": ["container/1", "view/2"], "active_tab": "container/1"}
    layout = {
        "/viewport": {"ViewportBlueprint": {"root_container": "0"}},
        "/container/0": {"ContainerBlueprint": tabs},
        "/container/1": {"ContainerBlueprint": {"display_name": "Error field"}},
        "/view/2": {"ViewBlueprint": {"display_name": "Distribution of errors"}},
    }
    for name, front in (("distribution of errors", "view/2"), ("Error field", "container/1"), (None, "container/1")):
        choose_tab(layout, name)
        assert tabs["active_tab"] == front
    with pytest.raises(InputError, match="--tab drive: there is no such tab; there are error field, distribution of e"):
        choose_tab(layout, "drive")


@pytest.mark.slow
@pytest.mark.skipif(
    not list(Path("/usr/share/vulkan").glob("icd.d/*.json")), reason="no Vulkan driver: mesa-vulkan-drivers"
)
def test_a_picture_shows_the_error_field(tmp_path: Path) -> None:
    run, out = write_synthetic_run(tmp_path / "run", samples=60), tmp_path / "out.png"
    done = deepgps_here("view", str(run), "--screenshot", str(out), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    picture = np.asarray(Image.open(out).convert("RGB"))
    assert picture.shape == (1000, 1600, 3)
    accepted, _ = split_by_acceptance(read_all_headings(run)["deepgps"])
    colours = np.unique(colours_of(accepted.error)[:, :3], axis=0).astype(int) // 4
    above_the_strip = picture[125:750, :1066].reshape(-1, 3).astype(int) // 4
    there = {tuple(colour) for colour in np.unique(above_the_strip, axis=0)}
    assert len(colours) > 50 and np.mean([tuple(colour) in there for colour in colours]) > 0.6
    pair = (str(run), str(write_synthetic_run(tmp_path / "other", samples=60)))  # a recording without a timeline
    done = deepgps_here("view", *pair, "--screenshot", str(tmp_path / "pair.png"), cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "pair.png").is_file(), done.stderr
    if folder := os.environ.get("SCREENSHOTS"):  # to look at
        shutil.copy(out, folder)
