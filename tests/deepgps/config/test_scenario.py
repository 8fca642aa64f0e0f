import json
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from deepgps.config.plain_yaml import read_yaml
from deepgps.config.scenario import Scenario, check_scenario, load_scenario, names_in, write_out
from deepgps.config.spelling import list_settings
from deepgps.runs.inputs import digest, digest_recording
from sim.errors import InputError
from sim.files import SCENARIOS
from sim.settings.group import _list_types


def write(tmp_path, text: str, name: str = "mine.yaml") -> str:
    path = tmp_path / name
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("name", names_in(SCENARIOS))
def test_every_scenario_loads_and_comes_back_from_what_it_writes(name, tmp_path):
    scenario = load_scenario(name, {})
    assert scenario.name == name
    assert load_scenario(write(tmp_path, write_out(scenario)), {}) == scenario


def test_overrides_win_and_are_converted():
    scenario = load_scenario("living_room", {"room.seed": "3", "encoder.step_noise": "1e-1", "room.mjcf": None})
    assert (scenario.room.seed, scenario.encoder.step_noise, scenario.room.mjcf) == (3, 0.1, None)


def test_true_is_no_number_of_any_setting_and_false_of_none():
    types = {name: set(_list_types(kind)) for name, kind in list_settings(Scenario)}
    numbers = [name for name, kinds in types.items() if kinds & {int, float} and bool not in kinds]
    assert len(numbers) > 80
    for name in numbers:
        for value in (True, False):
            with pytest.raises(InputError, match=f"{name} {value}: must be numeric, not true or false"):
                load_scenario("quick", {name: value})
    assert load_scenario("quick", {"drive.turn_images": False}).drive.turn_images is False


def test_numbers_that_yaml_reads_as_text_are_numbers(tmp_path):
    assert load_scenario(write(tmp_path, "learn: {train: {learning_rate: 1e-3}}"), {}).learn.train.learning_rate == 1e-3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "mine.yaml is empty"),
        ("- 1", "mine.yaml holds a list; a settings file is a mapping"),
        (
            "room: !!python/object/apply:os.system [ls]",
            "is of type python/object/apply:os.system",
        ),
        ("room: {kind: attic}", "room.kind 'attic': must be 'living_room', 'bedroom'"),
        ("room: {sed: 3}", "room.sed: there is no such setting, did you mean seed?"),
        ("encoder: {ticks_per_rev: 3}", "encoder.ticks_per_rev 3: must be greater than or equal to 4"),
        ("encoder: {ticks_per_rev: .nan}", "encoder.ticks_per_rev nan: must be a finite number"),
        ("methods: []", "methods: at least one method, each once"),
        (
            "drive: {headings: map, until: {unseen: 0.1, radius_m: 0.02}}",
            "drive.until.radius_m 0.02 needs registration in methods",
        ),
        ("methods: [explicit]", "methods: explicit needs distances to landmarks, which world landmarks alone gives"),
        (
            "{world: landmarks, learn: {network: {architecture: resnet}}}",
            "'resnet' needs images, which world landmarks",
        ),
        (
            "{camera: {sectors: 48}, learn: {network: {architecture: invariant}}}",
            "camera.sectors must be a multiple of 32, and is 48",
        ),
        (
            "{world: landmarks, drive: {spacing_m: 0.6}}",
            "drive.spacing_m 0.6 m must be at most a quarter of the longest",
        ),
        ("world: {}", "world {}: must be 'room', 'landmarks' or 'obstacles'"),
        (
            "{world: landmarks, image_faults: {exposure: 0.5}}",
            "image_faults changes what a camera sees, so it needs world room and sensor",
        ),
        (
            "{grid: {held_out: 5}, deployment: {light: 0.5}}",
            "deployment changes the room of the test grid, and grid.held_out 5 has none",
        ),
        (
            "{room: {mjcf: a.xml}, deployment: {moved_m: 0.5}}",
            "deployment.moved_m needs a room whose furniture is known, and room.mjcf",
        ),
        (
            "{world: obstacles, deployment: {drive_samples: 50}}",
            "deployment.drive_samples 50 needs world room, and the world is obstacles",
        ),
        (
            "{room: {kind: lab, look_alike: true}}",
            "look_alike: a lab has tags that are all different",
        ),
        (
            "tag_camera: {mounted: true}",
            "tag_camera.mounted needs tags: room.kind lab has some, and living_room has none",
        ),
        ("room: {width_m: on}", "room.width_m True: must be numeric, not true or false"),
        ("deployment: {drive_samples: 15}", "deployment.drive_samples: 15 must be 0 or at least 16"),
        (
            "{sensor: lidar, deployment: {drive_samples: 50, light: 0.5}}",
            "deployment changes what a camera sees, so it needs world room and sensor fisheye",
        ),
        ("image_faults: {exposure: 0}", "image_faults.exposure 0: must be greater than 0"),
        ("room.seed: 3", "room.seed: groups nest in a file: room: {seed: ...}"),
        (f"seed: {2**63}", f"seed {2**63}: must be less than or equal to {2**63 - 1}"),
        ("robot: {left_joint: wheel}", "robot: left_joint wheel names a part of a robot of your own, and needs mjcf"),
        ("{world: landmarks, robot: {wheel_radius_error: 0.1}}", "robot needs world room, and the world is landmarks"),
        ("seed: {", "line 1"),
        ("seed: 1\nseed: 2", "line 2: seed is given twice"),
        ("name: ../up", "name '../up'"),
        ("seed: 2024-13-45", "line 1: '2024-13-45' is of type timestamp"),
        ("seed: !!int abc", "mine.yaml"),
        ("seed: !!set {a, b}", "line 1: a mapping is of type set"),
        ("seed: &a [*a]", "line 1: aliases are not allowed"),
        ("1: 2", "line 1: the key 1 must be text"),
        ("seed: 0x" + "f" * 5000, "seed"),
        ("seed: " + "9" * 5000, "mine.yaml"),
        ("seed: " + "[" * 150_000, "nested too deeply"),
        ("#" * 200_001, "at most 200000 are read"),
        ('room: {mjcf: "a\\0b"}', "room.mjcf"),
        ("{a: 1, b: 2, c: 3, d: 4, e: 5, f: 6, g: 7}", "; and 2 more"),
    ],
)
def test_wrong_input_is_named_in_one_line(tmp_path, text, message):
    with pytest.raises(InputError) as caught:
        load_scenario(write(tmp_path, text), {})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1200


@pytest.mark.parametrize("value", ["x" * 190_000, "\\a" * 60_000, [["y" * 1000] * 100]])
def test_a_message_repeats_little_of_a_long_value(tmp_path, value):
    for field in ("seed", "name", "room"):
        with pytest.raises(InputError) as caught:
            load_scenario(write(tmp_path, json.dumps({field: value})), {})
        assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("file", "name"), [("my room", "my_room"), ("Büro", "B_ro"), ("a.b", "a_b"), ("x" * 80, "x" * 64), ("-a_9", "-a_9")]
)
def test_a_scenario_is_named_after_its_file_whatever_the_file_is_called(file, name, tmp_path):
    path = tmp_path / f"{file}.yaml"
    path.write_text("seed: 1")
    assert load_scenario(str(path), {}).name == name
    path.write_text("name: own")
    assert load_scenario(str(path), {}).name == "own"


def test_what_is_no_plain_file_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    for name in ("pipe", "folder", "zero"):
        with pytest.raises(InputError, match="it is no file"):
            load_scenario(str(tmp_path / f"{name}.yaml"), {})
        with pytest.raises(InputError, match=r"is a folder|is a pipe or a device"):
            read_yaml(tmp_path / f"{name}.yaml")


PIECES = st.sampled_from(
    [
        *"\n :-[]{},&*!?|>'\"%#@`~=<.0169",
        "seed",
        "room",
        "  ",
        "- ",
        "!!int ",
        "!!set ",
        "&a ",
        "*a",
        "<<",
        "0x",
        "1e999",
    ]
    + [
        ".nan",
        "2024-13-45",
        "---\n",
        "%TAG ! x\n",
        "\t",
        "\x00",
        "\\ud800",
        "é",
        "learn: {train: {steps: ",
        "methods: ",
    ]
)


@settings(deadline=None)
@given(st.one_of(st.binary(max_size=60), st.lists(PIECES, max_size=25).map(lambda parts: "".join(parts).encode())))
def test_any_bytes_are_a_scenario_or_one_line(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(data)
    try:
        assert isinstance(load_scenario(str(path), {}), Scenario)
    except InputError as error:
        assert str(error).isprintable()
        assert len(str(error)) < 2000


def test_a_file_that_does_not_exist_and_a_name_that_does_not():
    with pytest.raises(InputError, match=r"scenario nowhere/x\.yaml: no such file"):
        load_scenario("nowhere/x.yaml", {})
    with pytest.raises(InputError, match=r"scenario 'nowhere' does not exist; there are .*living_room"):
        load_scenario("nowhere", {})


@pytest.mark.parametrize(
    ("as_group", "dotted"),
    [
        ({"drive": {"spacing_m": 0.1}}, {"drive.spacing_m": 0.1}),
        ({"drive": {"spacing_m": 0.1}, "drive.samples": 50}, {"drive.spacing_m": 0.1, "drive.samples": 50}),
        ({"learn": {"train": {"steps": 7}, "seed": 2}}, {"learn.train.steps": 7, "learn.seed": 2}),
        ({"learn.train": {"steps": 7}}, {"learn.train.steps": 7}),
        ({"drive": {}}, {}),
    ],
)
def test_a_group_given_as_a_mapping_sets_what_it_names_and_no_more(as_group, dotted):
    assert load_scenario("tiny", as_group) == load_scenario("tiny", dotted)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"drive": {"samples": 50}, "drive.samples": 60}, "drive.samples: given twice, as 50 and 60; give it once"),
        ({"drive": {"samples": 1}}, "drive.samples 1: must be greater than or equal to 16"),
        ({"drive": {"sampels": 50}}, "drive.sampels: there is no such setting, did you mean samples?"),
        ({"seed": {"x": 2}}, "seed {'x': 2}: must be a valid integer"),
        ({"room.seed": {}}, "room.seed {}: must be a valid integer"),
        ({"seed": "1", "seed.x": "2"}, "seed.x: seed is not a group"),
    ],
)
def test_a_wrong_group_given_as_a_mapping_is_named_by_its_setting(overrides, message):
    with pytest.raises(InputError) as caught:
        load_scenario("tiny", overrides)
    assert message in str(caught.value)


def test_a_file_is_named_unless_the_overrides_alone_are_wrong(tmp_path):
    right, wrong = write(tmp_path, "{}", "right.yaml"), write(tmp_path, "seed: -1", "wrong.yaml")
    narrow = {"room.kind": "labyrinth", "room.width_m": 2}
    for path, overrides, begins in (
        (right, narrow, "room: width_m 2: a labyrinth needs at least 3 m"),
        (wrong, narrow, f"{wrong}: "),
        (wrong, {}, f"{wrong}: seed -1: must be"),
    ):
        with pytest.raises(InputError) as caught:
            load_scenario(path, overrides)
        assert str(caught.value).startswith(begins)


@pytest.mark.parametrize(
    "overrides",
    [
        {"sensor": "lidar", "deployment.drive_samples": 50},
        {"room.kind": "lab", "room.look_alike": True, "room.mjcf": "mine.xml"},
    ],
)
def test_settings_that_change_nothing_are_no_reason_to_refuse(overrides):
    load_scenario("quick", overrides)


def test_scenarios_are_frozen():
    with pytest.raises(ValidationError, match="frozen"):
        Scenario().seed = 3  # pyright: ignore[reportAttributeAccessIssue]


def test_the_digest_tells_settings_and_room_files_apart(tmp_path):
    room = tmp_path / "room.xml"
    room.write_text("<mujoco/>")
    plain, other = Scenario(), Scenario(seed=1)
    mine = check_scenario({"room": {"mjcf": str(room)}}, tmp_path)
    first = digest(mine)
    room.write_text("<mujoco model='b'/>")
    assert len({digest(plain), digest(other), first, digest(mine)}) == 4
    assert digest(plain) == digest(Scenario())


@pytest.mark.parametrize(
    "fault", ["image_faults.exposure", "camera_mount.roll_deg", "deployment.light", "deployment.camera_mount.roll_deg"]
)
def test_a_fault_makes_another_run_and_another_recording(fault):
    plain, faulty = load_scenario("tiny", {}), load_scenario("tiny", {fault: 0.5})
    assert digest(plain) != digest(faulty)
    assert digest_recording(plain) != digest_recording(faulty)


def test_a_run_in_a_room_of_the_user_s_own_is_called_after_its_file():
    assert load_scenario("living_room", {"room.mjcf": "/homes/house.xml"}).title == "house.xml"
    assert load_scenario("living_room", {}).title == "living_room"
