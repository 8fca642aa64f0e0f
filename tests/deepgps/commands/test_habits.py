"""What the hands expect of a command: help, version, hints at typing errors, and a pipe that closes."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import get_origin

import pytest

from deepgps.commands.main import COMMANDS, main
from deepgps.commands.short_help import COLUMNS, FIRST_SETTINGS
from deepgps.config.scenario import Scenario
from deepgps.config.spelling import as_option, find_settings_like, from_option, list_settings

SETTINGS = [name for name, kind in list_settings(Scenario) if get_origin(kind) is not dict]
HINTS = [
    ("rn", "command 'rn' does not exist, did you mean run?"),
    ("tiny", "command 'tiny' does not exist, did you mean deepgps run tiny?"),
    ("--list", "deepgps has no option --list; deepgps --help lists the commands"),
    ("run tinny", "scenario 'tinny' does not exist, did you mean tiny?"),
    ("study sample", "study 'sample' does not exist, did you mean samples?"),
    ("study samples --tinny", "deepgps study: there is no option --tinny, did you mean --tiny?"),
    ("doctor --fresh", "deepgps doctor: there is no option --fresh; there are none"),
    ("run tiny --frech", "--frech: there is no such setting, did you mean --fresh?"),
    (
        "run tiny --encoder.tickz 1",
        "--encoder.tickz: there is no such setting; there are --encoder.ticks-per-rev, --enc",
    ),
    (
        "run tiny --encodr.dropout 0.1",
        "--encodr.dropout: there is no such setting, did you mean --encoder.dropout?",
    ),
    ("run tiny --ticks-per-rev 64", "--ticks-per-rev: there is no such setting, did you mean --encoder.ticks-per-rev?"),
    ("run tiny --nonsense 64", "--nonsense: there is no such setting; deepgps run --help-all lists them"),
    ("run tiny --encoder.ticks-per-rev 3", "error: --encoder.ticks-per-rev '3': must be greater than or equal to 4"),
    ("run tiny --methods deepgps knnn", "error: --methods 'knnn': must be 'registration'"),
    ("run --help encodr", "there is no such group of settings, did you mean encoder?"),
    ("run tiny --drive.turn-images=", "--drive.turn-images needs a value"),
    ("run tiny --seed=", "--seed needs a value"),
    ("run tiny --out=", "--out is empty"),
    ("run tiny --out ", "--out is empty"),
    ("view ", "deepgps view: an argument is empty"),
    ("study samples --out=", "deepgps study: --out is empty"),
]


def say(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Exit code, output and errors of a command line."""
    code = 0
    try:
        main(words)
    except SystemExit as ended:
        code = int(ended.code or 0)
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_typing_error_or_a_word_without_its_value_is_one_line_with_a_hint(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line, hint in HINTS:
        code, _, errors = say(line.split(" "), capsys)
        assert (code, len(errors.splitlines())) == (2, 1)
        assert hint in errors
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [[], ["-h"], ["--help"], ["help"]])
def test_help_lists_every_command(words, capsys):
    code, said, _ = say(words, capsys)
    assert code == 0
    assert all(f"\n  {name} " in said for name in COMMANDS)
    assert max(map(len, said.splitlines())) <= COLUMNS


def test_version(capsys):
    code, said, _ = say(["--version"], capsys)
    assert code == 0
    assert said.startswith("deepgps ")


@pytest.mark.parametrize("words", ["run --help", "run -h", "run tiny --help", "help run", "run --help --fresh"])
def test_short_help_is_for_a_first_reader(words, capsys):
    code, said, _ = say(words.split(), capsys)
    lines = said.splitlines()
    assert code == 0
    assert len(lines) < 35
    assert max(map(len, lines)) <= COLUMNS
    for text in ("Run a scenario", "SCENARIO", "example: deepgps run living_room", "--out", "--help-all"):
        assert text in said
    assert "STR" not in said
    assert set(FIRST_SETTINGS) <= set(SETTINGS)


def test_help_of_a_group_shows_its_settings_alone(capsys):
    for group, shown, hidden in (
        ("encoder", "--encoder.dropout", "--room.kind"),
        ("learn.lift", "--learn.lift.p", "pca"),
    ):
        code, said, _ = say(["train", "--help", group], capsys)
        assert code == 0
        assert shown in said
        assert hidden not in said


@pytest.mark.parametrize("words", ["run --help-all", "collect --help all"])
def test_help_for_all_shows_every_setting_with_its_default(words, capsys):
    _, said, _ = say(words.split(), capsys)
    assert [name for name in SETTINGS if as_option(name) not in said] == []
    for text in ("default: 4096", "--out", "[m]"):
        assert text in said


@pytest.mark.parametrize(
    ("command", "words"),
    [
        *(("study", "STUDY"), ("view", "RUN [RUN]"), ("rooms", "FILE"), ("collect", "Only drive")),
        *(("train", "Collect, and train"), ("evaluate", "Collect, train,")),
    ],
)
def test_help_says_what_to_write_and_what_a_command_does(command, words, capsys):
    code, said, _ = say([command, "--help"], capsys)
    assert code == 0
    assert words in said.replace("\n", " ")
    assert "STR" not in said


def test_a_switch_needs_no_value():
    from deepgps.commands.scenario import parse_scenario

    _, source = parse_scenario("run", ["lab", "--tag-camera.kept", "--learn.train.shift", "false"], "")
    scenario = source.scenario
    assert (scenario.tag_camera.kept, scenario.learn.train.shift) == (True, False)


def test_every_setting_survives_its_spelling():
    assert [from_option(as_option(name)) for name in SETTINGS] == SETTINGS


def test_a_setting_without_a_letter_is_found():
    for name in SETTINGS:
        assert name in find_settings_like(name[:-2] + name[-1:], Scenario)


def test_a_pipe_that_closes_is_quiet():
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "deepgps.commands.main", "run", "--help-all"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_wrong_study_is_refused_before_anything_heavy_is_imported(tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text("{scenario: tiny, axes: {encoder.step_nose: [0, 0.1]}}")
    code = (
        "import sys; from deepgps.commands.main import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit as ended: print(ended.code, sorted({'torch', 'matplotlib', 'mujoco'} & set(sys.modules)))"
    )
    before = time.process_time()
    done = subprocess.run(
        [sys.executable, "-c", code, "study", str(path)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert time.process_time() - before < 1.0
    assert done.stdout == "2 []\n"
    assert "study mine: encoder.step_nose: there is no such setting, did you mean step_noise?" in done.stderr
