"""A study on a real Ray cluster of two workers: what the local engine makes, byte for byte; and how it ends."""

import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from deepgps.studies.engine.engine import EngineName, open_engine
from deepgps.studies.engine.runs import run_all
from sim.errors import InputError
from tests.helpers.command import drop_progress, wait_until
from tests.helpers.plugin import CHANGES, write_plugin
from tests.helpers.small_study import do_here, finish, start, write_study

pytest.importorskip("ray", reason="the package ray is not installed")

CLUSTER = """
import logging, sys, ray
ray.init("local", num_cpus=2, include_dashboard=False, logging_level=logging.ERROR, log_to_driver=False)
print(ray.get_runtime_context().gcs_address, flush=True)
sys.stdin.read()
"""
MADE_FILES = ("deepgps/*.safetensors", "deepgps/history.npz", "error_field.npz", "scenario.yaml")


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a Ray cluster of two workers, which lets in only who knows its token."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        process = subprocess.Popen(
            [sys.executable, "-c", CLUSTER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout
        yield process.stdout.readline().strip()
        process.communicate("")


def read_runs(out: Path, made: Sequence[str] = MADE_FILES) -> dict[str, bytes]:
    paths = [path for pattern in made for path in out.glob(f"runs/*/{pattern}")]
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in paths}


@pytest.mark.slow
def test_both_engines_make_the_same_bytes_and_list_the_same_failure(cluster: str, tmp_path: Path):
    cases = [{}, {"learn.train.device": "cuda:99"}]
    study, rows = write_study(tmp_path, scenario="plane.yaml", cases=cases), {}
    assert len(do_here(study, tmp_path / "local", run_all)) == 1
    process = start(study, tmp_path / "ray", "--engine", "ray", "--address", cluster)
    _, errors = process.communicate(timeout=300)
    assert drop_progress(errors) == [f"failed: 1 of 2 runs failed; {tmp_path / 'ray' / 'table.md'} says why"]
    assert process.returncode == 1
    for name in ("local", "ray"):
        table = pq.read_table(tmp_path / name / "table.parquet").to_pylist()
        rows[name] = [{key: value for key, value in row.items() if key != "train_s"} for row in table]
    assert rows["ray"] == rows["local"]
    assert [row["failure"] is None for row in rows["ray"]] == [True, False]
    assert "cuda:99" in rows["ray"][1]["failure"]
    ours, theirs = read_runs(tmp_path / "ray"), read_runs(tmp_path / "local")
    assert len(ours) == len(MADE_FILES)
    assert ours == theirs


@pytest.mark.slow
def test_an_interrupted_cluster_leaves_no_process_and_the_local_engine_goes_on(tmp_path: Path):
    study, out = write_study(tmp_path, scenario="plane.yaml", set={"learn.train.steps": 500}), tmp_path / "out"
    process = start(study, out, "--engine", "ray")
    try:
        wait_until(lambda: list(out.glob("runs/*/scenario.yaml")), process, "the first run on a cluster")
        begun = psutil.Process(process.pid).children(recursive=True)
        assert any("raylet" in child.name() for child in begun)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        _, errors = process.communicate(timeout=60)
        said = drop_progress(errors)
        assert (process.returncode, said) == (130, ["interrupted; the same command continues where it stopped"])
        assert not psutil.wait_procs(begun, timeout=30)[1]
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    times = {path: path.stat().st_mtime_ns for path in out.glob("recordings/*/*.npy")}
    assert do_here(study, out) == {}
    assert {path: path.stat().st_mtime_ns for path in times} == times
    assert len(list(out.glob("runs/*/metrics.json"))) == 2


@pytest.mark.slow
def test_a_cluster_loads_the_plugins_of_a_study(cluster: str, tmp_path: Path):
    study = write_study(tmp_path, **CHANGES, axes={"encoder.plugins.stretch": [0.0, 0.1]})
    made = ("stored/*.safetensors", "error_field.npz", "scenario.yaml")
    for name, engine in {"local": (), "ray": ("--engine", "ray", "--address", cluster)}.items():
        finish(start(study, tmp_path / name, *engine, "--plugin", str(write_plugin(tmp_path))))
    ours, theirs = (read_runs(tmp_path / name, made) for name in ("local", "ray"))
    assert len(ours) == 6
    assert ours == theirs


def test_a_cluster_that_cannot_be_had_is_named_in_one_line(monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no shared\nmemory")

    def refuse(engine: EngineName, address: str | None) -> str:
        with pytest.raises(InputError) as caught, open_engine(engine, address):
            pass
        assert "\n" not in str(caught.value)
        return str(caught.value)

    assert "--address auto names a Ray cluster" in refuse("local", "auto")
    for address in ("127.0.0.1:1", "nonsense"):
        assert f"--address {address}: no Ray cluster answers there" in refuse("ray", address)
    monkeypatch.setattr(pytest.importorskip("ray"), "init", fail)
    monkeypatch.setenv("RAY_AUTH_TOKEN", "of this test")  # else one is left in the environment
    assert refuse("ray", None) == "--engine ray: no Ray cluster can be started here: no shared memory"
    monkeypatch.setitem(sys.modules, "ray", None)  # as if it were not installed
    assert "pip install ray" in refuse("ray", None)
