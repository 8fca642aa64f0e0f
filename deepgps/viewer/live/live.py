"""Showing a run while it runs: a thread sends a viewer what the stages tell and write.

The stages know nothing of it: it hears what they tell the progress bars, asks a training for its history now and then,
and reads what lies in the run folder. Whatever becomes of the viewer, the run goes on.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import rerun as rr

from deepgps.progress import Look, Report
from deepgps.scenario import Scenario
from deepgps.viewer.live.view import LiveView
from deepgps.viewer.window.connect import ANSWER_S, find_url, knock, open_viewer
from sim.errors import InputError, one_line

APPLICATION = "deepgps live"  # apart from recordings, whose blueprint it would replace
GONE = (RuntimeError, ConnectionError)
"""What rerun raises when the viewer is gone."""
PERIOD_S = 1.0
STALL_S = 10.0
"""How long a viewer may take nothing."""
PATIENCE_S = 20.0
"""How long a finished run waits for a viewer that answers, but is slow, to take the rest."""
LOOK_S = 0.4
"""How often it is asked meanwhile whether it answers."""


@contextmanager
def show_live(
    address: str, scenario: Scenario, folder: Path, progress: Report, warn: Callable[[str], None]
) -> Iterator[Report]:
    """Stream a run to a viewer while it runs.

    Args:
        address: Of a viewer that stands, host:port or Rerun's URL; empty: one is opened, and stays open.
        scenario: What is run.
        folder: The run folder.
        progress: Told on what the stages tell.
        warn: Told in one line when the viewer goes away.

    Yields:
        Whom the stages shall tell.

    Raises:
        InputError: The address is wrong, or no viewer answers there.
        WorkError: No viewer can be opened.
    """
    url = find_url(address) if address else open_viewer()
    who = knock(url)
    if who == "stranger":
        raise InputError(f"--live {address}: what answers there is no Rerun viewer")
    if who == "nobody":
        warn(f"the viewer at {address} does not answer within {ANSWER_S} s; the run goes on without it")
        yield progress
        return
    by_hand = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))  # flushed at each look
    stream = rr.RecordingStream(APPLICATION, send_properties=False, batcher_config=by_hand)
    stream.connect_grpc(url)
    view = LiveView(stream, scenario, folder)
    _check(stream, address)
    ended, lost, heard = threading.Event(), threading.Event(), 0.0
    thread = threading.Thread(target=_send, args=(stream, view, ended, lost, warn), daemon=True)

    def begin() -> None:
        if thread.ident is None:
            thread.start()

    def report(label: str, done: int, total: int, look: Look | None = None) -> None:
        nonlocal heard
        progress(label, done, total, look)
        view.steps[label] = (done, total)
        if look is not None and (time.monotonic() - heard >= PERIOD_S or done == total):
            view.histories[label], heard = look(), time.monotonic()
        begin()  # not before: the folder may hold another run, which is replaced or refused

    try:
        yield report
        begin()  # a finished run tells nothing
    finally:
        ended.set()
        if thread.ident is None:
            stream.disconnect()
        else:
            _wait(thread, lost, url, warn)


def _wait(thread: threading.Thread, lost: threading.Event, url: str, warn: Callable[[str], None]) -> None:
    """Wait until all is sent, as long as the viewer answers."""
    end = time.monotonic() + PATIENCE_S
    thread.join(LOOK_S)
    while thread.is_alive() and not lost.is_set() and time.monotonic() < end and knock(url) == "viewer":
        thread.join(LOOK_S)
    if thread.is_alive():
        if not lost.is_set():
            warn("the viewer takes nothing any more; what it shows is not the whole run")
        rr.unregister_shutdown()  # at the end of the process it would wait for the viewer for ever


def _send(
    stream: rr.RecordingStream,
    view: LiveView,
    ended: threading.Event,
    lost: threading.Event,
    warn: Callable[[str], None],
) -> None:
    """Send what is new every second, and a last time when the run has ended."""
    last = False
    try:
        while not last:
            last = ended.wait(PERIOD_S)
            view.update()
            stream.flush(timeout_sec=STALL_S)
    except Exception as error:  # no fault in showing ends a run
        what = "the viewer is gone" if isinstance(error, GONE) else "showing failed"
        lost.set()
        warn(f"{what} ({type(error).__name__}: {one_line(error)}); the run goes on without it")
    finally:
        stream.disconnect()  # never returns where a viewer hangs


def _check(stream: rr.RecordingStream, address: str) -> None:
    """Raise InputError where something other than a viewer answers."""
    try:
        for _ in range(5):
            stream.flush(timeout_sec=ANSWER_S)
            time.sleep(0.1)  # the refusal of what has been sent takes a moment
    except RuntimeError:
        raise InputError(f"--live {address}: what answers there is no Rerun viewer") from None
