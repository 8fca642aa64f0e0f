import pytest
from pydantic import ValidationError

from deepgps.scenario import Scenario, check_scenario, digest, load_scenario, names_in, write_out
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
        ("room: !!python/object/apply:os.system [ls]", "line 1: could not determine a constructor"),
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
        ("seed: {", "line 1"),
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
