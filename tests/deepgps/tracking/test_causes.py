"""Laws of naming causes, in a drawn room: each fault is named, a clean drive has none, and light is never furniture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.tracking import causes
from deepgps.tracking.causes import FAULTY_CAUSES, TITLES, WINDOW, Causes, Monitor, Watch, make_monitor, name_causes
from sim.recording.format import Recording, open_recording
from tests.helpers.drawn_room import HIGH_CORNER, MOVED_PILLARS, Room, drive, train

SEGMENTS, IMAGES = 90, 24
Drawn = tuple[Monitor, Recording]


@pytest.fixture(scope="module")
def like(small_recording: Path) -> Recording:
    return open_recording(small_recording)


@pytest.fixture(scope="module", params=["ranks", pytest.param("pixels", marks=pytest.mark.slow)])
def drawn(request: pytest.FixtureRequest, like: Recording) -> Drawn:
    """A monitor in the drawn room, and a clean deployment drive."""
    recording = drive(like, Room(), SEGMENTS, 1)
    monitor = make_monitor(train(recording, request.param), recording)
    assert monitor is not None
    return monitor, drive(like, Room(), IMAGES, 2)


def see(drive: Recording, change) -> Recording:
    """The drive with images that are changed."""
    return replace(drive, observation=change(drive.observation.astype(float)).clip(0, 255).astype(np.uint8))


def test_a_clean_drive_has_no_cause(drawn: Drawn):
    found = drawn[0].name(drawn[1])
    assert found.named == []
    assert (found.label != "").mean() <= 0.05
    assert set(found.label[found.accepted]) == {""}
    assert "" not in set(found.label[~found.accepted])


FAULTS = {
    "black": lambda images: 0.02 * images,
    "white": lambda images: 250.0 + 0.02 * images,
    "covered": lambda images: 0.03 * images + 0.5 * images.mean(axis=(1, 2, 3), keepdims=True),
    "frozen": lambda images: np.repeat(images[30:31], len(images), axis=0),
    "light": lambda images: 255.0 * (images / 255.0) ** 1.6 * 0.7,
}


def test_changed_images_are_named(drawn: Drawn):
    for name, change in FAULTS.items():
        found = drawn[0].name(see(drawn[1], change))
        assert found.named[0] == name
        assert (found.label == name).mean() > 0.95
        assert name == "light" or not found.accepted[found.label == name].any()
    half = drawn[1].observation.copy()
    half[:, :, 10:42] = 45
    assert (drawn[0].name(replace(drawn[1], observation=half)).label == "covered").mean() > 0.95


def test_moved_furniture_is_named(drawn: Drawn, like: Recording):
    found = drawn[0].name(drive(like, Room(pillars=MOVED_PILLARS), IMAGES, 2))
    assert found.named[0] == "furniture"
    refused = found.label[~found.accepted]
    assert (refused == "furniture").mean() > 0.8


def test_another_room_is_named(drawn: Drawn, like: Recording):
    found = drawn[0].name(drive(like, Room(seed=9), IMAGES, 2))
    assert found.named == ["other_room"]
    assert found.accepted.mean() < 0.05


def test_places_that_were_not_driven_are_named(like: Recording):
    recording = drive(like, Room(), SEGMENTS, 1, high=np.array([1.5, HIGH_CORNER[1]]))
    use = drive(like, Room(), IMAGES, 2)
    found = name_causes(train(recording, "ranks"), recording, use)
    assert found is not None
    far = use.others["place"][:, 0] > 1.8
    assert not found.accepted[far].any()
    assert (found.label[far] == "new_place").mean() > 0.9
    assert found.named[0] == "new_place"


def test_a_knocked_camera_is_named_by_the_turns(drawn: Drawn, like: Recording):
    found = drawn[0].name(drive(like, Room(), IMAGES, 2, lean=(np.radians(4.0), 0.0)))
    assert found.named[0] == "camera"
    assert found.lean_deg == pytest.approx(4.0, abs=0.5)
    assert (found.label[~found.accepted] == "camera").mean() > 0.8


def test_monotone_change_of_light_is_never_furniture(drawn: Drawn):
    for gain, power in ((0.3, 1.0), (0.6, 0.6), (0.9, 1.0), (1.0, 1.8), (0.5, 1.4)):
        relit = (255.0 * gain * (drawn[1].observation / 255.0) ** power).astype(np.uint8)
        found = drawn[0].name(replace(drawn[1], observation=relit))
        assert "furniture" not in found.named and found.named[0] == "light"
        assert (found.label == "light").mean() > 0.9


def test_headings_of_the_robot_change_nothing(drawn: Drawn):
    monitor, clean = drawn
    found = monitor.register(clean.observation[:60])
    for sectors in (8, 30):
        turned = monitor.register(np.roll(clean.observation[:60], sectors, axis=2))
        for part in ("gain", "unlike_features", "unlike_pixels"):
            np.testing.assert_allclose(getattr(turned, part), getattr(found, part), atol=1e-3)


def test_most_left_out_images_are_placed_nearer_than_is_usual(like: Recording) -> None:
    appearance = train(drive(like, Room(), SEGMENTS, 1), "ranks").appearance
    assert appearance is not None
    calibration = appearance.registration.calibration
    assert 0.0 < calibration.left_out < calibration.difference


@pytest.mark.parametrize("images", [80, pytest.param(10_000, marks=pytest.mark.slow)])
def test_causes_of_images_as_they_come_are_those_of_the_drive(drawn: Drawn, like: Recording, images: int):
    monitor, clean = drawn
    moved = drive(like, Room(pillars=MOVED_PILLARS), IMAGES, 2)
    for use in (moved, see(clean, FAULTS["light"])) if images == 80 else (clean, moved, see(clean, FAULTS["covered"])):
        known, watch = monitor.name(use), Watch(monitor)
        found = [watch.step(image) for image in use.observation[:images]]
        assert np.mean(np.array(found) == known.label[:images]) > 0.8  # the first images know few others


@pytest.mark.slow
def test_another_room_is_told_once_many_images_have_come(drawn: Drawn, like: Recording):
    watch = Watch(drawn[0])
    found = [watch.step(image) for image in drive(like, Room(seed=9), IMAGES, 2).observation[: WINDOW + 5]]
    assert "other_room" not in found[: WINDOW - 1]
    assert found.count("new_place") > 0.9 * WINDOW
    assert set(found[WINDOW:]) == {"other_room"}


def test_a_method_that_accepts_all_names_nothing(drawn: Drawn):
    monitor, clean = drawn
    assert make_monitor(replace(monitor.positioner, appearance=None), clean) is None


def test_the_sentence_says_what_is_accepted_refused_and_changed():
    label = np.array(["light"] * 60 + ["furniture"] * 5 + [""] * 35)
    accepted = np.arange(100) >= 10
    accepted[60:65] = False
    found = Causes(label, accepted, 2.04, True, 0.5)
    said = causes.describe_causes(found.summarise())
    for part in ("85.0 % of images accepted", "refused: light or exposure changed 10.0 %", "0.50 times", "2.0°"):
        assert part in said
    assert set(found.named) == {"camera", "light", "furniture"} < set(TITLES)


def name(**held: bool) -> str:
    """The cause of one image of which only this holds."""

    def tell(sign: str) -> np.ndarray:
        return np.array([held.get(sign, False)])

    signs = {one: tell(one) for one in (*FAULTY_CAUSES, "accepted", "known_place", "relit", "changed")}
    relit = np.array([0.6 * held.get("mostly_relit", False) + 0.3 * held.get("relit", False)])
    changed = np.array([0.6 * held.get("mostly_changed", False) + 0.3 * held.get("some_changed", False)])
    around = {"relit": relit, "changed": changed}
    return str(causes.label(signs, around, held.get("leaning", False), tell("other_room"))[0])


def test_the_first_rule_that_holds_names_the_cause():
    assert name() == "new_place" == name(known_place=True) == name(changed=True)
    assert name(accepted=True) == "" == name(accepted=True, mostly_relit=True, mostly_changed=True, other_room=True)
    assert name(changed=True, some_changed=True, accepted=True) == "furniture" == name(mostly_changed=True)
    assert name(mostly_changed=True, other_room=True) == "other_room"
    assert name(known_place=True, leaning=True, other_room=True) == "camera"
    assert name(known_place=True, relit=True, accepted=True) == "light" == name(mostly_relit=True)
    for fault in FAULTY_CAUSES:
        assert name(**{fault: True}, accepted=True, known_place=True, relit=True) == fault
    assert name(covered=True, white=True) == "white" and name(covered=True, black=True) == "black"
    assert set(FAULTY_CAUSES) < set(TITLES)


def test_a_long_stretch_is_of_another_room_and_a_short_one_is_not():
    new = np.zeros(3 * WINDOW, bool)
    new[WINDOW : 2 * WINDOW] = True
    new[WINDOW + 20] = False
    assert causes.find_long(new)[WINDOW : 2 * WINDOW].all()
    assert not causes.find_long(new)[: WINDOW // 2].any()
    new[WINDOW + 40 :] = False
    assert not causes.find_long(new).any()
    assert causes.find_long(np.ones(5, bool), 5).all() and not causes.find_long(np.ones(5, bool)).any()
    assert causes.find_long(np.zeros(0, bool), 0).shape == (0,)


def test_shares_are_those_of_the_images_around():
    found = np.random.default_rng(1).random(300) < 0.3
    share = causes.share_around(found)
    for row in (0, 10, 150, 299):
        some = slice(max(0, row - causes.NEIGHBOURS), row + causes.NEIGHBOURS + 1)
        assert share[row] == pytest.approx(found[some].mean())
