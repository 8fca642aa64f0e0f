"""A study on a real Ray cluster of two workers: what the local engine makes, byte for byte; and how it ends."""

import secrets
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from deepgps.studies.engine.engine import EngineName, open_engine
from deepgps.studies.engine.runs import run_all
from sim.errors import InputError
from tests.helpers.command import drop_progress
from tests.helpers.small_study import do_here, start, write_study

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
    assert len(ours) == len(MADE)
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
