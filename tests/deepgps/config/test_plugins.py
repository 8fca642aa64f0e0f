"""Plugins: methods and encoder faults from outside, told apart by their source, in one process and in many."""

import os
import signal
import textwrap
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import deepgps
from deepgps.config.methods import METHODS
from deepgps.config.plugins import check_plugins, load_plugins
from deepgps.config.scenario import load_scenario, write_out
from deepgps.runs.inputs import digest, digest_recording
from deepgps.runs.run_folder import claim, open_run
from sim.errors import InputError
from sim.plugins import ENCODER_FAULTS
from sim.recording.format import open_recording
from sim.rng import stream
from sim.sensors.encoder import read_encoders
from sim.settings import EncoderSettings
from tests.helpers.command import deepgps_here, wait_until
from tests.helpers.plugin import CHANGES
from tests.helpers.plugin import write_plugin as write_stored
from tests.helpers.small_study import SCENARIO, finish, start, write_study

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
METHOD, FAULT = EXAMPLES / "own_method.py", EXAMPLES / "own_encoder_fault.py"
WARM_SETTINGS = {"encoder.plugins.warming": 0.1}
ANGLE = np.cumsum(np.random.default_rng(0).uniform(0.0, 1.0, (400, 2)), axis=0)


def write_plugin(folder: Path, code: str, name: str = "mine.py") -> Path:
    (folder / name).write_text(textwrap.dedent(code))
    return folder / name


def write_fault(folder: Path, body: str) -> Path:
    return write_plugin(
        folder,
        f"""
        import deepgps

        def apply(angle, value, radius_m, rng):
            return {body}

        ENCODER_FAULTS = {{"mine": deepgps.EncoderFault("mine", apply=apply)}}
        """,
    )


def read(settings: EncoderSettings, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return read_encoders(ANGLE, 0.033, settings, stream(seed, "encoder"))


def test_a_fault_acts_by_its_strength_and_not_at_all_at_zero():
    load_plugins([FAULT])
    sound, off, on = (
        EncoderSettings.model_validate({"step_noise": 0.1, "plugins": plugins})
        for plugins in ({}, {"warming": 0}, {"warming": 0.2})
    )
    assert off == sound
    assert "plugins" not in off.model_dump()
    ticks, warm = read(sound)[0], read(on)[0]
    shrunk = np.diff(warm, axis=0).sum(axis=1) / np.diff(ticks, axis=0).sum(axis=1)
    expected = 1 / (1 + 0.2 * np.linspace(0, 1, len(shrunk)))
    np.testing.assert_allclose(np.median(shrunk / expected), 1.0, atol=1e-3)


def test_another_fault_does_not_change_what_a_fault_draws(tmp_path: Path):
    noisy = "deepgps.EncoderFault('n', drops=lambda count, value, rng: rng.random(count) < value)"
    path = write_plugin(tmp_path, f"import deepgps\nENCODER_FAULTS = {{'loss': {noisy}, 'other': {noisy}}}")
    load_plugins([path, FAULT])
    masks = [
        read(EncoderSettings.model_validate({"plugins": plugins, **rest}))[1]
        for plugins, rest in (
            ({"loss": 0.3}, {}),
            ({"loss": 0.3, "warming": 0.2}, {"slip_per_m": 0.1}),
            ({"other": 0.3}, {}),
        )
    ]
    assert np.array_equal(masks[0], masks[1])
    assert not np.array_equal(masks[0], masks[2])
    assert 0.2 < 1 - masks[0].mean() < 0.4


def test_runs_without_plugins_keep_their_hash_whatever_is_loaded():
    before = load_scenario("tiny", {})
    hashes = digest(before), digest_recording(before), write_out(before)
    load_plugins([METHOD, FAULT])
    after = load_scenario("tiny", {"encoder.plugins.warming": "0"})
    assert (digest(after), digest_recording(after), write_out(after)) == hashes
    assert "plugins" not in write_out(after)


def test_a_method_changes_the_run_s_hash_and_a_fault_the_recording_s_as_well():
    load_plugins([METHOD, FAULT])
    plain = load_scenario("tiny", {})
    method, fault = load_scenario("tiny", {"methods": ["nearest_image"]}), load_scenario("tiny", WARM_SETTINGS)
    assert len({digest(one) for one in (plain, method, fault)}) == 3
    assert digest_recording(method) == digest_recording(plain) != digest_recording(fault)
    assert "own_" not in write_out(method) + write_out(fault), "no path, since a scenario.yaml is passed on"


def test_a_run_can_be_opened_without_its_plugin_but_not_continued(tmp_path: Path):
    load_plugins([METHOD, FAULT])
    scenario = load_scenario("tiny", {"methods": ["nearest_image"], **WARM_SETTINGS})
    with claim(scenario, tmp_path / "run", False) as place:
        (place / "metrics.json").write_text("{}")
    METHODS.pop("nearest_image")
    assert open_run(tmp_path / "run") == scenario
    with pytest.raises(InputError, match="method nearest_image: no plugin that is loaded defines it; --plugin FILE"):
        check_plugins(scenario)
    ENCODER_FAULTS.clear()
    assert open_run(tmp_path / "run") == scenario
    with pytest.raises(InputError, match=r"encoder\.plugins\.warming 0\.1: no plugin"):
        read(scenario.encoder)


def test_a_plugin_that_has_changed_is_loaded_again(tmp_path: Path):
    for factor in (1, 2):
        load_plugins([write_fault(tmp_path, f"angle + {factor}")])
        assert ENCODER_FAULTS["mine"].apply(0, 0, 0, None) == factor  # pyright: ignore


def test_what_is_wrong_is_said_in_one_line(tmp_path: Path):
    method = 'deepgps.Method("Mine", "#aabbcc", "SE2", print)'
    for name, text in {
        "raises.py": "def f():\n    return 1 / 0\nf()",
        "syntax.py": "def f(:",
        "empty.py": "x = 1",
        "table.py": "METHODS = {'mine': print}",
        "taken.py": f"import deepgps\nMETHODS = {{'knn': {method}}}",
        "name.py": f"import deepgps\nMETHODS = {{'My method': {method}}}",
    }.items():
        write_plugin(tmp_path, text, name)
    fault = ("--plugin", str(FAULT), "--encoder.plugins.warming")
    for words, code, *parts in (
        (("--methods", "nearest_image"), 2, "--methods 'nearest_image'", "'deepgps_compass',", "--plugin FILE"),
        (("--encoder.plugins.warming", "0.1"), 2, "encoder.plugins.warming 0.1", "--plugin FILE"),
        (("--plugin", "nothing.py"), 2, "nothing.py: no such file"),
        ((*fault, "3"), 2, "warming 3.0", "from 0 to 0.5"),
        ((*fault, "x"), 2, "--encoder.plugins.warming 'x'"),
        (("--plugin", "raises.py"), 1, "raises.py, line 2: ZeroDivisionError: division by zero"),
        (("--plugin", "syntax.py"), 1, "syntax.py, line 1: SyntaxError: "),
        (("--plugin", "empty.py"), 2, "empty.py", "METHODS", "ENCODER_FAULTS"),
        (("--plugin", "table.py"), 2, "table.py: METHODS must map names to deepgps.Method"),
        (("--plugin", "taken.py"), 2, "taken.py: the name knn is taken"),
        (("--plugin", "name.py"), 2, "name.py: 'My method'"),
    ):
        done = deepgps_here("collect", "landmarks", *words, cwd=tmp_path)
        assert done.returncode == code, (words, done.stderr)
        (line,) = done.stderr.splitlines()
        assert all(part in line for part in parts), line


def test_a_fault_that_fails_is_one_line_that_names_file_and_line(tmp_path: Path):
    words = ("collect", "landmarks", "--landmarks.segments", "20", "--encoder.plugins.mine", "1")
    for body, *parts in (
        ("1 / 0", "mine.py, line 5: ZeroDivisionError"),
        ("__import__('json').loads('{')", "mine.py, line 5: JSONDecodeError"),
        ("angle[:-1]", "mine.py, ", " must return finite angles ("),
        ("angle * float('nan')", "mine.py, ", " must return finite angles ("),
    ):
        done = deepgps_here(*words, "--plugin", str(write_fault(tmp_path, body)), cwd=tmp_path)
        assert done.returncode == 1
        assert all(part in done.stderr.splitlines()[-1] for part in parts), done.stderr
        assert "Traceback" not in done.stderr


def test_a_method_that_fails_is_one_line_and_exit_code_1(tmp_path: Path):
    for body, message in (
        ("raise KeyError('seven')", "mine.py, line 5: KeyError: 'seven'"),
        ("return deepgps.Fitted(3, {})", "method mine: fit must return one of deepgps's own positioners"),
        ("return 3", "mine.py, fit must return deepgps.Fitted, not a int"),
    ):
        code = f"""
            import deepgps

            def fit(recording, settings, seed, folder, progress):
                {body}

            METHODS = {{"mine": deepgps.Method("Mine", "#aabbcc", "SE2", fit)}}
            """
        words = ("--plugin", str(write_plugin(tmp_path, code)), "--methods", "mine", "--landmarks.segments", "20")
        done = deepgps_here("train", "landmarks", *words, "--grid.spacing_m", "0.5", cwd=tmp_path)
        assert done.returncode == 1
        assert message in done.stderr.splitlines()[-1], done.stderr


@pytest.mark.slow
def test_a_plugin_s_method_and_fault_run_from_python_and_are_positioned_by(tmp_path: Path):
    (tmp_path / "mini.yaml").write_text(SCENARIO)
    run = deepgps.simulate(
        tmp_path / "mini.yaml",
        tmp_path / "run",
        ["nearest_image"],
        {"encoder.plugins.warming": 0.2},
        [METHOD, FAULT],
        progress=False,
    )
    images = run.recording.test_observation[:, 0]
    positions = run.position(images)
    predicted = run.errors().to_pandas()[["predicted_x_m", "predicted_y_m"]].to_numpy()
    np.testing.assert_allclose(positions, predicted.reshape(*run.recording.test_observation.shape[:2], 2)[:, 0])
    assert open_recording(run.folder / "recording").manifest.settings["encoder"]["plugins"] == {"warming": 0.2}
    measured, expected = (run.metrics["distances"][f"segment_{name}"] for name in ("rms_m", "expected_m"))
    assert 0.5 < measured / expected < 2.0
    METHODS.pop("nearest_image")
    with pytest.raises(InputError, match="method nearest_image: no plugin"):
        deepgps.load(run.folder).position(images)
    assert deepgps.load(run.folder).errors().num_rows == predicted.shape[0]


@pytest.mark.slow
def test_a_study_with_plugins_gives_the_same_table_after_it_was_killed(tmp_path: Path):
    study = write_study(tmp_path, **CHANGES, axes={"encoder.plugins.stretch": [0.0, 0.05, 0.1]})
    words, tables = ("--plugin", str(write_stored(tmp_path))), []
    for name in ("whole", "killed"):
        out = tmp_path / name
        process = start(study, out, *words)
        if name == "killed":
            wait_until(lambda out=out: list(out.glob("runs/*/metrics.json")), process)
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            assert 0 < len(list(out.glob("runs/*/metrics.json"))) < 3
            process = start(study, out, *words)
        finish(process)
        rows = pq.read_table(out / "table.parquet").to_pylist()
        tables.append([{key: value for key, value in row.items() if key != "train_s"} for row in rows])
    assert tables[0] == tables[1]
    assert [row["encoder.plugins.stretch"] for row in tables[0]] == [0.0, 0.05, 0.1]
    assert not any(row["failure"] for row in tables[0])
    assert len({row["rms_m"] for row in tables[0]}) == 3
