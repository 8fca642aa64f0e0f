"""The run folder is ours by a mark: a user's files survive every command, and --fresh replaces a run whole or not."""

import os
import random
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepgps.commands.main import main
from deepgps.config.scenario import Scenario, write_out
from deepgps.runs import owned_folder
from deepgps.runs.collect import collect
from deepgps.runs.owned_folder import FRESH_FOLDER, MARK
from deepgps.runs.run_folder import RUN, claim, open_run
from deepgps.runs.source import find_adopted, find_source, link_recording
from sim.errors import DamagedError, InputError
from sim.files.checksums import write_json

SCENARIO = Scenario(world="landmarks", methods=("knn",))
OTHER = Scenario(world="landmarks", methods=("posenet",))
OUR_FILES = ("recording/reading.npy", "knn/weights.safetensors", "metrics.json", "figures/drive.png")
DATA = ("notes.txt", "figures/mine.png", "knn/notes.txt", "movie.part", "a.1.part", "recording/data.csv", "study.yaml")
NAMES = (
    *("scenario.yaml", "study.yaml", "metrics.json", "recording", "deepgps", "figures", "movie.part", "x.123.part"),
    *(".lock", "complete.json", "rooms.png", "table.md", "thesis.txt", "run", "weights.safetensors"),
)
"""What a user may call files and folders."""
WORDS = (
    *("run landmarks", "collect tiny", "train landmarks", "evaluate lidar", "study noise_w", "study samples --tiny"),
    *("rooms --kinds lab --seeds 0", "view", "run scenario.yaml", "study study.yaml", "run nothing"),
)
ARGS = ("--fresh", "--room.mjcf typo.xml", "--room.seed -1", "--nonsense 1", "--methods", "--seeds x", "--port 9")


def remember(folder: Path) -> dict[str, bytes]:
    """Contents of all files below a folder, and targets of all links, by their paths."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path).encode() if path.is_symlink() else path.read_bytes()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


def make_run(folder: Path, scenario: Scenario = SCENARIO, text: str = "old") -> None:
    with claim(scenario, folder, fresh=False) as place:
        write_files(place, OUR_FILES, text)


def write_files(folder: Path, names: tuple[str, ...], text: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def kill_at(number: int, monkeypatch: pytest.MonkeyPatch) -> Callable[[], bool]:
    """Interrupt the process at so many changes of the disk from now on; tells whether it did."""
    done = 0

    def count(change: Callable) -> Callable:
        def changed(*arguments, **named):
            nonlocal done
            done += 1
            if done == number:
                raise KeyboardInterrupt
            return change(*arguments, **named)

        return changed

    for name in ("unlink", "replace", "rmdir", "mkdir"):
        monkeypatch.setattr(Path, name, count(getattr(Path, name)))
    return lambda: done >= number


def test_fresh_replaces_a_run_and_leaves_the_user_s_files(tmp_path: Path):
    make_run(tmp_path)
    write_files(tmp_path, DATA, "mine")
    with claim(OTHER, tmp_path, fresh=True) as place:
        assert place != tmp_path
        write_files(place, OUR_FILES[:2], "new")
        assert {(tmp_path / name).read_text() for name in OUR_FILES} == {"old"}
    assert open_run(tmp_path) == OTHER
    found = remember(tmp_path)
    assert {found[name] for name in OUR_FILES[:2]} == {b"new"}
    assert {found[name] for name in DATA} == {b"mine"}
    assert set(found) == {*DATA, *OUR_FILES[:2], MARK, "scenario.yaml"}


@pytest.mark.parametrize("number", range(1, 14))
def test_fresh_killed_anywhere_leaves_the_old_run_or_the_new_one(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    make_run(tmp_path)
    write_files(tmp_path, DATA, "mine")
    with monkeypatch.context() as patch:
        killed = kill_at(number, patch)
        try:
            with claim(SCENARIO, tmp_path, fresh=True) as place:
                write_files(place, OUR_FILES[:3], "new")
        except KeyboardInterrupt:
            pass
        assert killed()
    found = remember(tmp_path)
    assert {found[name] for name in DATA} == {b"mine"}
    if not (tmp_path / FRESH_FOLDER / owned_folder.COMPLETION_FILE).is_file():
        assert {found[name] for name in OUR_FILES} in ({b"old"}, {b"new"})
    with claim(SCENARIO, tmp_path, fresh=True) as place:  # the same command again
        if place != tmp_path:
            write_files(place, OUR_FILES[:3], "new")
    found = remember(tmp_path)
    assert {found[name] for name in OUR_FILES[:3]} == {b"new"}
    assert {found[name] for name in DATA} == {b"mine"}
    assert set(found) == {*DATA, *OUR_FILES[:3], MARK, "scenario.yaml"}


def test_a_killed_fresh_continues_what_it_had_built(tmp_path: Path):
    make_run(tmp_path)
    with pytest.raises(KeyboardInterrupt), claim(SCENARIO, tmp_path, fresh=True) as place:
        write_files(place, OUR_FILES[:1], "new")
        raise KeyboardInterrupt
    with claim(SCENARIO, tmp_path, fresh=True) as place:
        assert (place / OUR_FILES[0]).read_text() == "new"
    assert (tmp_path / OUR_FILES[0]).read_text() == "new"


def test_a_killed_fresh_of_another_scenario_is_not_continued(tmp_path: Path):
    make_run(tmp_path)
    with pytest.raises(KeyboardInterrupt), claim(OTHER, tmp_path, fresh=True) as place:
        write_files(place, OUR_FILES[:1], "new")
        raise KeyboardInterrupt
    with claim(SCENARIO, tmp_path, fresh=True) as place:
        assert not (place / OUR_FILES[0]).exists()
    assert open_run(tmp_path) == SCENARIO


def test_wrong_input_of_fresh_leaves_the_old_run_and_nothing_else(tmp_path: Path):
    make_run(tmp_path)
    before = remember(tmp_path)
    with pytest.raises(InputError), claim(OTHER, tmp_path, fresh=True):
        raise InputError
    assert remember(tmp_path) == before
    assert not (tmp_path / FRESH_FOLDER).exists()


def test_another_scenario_is_refused_with_what_is_there(tmp_path: Path):
    make_run(tmp_path)
    write_json(tmp_path / "knn" / "positioner.json", {})
    with pytest.raises(InputError, match=r"another scenario \(no finished recording, trained knn, measured\)"):
        make_run(tmp_path, OTHER)


def test_a_run_of_an_older_format_is_refused_and_not_changed(tmp_path: Path):
    make_run(tmp_path)
    (tmp_path / "scenario.yaml").write_text(f"# sha256 of the lines below: 0\n{write_out(SCENARIO)}")
    before = remember(tmp_path)
    with pytest.raises(InputError, match=r"made by deepgps 0\.1\.0, format 1: make it again, or use deepgps 0\.1\.0"):
        make_run(tmp_path)
    assert remember(tmp_path) == before


def test_an_empty_folder_of_the_user_s_stays_after_wrong_input(tmp_path: Path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    for name in ("mine", "link", "new/run"):
        with pytest.raises(InputError, match="too late"), claim(SCENARIO, tmp_path / name, False):
            raise InputError("too late")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["link", "mine"]


@pytest.mark.parametrize("name", [MARK, ".lock", "scenario.yaml"])
def test_no_link_is_followed_and_no_file_is_emptied(name: str, tmp_path: Path):
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "victim")
    with pytest.raises(InputError, match="neither empty nor a run folder"):
        make_run(tmp_path / "out")
    assert (tmp_path / "victim").read_text() == "precious"
    assert os.listdir(tmp_path / "out") == [name]


@pytest.mark.parametrize(
    ("mark", "says"), [("deepgps study folder", "says that it is a study folder"), ("x", "damaged")]
)
def test_another_mark_is_named(mark: str, says: str, tmp_path: Path):
    make_run(tmp_path)
    (tmp_path / MARK).write_text(mark)
    with pytest.raises(InputError, match=rf"its mark \.deepgps .*{says}"):
        make_run(tmp_path)
    (tmp_path / MARK).write_text("deepgps run folder")
    make_run(tmp_path)


def test_a_folder_in_use_is_refused(tmp_path: Path):
    with claim(SCENARIO, tmp_path, False), pytest.raises(InputError, match="in use by another process"):
        make_run(tmp_path)


def test_a_changed_scenario_file_is_found(tmp_path: Path):
    make_run(tmp_path)
    path = tmp_path / "scenario.yaml"
    path.write_text(path.read_text().replace("seed: 0", "seed: 1"))
    with pytest.raises(DamagedError, match=r"scenario\.yaml is damaged"):
        open_run(tmp_path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**9))
def test_every_byte_of_a_user_s_survives_every_command(
    seed: int, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
):
    """A random tree of user files, and a random command line, right or wrong, that writes into it."""
    rng, home = random.Random(seed), tmp_path_factory.mktemp("user")
    plant(rng, home, depth=2)
    (home / "keep").write_text("one file there is always")
    before = remember(home)
    words = rng.choice(WORDS).split()
    places = [".", *(path.relative_to(home).as_posix() for path in home.rglob("*"))]
    if words[0] == "view":
        words.append(rng.choice(places))
    else:
        words += ["--out", rng.choice(places)]
    words += [word for more in rng.sample(ARGS, rng.randint(0, 2)) for word in more.split()]
    # Whatever gets as far as to work is stopped there: this is about what happens before, and on the way out.
    monkeypatch.setattr("deepgps.run.collect", stop)
    monkeypatch.setattr("deepgps.studies.engine.engine.carry_out", stop)
    monkeypatch.setattr("sim.tools.gallery.draw_gallery", stop)
    monkeypatch.setattr("deepgps.viewer.show.view", stop)
    monkeypatch.chdir(home)
    with suppress(SystemExit):
        main(words)
    after = remember(home)
    assert {name: after.get(name) for name in before} == before, words


def stop(*_: object) -> None:
    raise KeyboardInterrupt


def plant(rng: random.Random, folder: Path, depth: int) -> None:
    for name in rng.sample(NAMES, rng.randint(0, 5)):
        kind = rng.random()
        if kind < 0.4 and depth:
            (folder / name).mkdir()
            plant(rng, folder / name, depth - 1)
        elif kind < 0.55:
            (folder / name).symlink_to(rng.choice((".", "..", "nowhere", "/etc", "thesis.txt")))
        else:
            (folder / name).write_bytes(
                rng.choice((b"", b"seed: 0\n", rng.randbytes(50), write_out(SCENARIO).encode()))
            )


def test_every_name_that_a_run_writes_is_known(tmp_path: Path):
    """A run is emptied and replaced by these names, so that none may be forgotten."""
    from deepgps.run import run

    small = Scenario.model_validate(
        {
            **SCENARIO.model_dump(),
            "methods": ("deepgps", "knn"),
            "drive": {"samples": 200},
            "learn": {"train": {"steps": 10}, "network": {"width": 8}, "fold": {"restarts": 0}},
        }
    )
    run(small, tmp_path, False, lambda *_: None)
    unknown = [name for name in remember(tmp_path) if not RUN.files.fullmatch(name)]
    assert unknown == [MARK]


@pytest.mark.parametrize("number", [*range(1, 9), None])
def test_fresh_over_a_link_to_a_recording_elsewhere_never_writes_through_it(
    number: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    robot, run = tmp_path / "robot", tmp_path / "run"
    write_files(robot, ("observation.npy", "manifest.json"), "the only copy")
    with claim(SCENARIO, run, fresh=False):
        (run / "recording").symlink_to(robot)
    before = remember(robot)
    with monkeypatch.context() as patch, suppress(KeyboardInterrupt):
        if number is not None:
            kill_at(number, patch)
        with claim(OTHER, run, fresh=True) as place:
            write_files(place, OUR_FILES[:1], "new")
    assert remember(robot) == before
    with claim(OTHER, run, fresh=True) as place:
        write_files(place, OUR_FILES[:1], "new")
    assert remember(robot) == before
    assert not (run / "recording").is_symlink() and (run / OUR_FILES[0]).read_text() == "new"


def test_fresh_puts_a_link_in_place_of_a_recording_unless_a_user_s_file_is_in_it(tmp_path: Path):
    robot, run = tmp_path / "robot", tmp_path / "run"
    write_files(robot, ("observation.npy",), "the only copy")
    make_run(run)
    write_files(run, ("recording/data.csv",), "mine")
    before = remember(run)
    refusal = pytest.raises(InputError, match=r"data\.csv is not deepgps's; nothing was replaced: move it away")
    with refusal, claim(OTHER, run, fresh=True) as place:
        (place / "recording").symlink_to(robot)
    found = remember(run)
    assert {name: found[name] for name in before} == before
    (run / "recording" / "data.csv").unlink()
    with claim(OTHER, run, fresh=True):
        pass
    assert (run / "recording").resolve() == robot and open_run(run) == OTHER


def test_fresh_never_removes_the_recording_that_it_would_link_to(tmp_path: Path):
    run, other = tmp_path / "run", tmp_path / "other"
    make_run(run)
    write_files(run, ("recording/manifest.json",), "the only copy")
    before = remember(run)
    with claim(SCENARIO, other, fresh=False) as place:
        link_recording(run / "recording", place)
    for recording in (run / "recording", other / "recording"):
        refusal = pytest.raises(InputError, match=r"holds the recording itself, which --fresh would remove")
        with refusal, claim(OTHER, run, fresh=True) as place:
            link_recording(recording, place)
        assert remember(run) == before
    refusal = pytest.raises(
        InputError, match=r"the new recording is a link to .*run/recording, which would be replaced"
    )
    with refusal, claim(OTHER, run, fresh=True) as place:
        (place / "recording").symlink_to(run / "recording")
    assert {name: remember(run)[name] for name in before} == before


def test_a_folder_that_is_a_link_to_elsewhere_is_not_replaced_in_part(tmp_path: Path):
    make_run(tmp_path / "run")
    (tmp_path / "run" / "figures").rename(tmp_path / "elsewhere")
    (tmp_path / "run" / "figures").symlink_to(tmp_path / "elsewhere")
    before = remember(tmp_path)
    with (
        pytest.raises(InputError, match=r"run/figures is a link or another disk; nothing was replaced: move it away"),
        claim(OTHER, tmp_path / "run", fresh=True) as place,
    ):
        write_files(place, OUR_FILES, "new")
    assert {name: remember(tmp_path)[name] for name in before} == before


def test_fresh_asks_for_the_plugin_of_a_method_that_is_trained(tmp_path: Path):
    make_run(tmp_path)
    write_json(tmp_path / "mine" / "positioner.json", {})
    before = remember(tmp_path)
    refusal = pytest.raises(InputError, match=r"a training of mine, a method of a plugin that is not loaded")
    with refusal, claim(OTHER, tmp_path, fresh=True):
        pass
    assert remember(tmp_path) == before


def test_a_run_is_not_continued_in_a_room_that_has_changed(tmp_path: Path):
    room, table = tmp_path / "room.xml", tmp_path / "table.xml"
    room.write_text('<mujoco><worldbody><include file="table.xml"/></worldbody></mujoco>')
    table.write_text('<mujocoinclude><geom size="0.1"/></mujocoinclude>')
    scenario = Scenario.model_validate({"room": {"mjcf": str(room)}})
    run = tmp_path / "run"
    make_run(run, scenario)
    make_run(run, scenario)
    for path in (table, room):
        path.write_text(path.read_text() + " ")
        with pytest.raises(InputError, match=r"room\.mjcf .*room\.xml has changed since this run was begun"):
            make_run(run, scenario)
        with claim(scenario, run, fresh=True):
            pass
        make_run(run, scenario)


def test_a_killed_fresh_in_a_room_that_has_changed_is_not_continued(tmp_path: Path):
    room, run = tmp_path / "room.xml", tmp_path / "run"
    room.write_text("<mujoco/>")
    scenario = Scenario.model_validate({"room": {"mjcf": str(room)}})
    make_run(run, scenario)
    with pytest.raises(KeyboardInterrupt), claim(scenario, run, fresh=True) as place:
        write_files(place, OUR_FILES[:1], "half")
        raise KeyboardInterrupt
    room.write_text("<mujoco><worldbody/></mujoco>")
    with claim(scenario, run, fresh=True) as place:
        assert not (place / OUR_FILES[0]).exists()


def test_a_recording_that_was_made_again_is_not_mixed_with_what_was_trained_before(tmp_path: Path):
    write_files(tmp_path / "other", ("recording/manifest.json",), "first")
    with claim(SCENARIO, tmp_path / "run", fresh=False) as place:
        link_recording(tmp_path / "other" / "recording", place)
        assert find_adopted(place) == tmp_path / "other" / "recording"
    write_files(tmp_path / "other", ("recording/manifest.json",), "second")
    with pytest.raises(InputError, match=r"its recording .*other/recording has been made again since"):
        find_source(str(tmp_path / "run"), {}, None)


def test_a_recording_that_has_moved_is_asked_for_and_nothing_is_driven(tmp_path: Path):
    with claim(SCENARIO, tmp_path / "run", fresh=False) as place:
        (place / "recording").symlink_to(tmp_path / "moved")
        with pytest.raises(InputError, match=r"its recording .*moved is missing or not finished; put it back"):
            collect(SCENARIO, place, lambda *_: None)
    with pytest.raises(InputError, match="put it back"):
        find_source(str(tmp_path / "run"), {}, None, fresh=True)
