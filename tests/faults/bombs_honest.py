"""What is large and honest: no limit may refuse it."""

import random
import time
from collections.abc import Callable
from pathlib import Path

from tests.faults.attack import Case, Test, Verdict
from tests.faults.bombs_mjcf import png, room
from tests.faults.command import finish, has_ended, kill_all, start

LONGEST_S = 120.0
SMALL = "drive: {samples: 16}\ngrid: {spacing_m: 1.0, headings: 1}\ncamera: {rings: 8, sectors: 32, face_px: 16}\n"
"""A scenario for a room: so little is driven in it that only the room itself costs time."""


def list_tests() -> list[Test]:
    """Large rooms, and a large study."""
    rooms = (
        ("four walls", _walls),
        ("5,000 geoms", _many_geoms),
        ("2 million triangles", _triangles),
        ("100 textures of 2,048 px", _textures),
    )
    return [
        *(Test("bombs", f"honest: a room of {name}", 1, _take_room(write)) for name, write in rooms),
        Test("bombs", "honest: a study of 2,000 runs", 1, _take_study),
    ]


def _take_room(write: Callable[[Path, random.Random], None]) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        write(case.folder, case.rng)
        (case.folder / "small.yaml").write_text(SMALL)
        words = ["collect", "small.yaml", "--out", "out", "--room.mjcf", "room.xml"]
        return _wait_for(words, case, lambda: any((case.folder / "out").rglob("drive-*.npz")), "driven")

    return attempt


def _take_study(case: Case) -> Verdict:
    """Planned: its recordings are begun."""
    text = f"scenario: landmarks\naxes: {{learn.seed: {list(range(50))}, learn.train.steps: {list(range(10, 50))}}}\n"
    (case.folder / "long.yaml").write_text(text)
    out = case.folder / "out"
    return _wait_for(["study", "long.yaml", "--out", "out"], case, lambda: any(out.glob("recordings/*")), "planned")


def _wait_for(words: list[str], case: Case, reached: Callable[[], bool], done: str) -> Verdict:
    """Wait until a command has come so far, and end it."""
    running = start(words, cwd=case.folder)
    while not reached() and not has_ended(running) and time.monotonic() - running.started < LONGEST_S:
        time.sleep(0.05)
    took, taken = time.monotonic() - running.started, reached()
    kill_all(running)
    ended = finish(running)
    return Verdict(
        f"{done} in {took:.0f} s" if taken else "refused or too slow", taken, f"after {took:.0f} s: {ended.show()}"
    )


def _walls(folder: Path, rng: random.Random) -> None:
    """Without it the refusals of hostile rooms would prove nothing."""
    (folder / "room.xml").write_text(room())


def _many_geoms(folder: Path, rng: random.Random) -> None:
    geoms = (f'<geom size="0.01" pos="{rng.uniform(-1.9, 1.9)} 1.9 {rng.uniform(0.5, 2)}"/>' for _ in range(5000))
    (folder / "room.xml").write_text(room("".join(geoms)))


def _triangles(folder: Path, rng: random.Random) -> None:
    """A relief of a thousand by a thousand squares, high on the wall."""
    side = 1001
    lines = [f"v {x / side} {rng.random() * 0.01} {y / side}" for y in range(side) for x in range(side)]
    for y in range(side - 1):
        for x in range(side - 1):
            a = y * side + x + 1
            lines += (f"f {a} {a + 1} {a + side}", f"f {a + 1} {a + side + 1} {a + side}")
    (folder / "relief.obj").write_text("\n".join(lines))
    mesh = '<asset><mesh name="m" file="relief.obj" inertia="shell"/></asset>'
    (folder / "room.xml").write_text(room('<geom type="mesh" mesh="m" pos="0 1.8 1"/>', mesh))


def _textures(folder: Path, rng: random.Random) -> None:
    assets, used = "", ""
    for n in range(100):
        (folder / f"t{n}.png").write_bytes(png(2048, 2048))
        assets += f'<texture name="t{n}" type="2d" file="t{n}.png"/><material name="m{n}" texture="t{n}"/>'
        used += f'<geom size="0.05" material="m{n}" pos="{-1.8 + n * 0.036} 1.9 1"/>'
    (folder / "room.xml").write_text(room(used, f"<asset>{assets}</asset>"))
