"""Showing a run in progress: a thread sends to a viewer what the stages report and write.

The stages know nothing of this thread: it receives the reports for the progress bars and the history of a training now
and then, and reads the files in the run folder. Whatever happens to the viewer, the run continues.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import rerun as rr

from deepgps.config.scenario import Scenario
from deepgps.terminal.progress import Look, Report
from deepgps.viewer.connect import ANSWER_S, find_url, knock, open_viewer
from deepgps.viewer.live_view import LiveView
from sim.errors import InputError, one_line

APPLICATION = "deepgps live"  # not that of recordings, whose blueprint it would replace
GONE = (RuntimeError, ConnectionError)
"""Errors that rerun raises when the viewer is gone."""
PERIOD_S = 1.0
STALL_S = 10.0
"""How long a viewer may accept no data [s]."""
PATIENCE_S = 20.0
"""How long a finished run waits for a slow viewer to accept the remaining data [s]."""
LOOK_S = 0.4
"""Interval at which a finished run checks whether the viewer still answers [s]."""


@contextmanager
def show_live(
    address: str, scenario: Scenario, folder: Path, progress: Report, warn: Callable[[str], None]
) -> Iterator[Report]:
    """Stream a run to a viewer while it runs.

    Args:
        address: Address of a running viewer, host:port or a Rerun URL; empty: a viewer is opened, and stays open.
        scenario: The run's scenario.
        folder: The run folder.
        progress: Called with everything that the stages report.
        warn: Called with one line when the viewer stops answering.

    Yields:
        The progress report for the stages to call.

    Raises:
        InputError: The address is wrong, or no viewer answers there.
        WorkError: No viewer can be opened.
    """
    url = find_url(address) if address else open_viewer()
    who = knock(url)
    if who == "stranger":
        raise InputError(f"--live {address}: what answers there is not a Rerun viewer")
    if who == "nobody":
        warn(f"the viewer at {address} does not answer within {ANSWER_S} s; the run continues without it")
        yield progress
        return
    by_hand = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))  # each update flushes
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
        begin()  # the stages of a finished run report nothing
    finally:
        ended.set()
        if thread.ident is None:
            stream.disconnect()
        else:
            _wait(thread, lost, url, warn)


def _wait(thread: threading.Thread, lost: threading.Event, url: str, warn: Callable[[str], None]) -> None:
    """Wait until everything is sent, as long as the viewer answers."""
    end = time.monotonic() + PATIENCE_S
    thread.join(LOOK_S)
    while thread.is_alive() and not lost.is_set() and time.monotonic() < end and knock(url) == "viewer":
        thread.join(LOOK_S)
    if thread.is_alive():
        if not lost.is_set():
            warn("the viewer no longer accepts data; it does not show the complete run")
        rr.unregister_shutdown()  # when the process exits, it would wait forever for the viewer


def _send(
    stream: rr.RecordingStream,
    view: LiveView,
    ended: threading.Event,
    lost: threading.Event,
    warn: Callable[[str], None],
) -> None:
    """Send new data every ``PERIOD_S``, and a last time when the run has ended."""
    last = False
    try:
        while not last:
            last = ended.wait(PERIOD_S)
            view.update()
            stream.flush(timeout_sec=STALL_S)
    except Exception as error:  # a bug in the live view must not end the run
        what = "the connection to the viewer is lost" if isinstance(error, GONE) else "the live view failed"
        lost.set()
        warn(f"{what} ({type(error).__name__}: {one_line(error)}); the run continues without it")
    finally:
        stream.disconnect()  # never returns if the viewer hangs


def _check(stream: rr.RecordingStream, address: str) -> None:
    """Raise InputError if something other than a viewer answers."""
    try:
        for _ in range(5):
            stream.flush(timeout_sec=ANSWER_S)
            time.sleep(0.1)  # a refusal of the data takes a moment to arrive
    except RuntimeError:
        raise InputError(f"--live {address}: what answers there is not a Rerun viewer") from None
