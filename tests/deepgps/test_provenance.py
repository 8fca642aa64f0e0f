from deepgps.provenance import describe_origin

MADE = {
    "git": "abc1234",
    "cpu": "5 x Xeon",
    "python": "3.12.3",
    "packages": {"mujoco": "3", "torch": "2", "numpy": "2"},
}


def test_a_report_names_the_gpu_that_trained():
    on_gpu = describe_origin([{**MADE, "trained_on": "NVIDIA H200, bfloat16"}] * 2)
    assert on_gpu.startswith("Made at abc1234 on 5 x Xeon, trained on NVIDIA H200, bfloat16, with Python 3.12.3, ")


def test_a_report_of_earlier_or_cpu_runs_names_the_processor_alone():
    texts = {describe_origin([{**MADE, **more}]) for more in ({}, {"trained_on": "CPU, 1 threads, float32"})}
    assert texts == {"Made at abc1234 on 5 x Xeon, with Python 3.12.3, mujoco 3, torch 2, numpy 2."}
