import hashlib
import json

import pytest
from pydantic import ValidationError

from deepgps.scenario import Scenario, check_scenario, digest, digest_recording, load_scenario, names_in, write_out
from sim.errors import InputError
from sim.paths import SCENARIOS


def write(tmp_path, text: str) -> str:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("name", names_in(SCENARIOS))
def test_every_scenario_loads_and_comes_back_from_what_it_writes(name, tmp_path):
    scenario = load_scenario(name, {})
    assert scenario.name == name
    assert load_scenario(write(tmp_path, write_out(scenario)), {}) == scenario


def test_overrides_win_and_are_converted():
    scenario = load_scenario("living_room", {"room.seed": "3", "encoder.gap_noise": "1e-1", "room.mjcf": None})
    assert (scenario.room.seed, scenario.encoder.gap_noise, scenario.room.mjcf) == (3, 0.1, None)


def test_numbers_that_yaml_reads_as_text_are_numbers(tmp_path):
    assert load_scenario(write(tmp_path, "learn: {train: {learning_rate: 1e-3}}"), {}).learn.train.learning_rate == 1e-3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "mine.yaml is empty"),
        ("- 1", "mine.yaml holds a list; a settings file is a mapping"),
        (
            "room: !!python/object/apply:os.system [ls]",
            "line 1: the tag 'tag:yaml.org,2002:python/object/apply:os.system' is not allowed",
        ),
        ("room: {kind: attic}", "room.kind 'attic': must be 'living_room', 'bedroom'"),
        ("room: {sed: 3}", "room.sed: there is no such setting, did you mean seed?"),
        ("rooom: {}", "rooom: there is no such setting, did you mean room?"),
        ("encoder: {ticks_per_rev: 3}", "encoder.ticks_per_rev 3: must be greater than or equal to 4"),
        ("encoder: {ticks_per_rev: .nan}", "encoder.ticks_per_rev nan: must be a finite number"),
        ("drive: {control_period_s: 0.013}", "must be a whole multiple of robot.timestep_s"),
        ("methods: []", "methods: at least one method, each once"),
        ("methods: [deepgps, deepgps]", "methods: at least one method, each once"),
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
        ("world: {}", "world {}: must be 'room', 'landmarks' or 'lidar'"),
        ("{world: landmarks, image: {exposure: 0.5}}", "image has faults of images, which need world room and sensor"),
        (
            "{sensor: lidar, mount: {roll_deg: 2}}",
            "mount has faults of images, which need world room and sensor fisheye",
        ),
        (
            "{grid: {held_out: 5}, use: {light: 0.5}}",
            "use changes the room of the test grid, and grid.held_out 5 has none",
        ),
        (
            "{room: {mjcf: a.xml}, use: {moved_m: 0.5}}",
            "use.moved_m needs a room whose furniture is known, and room.mjcf",
        ),
        ("image: {exposure: 0}", "image.exposure 0: must be greater than 0"),
        ("image: {vignetting: 1}", "image.vignetting 1: must be less than or equal to 0.99"),
        ("use: {light: 1.5}", "use.light 1.5: must be less than or equal to 1"),
        ("seed: {", "line 2: did not find expected node content"),
        ("seed: 1\nseed: 2", "line 2: seed stands twice"),
        ("name: ../up", "name '../up': string should match pattern"),
    ],
)
def test_wrong_input_is_named_in_one_line(tmp_path, text, message):
    with pytest.raises(InputError) as caught:
        load_scenario(write(tmp_path, text), {})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_does_not_exist_and_a_name_that_does_not():
    with pytest.raises(InputError, match=r"scenario nowhere/x\.yaml: no such file"):
        load_scenario("nowhere/x.yaml", {})
    with pytest.raises(InputError, match=r"scenario 'nowhere' does not exist; there are .*living_room"):
        load_scenario("nowhere", {})


def test_an_override_inside_a_plain_value_is_refused():
    with pytest.raises(InputError, match=r"seed\.x: seed is not a group"):
        load_scenario("living_room", {"seed": "1", "seed.x": "2"})


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


def test_groups_of_faults_that_are_off_leave_the_digests_as_they_were_before_there_were_any():
    scenario = load_scenario("tiny", {})
    values = json.loads(scenario.model_dump_json())
    sim = {name: value for name, value in values.items() if name in type(scenario.sim).model_fields}
    for digest_of, head, part in ((digest, "1 ", values), (digest_recording, "1 0 ", sim)):
        before = {name: value for name, value in part.items() if name not in {"image", "mount", "use"}}
        text = head + json.dumps(before, separators=(",", ":"))
        assert digest_of(scenario) == hashlib.sha256(text.encode()).hexdigest()[:8]


@pytest.mark.parametrize("fault", ["image.exposure", "mount.roll_deg", "use.light"])
def test_a_fault_makes_another_run_and_another_recording(fault):
    plain, faulty = load_scenario("tiny", {}), load_scenario("tiny", {fault: 0.5})
    assert digest(plain) != digest(faulty)
    assert digest_recording(plain) != digest_recording(faulty)
