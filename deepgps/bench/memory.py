"""Memory and time that a long recording costs; the recording is one drive, repeated on disk as often as needed."""

import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepgps.bench.rows import Row
from deepgps.config.learning import LearnSettings
from deepgps.data.features import describe
from deepgps.learning.trainer import use_threads
from deepgps.methods.deepgps import fit
from deepgps.methods.fit import fit_method
from deepgps.terminal.progress import ignore
from sim.errors import WorkError
from sim.files.arrays import write_array
from sim.files.json_files import write_json
from sim.processes import WORKERS
from sim.recording.format import Recording, grid_file, observation_file, open_recording

LOOK_EVERY_S = 0.01
SPARE_BYTES = 2_000_000_000  # disk space for features and weights, and so that the disk does not fill up
SHORTEST_MS = 0.01
"""A step takes at least this [ms]: times of trainings are rounded, those of a small bench to zero."""


@dataclass(frozen=True)
class Training:
    """A short training.

    Attributes:
        recording: Folder of the recording.
        folder: Folder of the training; features made there are reused.
        settings: Settings of the training.
    """

    recording: Path
    folder: Path
    settings: LearnSettings


def measure_memory(
    source: Path, settings: LearnSettings, samples: int, steps: int, repeats: int, folder: Path
) -> list[Row]:
    """Compare peak anonymous memory and the time of a step between a long recording and the recording itself.

    Args:
        source: A recording.
        settings: Settings of learning.
        samples: Observations of the long recording; fewer if the disk has no room.
        steps: Number of steps of each training.
        repeats: Number of trainings on each recording to time a step; medians count.
        folder: An empty folder, where the long recording is made.
    """
    recording = open_recording(source)
    image_bytes = recording.observation[0].nbytes
    room = (shutil.disk_usage(folder).free - SPARE_BYTES) // (image_bytes + 4 * settings.features.components)
    count = int(min(samples, max(room, len(recording.observation))))
    repeat_recording(recording, count, folder / "long")
    train = settings.train.model_copy(update={"steps": steps})
    once = settings.model_copy(update={"train": train, "fold": settings.fold.model_copy(update={"restarts": 0})})
    trainings = {
        "long": Training(folder / "long", folder / "train-long", once),
        "short": Training(source, folder / "train-short", once),
    }
    peak = {name: measure_peak(training) for name, training in trainings.items()}
    step = {name: [] for name in trainings}
    for _ in range(repeats):
        for name, training in trainings.items():
            step[name].append(_time_step(training))
    ms = {name: 1e3 * float(np.median(each)) for name, each in step.items()}
    whole = len(describe(recording.observation[:1], settings.features.frequencies)[0]) * 4 * count / 1e9
    short = f"; the disk had room for no more than {count:,}" if count < samples else ""
    with_short = f"{len(recording.observation):,} samples: {peak['short'] / 1e9:.2f} GB; naive: all described at once"
    title = f"training on {count:,} samples"
    longer = ms["long"] / max(ms["short"], SHORTEST_MS)
    ratio = Row("step_ratio", f"{title}, a step", longer, "times", 1.2, note=f"{ms['long']:.1f} ms")
    return [
        Row("memory", f"{title}, anonymous memory", peak["long"] / 1e9, "GB", 2.0, False, whole, with_short + short),
        ratio,
    ]


def repeat_recording(source: Recording, count: int, folder: Path) -> None:
    """Write a recording of ``count`` observations: the drive repeated, each time as new segments.

    The recording has what training reads, but an empty test grid and no truth.
    """
    folder.mkdir(parents=True)
    images = source.observation
    length = len(images)
    copies = -(-count // length)
    observations = folder / observation_file(source.manifest.sensor)
    observations.parent.mkdir()
    with observations.open("wb") as file:  # without a sync: the file is temporary
        head = {"descr": images.dtype.str, "fortran_order": False, "shape": (count, *images.shape[1:])}
        np.lib.format.write_array_header_1_0(file, head)
        for number in range(copies):
            np.ascontiguousarray(images[: count - number * length]).tofile(file)
    first, last = source.reading[0], source.reading[-1]
    shift = np.array([last[0] + 1, length, *(last - first)[2:]])
    reading = np.concatenate([source.reading + number * shift for number in range(copies)])
    longer_s = source.time[-1] - source.time[0] + 1.0
    time_s = np.concatenate([source.time + number * longer_s for number in range(copies)])
    kept = reading[:, 1] < count
    write_array(folder / "reading.npy", reading[kept])
    write_array(folder / "time.npy", time_s[kept])
    write_array(folder / grid_file(source.manifest.sensor), np.zeros((0, 1, *images.shape[1:]), images.dtype))
    manifest = source.manifest.model_dump(mode="json", by_alias=True, exclude={"sha256"})
    write_json(folder / "manifest.json", manifest)  # without checksums: it is temporary


def measure_peak(training: Training) -> int:
    """Peak anonymous memory [bytes] of a training in a separate process."""
    process = WORKERS.Process(target=train_once, args=(training,))
    process.start()
    most = 0
    while process.is_alive():
        most = max(most, read_anonymous(process.pid))
        time.sleep(LOOK_EVERY_S)
    if process.exitcode != 0:
        raise WorkError(f"the training on {training.recording} failed with code {process.exitcode}")
    return most


def train_once(training: Training) -> None:
    """Train DeepGPS from the recording, exactly as a run does."""
    fit_method("deepgps", open_recording(training.recording), training.settings, 0, training.folder / "deepgps", ignore)


def read_anonymous(process: int | None) -> int:
    """Anonymous memory of a process [bytes]; 0 once it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("RssAnon:"))


def _time_step(training: Training) -> float:
    # A random start: a step costs the same, and no initial map is needed. What follows the training is left out.
    folder, train = training.folder / "deepgps", training.settings.train
    shutil.rmtree(folder, ignore_errors=True)
    random = training.settings.model_copy(update={"start": "random"})
    with use_threads(train.threads):
        fitted = fit(open_recording(training.recording), random, 0, folder, ignore)
    return fitted.training["train_s"] / train.steps
