import subprocess
from pathlib import Path

from deepgps.runs.provenance import describe_origin, find_revision

PROVENANCE = {
    "git": "abc1234",
    "cpu": "5 x Xeon",
    "python": "3.12.3",
    "packages": {"mujoco": "3", "torch": "2", "numpy": "2"},
}


def test_a_report_names_the_gpu_that_trained():
    on_gpu = describe_origin([{**PROVENANCE, "trained_on": "NVIDIA H200, bfloat16"}] * 2)
    assert on_gpu.startswith("Made at abc1234 on 5 x Xeon, trained on NVIDIA H200, bfloat16, with Python 3.12.3, ")


def test_a_report_of_earlier_or_cpu_runs_names_the_processor_alone():
    texts = {describe_origin([{**PROVENANCE, **more}]) for more in ({}, {"trained_on": "CPU, 1 threads, float32"})}
    assert texts == {"Made at abc1234 on 5 x Xeon, with Python 3.12.3, mujoco 3, torch 2, numpy 2."}


def test_an_installed_package_does_not_name_the_commit_of_the_repository_around_it(tmp_path: Path):
    git = ["git", "-C", str(tmp_path), "-c", "user.name=x", "-c", "user.email=x"]
    for words in (["init", "-q"], ["commit", "-q", "--allow-empty", "-m", "theirs"]):
        subprocess.run([*git, *words], check=True)
    inside = tmp_path / "venv" / "site-packages"
    inside.mkdir(parents=True)
    assert find_revision(inside) == "unknown"
    assert find_revision(tmp_path) != "unknown"
