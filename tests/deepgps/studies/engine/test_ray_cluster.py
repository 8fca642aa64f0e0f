"""A study on a real Ray cluster of two workers: what the local engine makes, byte for byte; and how it ends."""

import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from deepgps.studies.engine import local
from deepgps.studies.engine.engine import open_engine
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
MADE = ("deepgps/*.safetensors", "deepgps/history.npz", "error_field.npz", "scenario.yaml")


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


def read_runs(out: Path) -> dict[str, bytes]:
    paths = [path for pattern in MADE for path in out.glob(f"runs/*/{pattern}")]
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in paths}


@pytest.mark.slow
def test_both_engines_make_the_same_bytes_and_list_the_same_failure(cluster: str, tmp_path: Path):
    cases = [{}, {"learn.train.device": "cuda:99"}]
    study, rows = write_study(tmp_path, scenario="plane.yaml", cases=cases), {}
    assert len(do_here(study, tmp_path / "local", local.run_all)) == 1
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
    assert len(ours) == len(MADE)
    assert ours == theirs


@pytest.mark.slow
def test_an_interrupted_cluster_leaves_no_process_and_the_local_engine_goes_on(tmp_path: Path):
    study, out = write_study(tmp_path, scenario="plane.yaml", set={"learn.train.steps": 500}), tmp_path / "out"
    process = start(study, out, "--engine", "ray")
    wait_until(lambda: list(out.glob("runs/*/scenario.yaml")), process)
    begun = psutil.Process(process.pid).children(recursive=True)
    assert any("raylet" in child.name() for child in begun)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=60)
    said = drop_progress(errors)
    assert (process.returncode, said) == (130, ["interrupted; the same command continues where it stopped"])
    assert not psutil.wait_procs(begun, timeout=30)[1]
    times = {path: path.stat().st_mtime_ns for path in out.glob("recordings/*/*.npy")}
    assert do_here(study, out) == {}
    assert {path: path.stat().st_mtime_ns for path in times} == times
    assert len(list(out.glob("runs/*/metrics.json"))) == 2


@pytest.mark.parametrize(
    ("engine", "address", "message"),
    [
        ("local", "auto", "--address auto names a Ray cluster and needs --engine ray"),
        ("ray", "127.0.0.1:1", "--address 127.0.0.1:1: no Ray cluster answers there: .*refused"),
        ("ray", "nonsense", "--address nonsense: no Ray cluster answers there"),
    ],
)
def test_wrong_addresses_are_named_in_one_line(engine, address, message):
    with pytest.raises(InputError, match=message) as caught, open_engine(engine, address):
        pass
    assert "\n" not in str(caught.value)


def test_a_cluster_that_cannot_be_started_here_is_no_wrong_address(monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no shared\nmemory")

    monkeypatch.setattr(pytest.importorskip("ray"), "init", fail)
    monkeypatch.setenv("RAY_AUTH_TOKEN", "of this test")  # else one is left in the environment
    message = "^--engine ray: no Ray cluster can be started here: no shared memory$"
    with pytest.raises(InputError, match=message), open_engine("ray", None):
        pass


def test_without_ray_the_cure_is_said(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "ray", None)  # as if it were not installed
    with pytest.raises(InputError, match=r"^--engine ray needs Ray: pip install ray "), open_engine("ray", None):
        pass


@pytest.mark.slow
def test_a_cluster_loads_the_plugins_of_a_study(cluster: str, tmp_path: Path):
    study = write_study(tmp_path, **CHANGES, axes={"encoder.plugins.stretch": [0.0, 0.1]})
    words = ("--plugin", str(write_plugin(tmp_path)))
    made = {}
    for name, engine in {"local": (), "ray": ("--engine", "ray", "--address", cluster)}.items():
        finish(start(study, tmp_path / name, *engine, *words))
        made[name] = {
            path.relative_to(tmp_path / name).as_posix(): path.read_bytes()
            for pattern in ("stored/*.safetensors", "error_field.npz", "scenario.yaml")
            for path in (tmp_path / name).glob(f"runs/*/{pattern}")
        }
    assert len(made["local"]) == 6
    assert made["local"] == made["ray"]
