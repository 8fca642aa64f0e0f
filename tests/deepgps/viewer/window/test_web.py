"""The viewer in a browser: served to this machine alone, ended by Ctrl-C, and a real Chromium shows the error field."""

import io
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from http.client import HTTPConnection
from itertools import product
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image

from deepgps.commands.main import main
from deepgps.evaluation.error_field import read_all_headings, split_by_acceptance
from deepgps.reports.plots import COLOURS, colours_of
from deepgps.viewer.run.recording import RECORDING, write_run
from deepgps.viewer.window import chromium, screenshot
from deepgps.viewer.window.chromium import NAMES, find_chromium, open_page
from deepgps.viewer.window.connect import HOST, find_free_port
from deepgps.viewer.window.web import choose_ports
from sim.errors import InputError, WorkError
from tests.helpers.synthetic_run import write_synthetic_run

PICTURE_TIME_S = 300  # the page is 50 MB of WebAssembly, drawn by the processor


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_synthetic_run(tmp_path_factory.mktemp("run"), samples=60, spacing_m=0.16)
    write_run(folder)
    return folder


@contextmanager
def served(*words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Address and process of ``deepgps view`` with these words; ended when left."""
    command = [sys.executable, "-m", "deepgps.commands.main", "view", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout
            address = re.match(r"open (http://127\.0\.0\.1:\d+/\?url=\S+)\n", process.stdout.readline())
            assert address, process.stderr.read() if process.stderr else ""
            yield address[1], process
        finally:
            process.send_signal(signal.SIGTERM)


def find_pair() -> int:
    """A free port whose next one is free too."""
    while True:
        with suppress(InputError):
            return choose_ports(find_free_port())[0]


def port_of(address: str) -> int:
    return int(address.removeprefix(f"http://{HOST}:").partition("/")[0])


def test_it_is_served_until_it_is_interrupted(run: Path) -> None:
    with served(str(run), "--web") as (address, process):
        with urlopen(address, timeout=30) as page:
            assert page.status == 200 and b"re_viewer" in page.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 128 + signal.SIGINT
        assert process.stderr and process.stderr.read() == "interrupted\n"
    with pytest.raises(URLError):
        urlopen(address, timeout=5)


@pytest.fixture(scope="module")
def wanted(run: Path) -> Iterator[tuple[int, str]]:
    """A port that was wanted, and the address of the run that is served there."""
    port = find_pair()
    with served(str(run), "--web", "--port", str(port)) as (address, _):
        yield port, address


@pytest.fixture(scope="module")
def ports(wanted: tuple[int, str]) -> tuple[int, int]:
    """Ports of its page and data."""
    return wanted[0], wanted[0] + 1


def test_a_port_can_be_wanted_and_nothing_else_listens(wanted: tuple[int, str]) -> None:
    port, address = wanted
    assert port_of(address) == port and f"%3A{port + 1}%2Frecording.rrd" in address
    # the second is this machine too, and answers for a server that listens at every address
    others = {socket.gethostbyname(socket.gethostname()), "127.0.0.2"}
    for other in others - {HOST}:
        with pytest.raises(OSError):
            socket.create_connection((other, port), 2)


def ask(port: int, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and body of an answer to a request with exactly these headers."""
    connection = HTTPConnection(HOST, port, timeout=30)
    with closing(connection):
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()


def test_page_and_data_are_whole(run: Path, ports: tuple[int, int]) -> None:
    page, data = ports
    status, headers, wasm = ask(page, "/re_viewer_bg.wasm", Host=f"localhost:{page}")
    assert (status, headers["content-type"], wasm[:4]) == (200, "application/wasm", b"\0asm")
    _, headers, body = ask(data, "/recording.rrd", Host=f"{HOST}:{data}")
    assert body == (run / RECORDING).read_bytes()
    status, head, body = ask(data, "/recording.rrd", "HEAD", Host=f"{HOST}:{data}")
    assert (status, head["content-length"], body) == (200, headers["content-length"], b"")


def test_a_foreign_host_gets_neither_page_nor_data(ports: tuple[int, int]) -> None:
    for name in ("evil.example", "evil.example:{}", "127.0.0.1", "127.0.0.1:80", "[::1]:{}", "", None):
        for port, path in zip(ports, ("/", "/recording.rrd"), strict=True):
            headers = {} if name is None else {"Host": name.format(port)}
            status, _, body = ask(port, path, **headers)
            assert status == 421 and len(body) < 1000, name


def test_two_hosts_in_one_request_are_refused(ports: tuple[int, int]) -> None:
    page, _ = ports
    with socket.create_connection((HOST, page), 30) as connection:
        connection.sendall(f"GET / HTTP/1.1\r\nHost: {HOST}:{page}\r\nHost: evil.example\r\n\r\n".encode())
        assert b" 421 " in connection.recv(100)


def test_nothing_else_is_served(ports: tuple[int, int]) -> None:
    paths = [
        "/../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/scenario.yaml",
        "/recording.rrd/..",
        "/no",
    ]
    for port, path in product(ports, paths):
        assert ask(port, path, Host=f"{HOST}:{port}")[0] == 404, path


def test_data_is_for_the_page_alone(ports: tuple[int, int]) -> None:
    page, data = ports
    for origin, allowed in ((f"http://{HOST}:{page}", True), ("http://evil.example", False), ("null", False)):
        _, headers, _ = ask(data, "/recording.rrd", "HEAD", Host=f"{HOST}:{data}", Origin=origin)
        assert (headers.get("access-control-allow-origin") == origin) == allowed
        assert ("access-control-allow-origin" in headers) == allowed


def test_the_page_may_load_nothing_from_elsewhere(ports: tuple[int, int]) -> None:
    page, data = ports
    _, headers, _ = ask(page, "/", Host=f"{HOST}:{page}")
    sources = {word for word in headers["content-security-policy"].replace(";", "").split() if "http" in word}
    assert sources == {f"http://{HOST}:{data}"}


def test_a_reader_that_goes_away_disturbs_nothing(run: Path) -> None:
    page = find_pair()
    with served(str(run), "--web", "--port", str(page)) as (_, process):
        for _ in range(3):
            with socket.create_connection((HOST, page), 30) as connection:
                connection.sendall(f"GET /re_viewer_bg.wasm HTTP/1.1\r\nHost: {HOST}:{page}\r\n\r\n".encode())
                connection.recv(10)
        assert ask(page, "/", Host=f"{HOST}:{page}")[0] == 200
        process.terminate()
        assert process.stderr and process.stderr.read() == "terminated\n"


def fail_to_view(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What the command says on stderr when its input is wrong."""
    with pytest.raises(SystemExit) as ended:
        main(["view", *words])
    assert ended.value.code == 2
    return capsys.readouterr().err


def test_what_is_not_possible_is_one_clear_line(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut = Path(shutil.copytree(run, tmp_path / "cut")) / RECORDING
    cut.write_bytes(cut.read_bytes()[:-1000])
    cut.with_name(f"{RECORDING}.sha256").unlink()  # as a version before checksums left it
    mine, nothing = tmp_path / "mine.png", tmp_path / "nothing"
    nothing.mkdir()
    mine.write_bytes(b"\x89PNG mine")
    with socket.create_server((HOST, 0)) as taken:
        port = str(taken.getsockname()[1])
        for words, said in (
            ((run, "--web", "--port", port), f"--port {port}: port {port} is not available (Address already in use)"),
            ((run, "--web", "--port", str(int(port) - 1)), f"port {port} is not available"),
            ((run, "--port", "9090"), "--port needs --web"),
            ((nothing, "--web"), f"{nothing} is no run folder"),
            ((cut.parent, "--web"), "run.rrd is truncated or no recording"),
            ((run, "--screenshot", mine), "mine.png exists, and deepgps did not write it"),
        ):
            with pytest.raises(SystemExit) as ended:
                main(["view", *map(str, words)])
            error = capsys.readouterr().err
            assert ended.value.code == 2 and len(error.splitlines()) == 1 and said in error, error
    assert mine.read_bytes() == b"\x89PNG mine"


def test_a_port_out_of_range_is_refused() -> None:
    for port in (0, -1, 65535, 70000):
        with pytest.raises(InputError, match="must be between 1 and 65534"):
            choose_ports(port)


def find_colours(run: Path) -> np.ndarray:
    """The colours (n, 3) of the accepted errors of DeepGPS."""
    accepted, _ = split_by_acceptance(read_all_headings(run)["deepgps"])
    return np.unique(colours_of(accepted.error)[:, :3], axis=0)


def shown_colours(picture: np.ndarray, colours: np.ndarray) -> float:
    """The share of colours (n, 3) that the middle of a picture (rows, columns, 3) has, above the scale's strip."""
    rows, columns, _ = picture.shape
    middle = picture[rows // 8 : 3 * rows // 4, : 2 * columns // 3].reshape(-1, 3).astype(int)
    there = {tuple(colour) for colour in np.unique(middle, axis=0) // 4}
    return float(np.mean([tuple(colour) in there for colour in colours.astype(int) // 4]))


@pytest.mark.slow
@pytest.mark.skipif(find_chromium() is None, reason=f"no Chromium: there is no command {', '.join(NAMES)}")
def test_chromium_shows_the_error_field(run: Path, tmp_path: Path) -> None:
    colours = find_colours(run)
    assert len(colours) > 50
    shown, png, picture = 0.0, b"", np.zeros((1, 1, 3))
    with served(str(run), "--web") as (address, _), open_page(address, tmp_path / "profile") as take_picture:
        end = time.monotonic() + PICTURE_TIME_S
        while shown <= 0.6 and time.monotonic() < end:
            time.sleep(2)
            if png := take_picture():
                picture = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
                shown = shown_colours(picture, colours)
    assert picture.shape == (900, 1600, 3)
    assert shown > 0.6
    assert shown_colours(np.zeros_like(picture), colours) == 0.0, "a blank page shows none"
    if folder := os.environ.get("SCREENSHOTS"):  # to look at, and for the README
        (Path(folder) / "web.png").write_bytes(png)


def test_a_screenshot_without_chromium_and_display_says_what_to_install(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(screenshot, "find_chromium", lambda: None)
    monkeypatch.setattr(screenshot.shutil, "which", lambda name: None)
    with pytest.raises(SystemExit) as caught:
        main(["view", str(run), "--screenshot", str(tmp_path / "out.png")])
    said = capsys.readouterr().err
    assert caught.value.code == 1
    assert len(said.splitlines()) == 1 and "install chromium, or xvfb and mesa-vulkan-drivers" in said
    assert not (tmp_path / "out.png").exists()


def fake_chromium(script: str, answer_s: float, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = folder / "chromium"
    program.write_text(f"#!{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(chromium, "find_chromium", lambda: str(program))
    monkeypatch.setattr(chromium, "ANSWER_S", answer_s)


@pytest.mark.parametrize(("script", "says"), [("exit 3", "has ended"), ("exec sleep 60", "hangs: no answer in 0.5 s")])
def test_a_chromium_that_ends_or_hangs_is_one_line_with_a_cure(
    script: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_chromium(f"/bin/sh\n{script}", 0.5, tmp_path, monkeypatch)
    says = rf"^Chromium {says}; .*/chromium --headless=new .* may say why"
    with pytest.raises(WorkError, match=says), open_page("about:blank", tmp_path / "profile"):
        pytest.fail("there is no page")


ANSWERS = """
import base64, json, os
held = b""
while part := os.read(3, 1 << 16):
    held += part
    *messages, held = held.split(b"\\0")
    for message in map(json.loads, messages):
        picture = base64.b64encode(b"picture of " + message["method"].encode()).decode()
        result = {"targetId": "target", "sessionId": "session", "data": picture}
        os.write(4, json.dumps({"id": message["id"], "result": result}).encode() + b"\\0")
"""


def test_a_picture_comes_as_soon_as_chromium_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_chromium(f"{sys.executable}\n{ANSWERS}", 20.0, tmp_path, monkeypatch)
    with open_page("about:blank", tmp_path / "profile") as take_picture:
        assert take_picture() == b"picture of Page.captureScreenshot"


def test_a_picture_counts_as_drawn_once_it_shows_a_scale() -> None:
    strip = (255 * COLOURS(np.linspace(0, 1, 400))[None, :, :3]).astype(np.uint8)
    picture = np.full((60, 400, 3), 13, np.uint8)
    assert not screenshot.shows_scale(picture)
    picture[30:32] = strip
    assert screenshot.shows_scale(picture)


@pytest.mark.slow
@pytest.mark.skipif(find_chromium() is None, reason=f"no Chromium: there is no command {', '.join(NAMES)}")
def test_a_screenshot_shows_the_error_field(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    main(["view", str(run), "--screenshot", str(out)])
    picture = np.asarray(Image.open(out).convert("RGB"))
    assert picture.shape == (1000, 1600, 3)
    colours = find_colours(run)
    assert shown_colours(picture, colours) > 0.6
