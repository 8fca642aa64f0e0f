"""The number of cores changes no byte: a training on one core, on all, and cut off on one and continued on all."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_info

from deepgps.learning.trainer import use_threads
from tests.helpers.toy import make_toy

TRAIN = """
import os, sys
if sys.argv[3] == "one":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
from pathlib import Path
import numpy as np
from deepgps.methods import deepgps
from deepgps.methods.fit import fit_method
from deepgps.config.learning import LearnSettings
from sim.recording.format import open_recording

class Cut(Exception):
    pass

def stop(label, done, total, tables=None):
    if done > 10:
        raise Cut

find = deepgps.INITIAL_MAPS["paths"]

def find_and_keep(*given):
    places, segments = find(*given)
    places.tofile(folder / "first_map")
    return places, segments

# The weights of so short a training would hide the last digits of the initial map, in which the trouble starts.
deepgps.INITIAL_MAPS["paths"] = find_and_keep
settings = LearnSettings.model_validate({
    "network": {"width": 16, "layers": 1}, "fold": {"restarts": 0}, "start": "paths",
    "train": {"steps": 20, "segments": 4, "samples": 4, "checkpoint_steps": 5},
})
recording = open_recording(Path(sys.argv[1]))
for name in sys.argv[4:]:
    folder, stopped = Path(sys.argv[2]) / name.strip("!"), name.endswith("!")
    folder.mkdir(exist_ok=True)
    try:
        fit_method("deepgps", recording, settings, 0, folder, stop if stopped else lambda *_: None)
    except Cut:
        pass
"""


@pytest.mark.slow
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_a_training_ends_with_the_same_bytes_on_one_core_and_on_two(tmp_path: Path):
    make_toy(tmp_path / "toy", samples=500)

    def start(cores: str, *names: str) -> subprocess.Popen:
        command = [sys.executable, "-c", TRAIN, tmp_path / "toy", tmp_path, cores, *names]
        # A limit that the tests themselves run under would hide what is tested.
        environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
        return subprocess.Popen(command, env=environment)

    assert [process.wait() for process in (start("two", "two"), start("one", "one", "cut!"))] == [0, 0]
    assert (tmp_path / "cut" / "attempt0" / "checkpoint.pt").is_file()
    assert not (tmp_path / "cut" / "weights.safetensors").exists()
    assert start("two", "cut").wait() == 0
    for file in ("first_map", "weights.safetensors"):
        one, two, cut = ((tmp_path / name / file).read_bytes() for name in ("one", "two", "cut"))
        assert two == one, file
        assert cut == one, file


def test_threads_are_fixed_inside_and_as_before_outside():
    def count() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    before = count(), torch.get_num_threads()
    with use_threads(3):
        assert np.all(np.array(count()) == 1)
        assert torch.get_num_threads() == 3
        with use_threads(1):
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 3
    assert (count(), torch.get_num_threads()) == before
