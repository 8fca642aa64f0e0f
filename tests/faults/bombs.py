"""Bombs: small hostile files are refused in one line or harmless, within seconds and a limited memory."""

import os
from collections.abc import Callable, Mapping

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import deepgps

LIMIT_S, LIMIT_MB = 90.0, 3000.0
"""A command may take as long to start, and its child ten seconds and 2 GB for a room."""
MAX_LINE_LETTERS = 2_000
"""Characters of one line that one still reads."""
SMALL_SCENARIO = (
    "drive: {samples: 16}\ngrid: {spacing_m: 1.0, headings: 1}\ncamera: {rings: 8, sectors: 32, face_px: 16}\n"
)
LAUGHS = "".join(f"x{n}: &x{n} [{', '.join([f'*x{n - 1}'] * 9)}]\n" for n in range(1, 10))
SCENARIOS = {
    "aliases of aliases": f"x0: &x0 [y]\n{LAUGHS}seed: *x9\n",
    "a list that holds itself": "seed: &a [*a]\n",
    "a deep list": f"seed: {'[' * 90_000}{']' * 90_000}\n",
    "20,000 keys": "".join(f"k{n}: 1\n" for n in range(20_000)),
    "a number of 100,000 digits": f"seed: {'9' * 100_000}\n",
    "a file of 3 MB": f"# {'x' * 3_000_000}\nseed: 1\n",
    "tags of Python": "seed: !!python/object/apply:os.system ['touch fallen']\n",
    "bytes that are no text": "\x00" * 1000,
}
STUDIES = {
    "a billion runs": "scenario: landmarks\naxes:\n"
    + "".join(f"  {name}: {list(range(1000))}\n" for name in ("learn.seed", "room.seed", "obstacles.seed")),
    "9,999 wrong runs": f"scenario: tiny\naxes: {{drive.samples: [{', '.join(f'w{n}' for n in range(9_999))}]}}\n",
}
DEEP_MODEL = "<body>" * 30_000 + '<geom size="0.1"/>' + "</body>" * 30_000
BODIES = {
    "replicate in replicate": '<replicate count="1000"><replicate count="1000"><replicate count="1000">'
    '<geom size="0.01"/></replicate></replicate></replicate>',
    "200,000 geoms": '<geom size="0.1"/>' * 200_000,
    "bodies in bodies": DEEP_MODEL,
    "a cable of 100 million": '<composite type="cable" count="100000000 1 1" size="1 1 1"><geom size="1"/></composite>',
    "no numbers": '<geom size="0.1" pos="nan 0 0"/>',
}
ASSETS = {
    "a large texture": '<asset><texture name="t" type="2d" builtin="flat" width="60000" height="60000"/></asset>',
    "a height field of 10^10": '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
    "memory by declaration": '<size memory="900G"/>',
    "reaching out": '<asset><mesh name="m" file="/etc/passwd"/></asset>',
    "including itself": '<include file="room.xml"/>',
}


def list_tests() -> list[Test]:
    """Every hostile file once."""
    rooms = {
        **{name: _room("", body) for name, body in BODIES.items()},
        **{name: _room(above, "") for name, above in ASSETS.items()},
    }
    return [
        _list_files("hostile scenarios", SCENARIOS, "bomb.yaml", ("collect", "bomb.yaml")),
        _list_files("hostile studies", STUDIES, "bomb.yaml", ("study", "bomb.yaml")),
        _list_files("hostile rooms", rooms, "room.xml", ("collect", "small.yaml", "--room.mjcf", "room.xml")),
    ]


def _list_files(what: str, texts: Mapping[str, str], file: str, words: tuple[str, ...]) -> Test:
    return Test("bombs", what, len(texts), _attack(texts, file, words), of=len(texts))


def _room(above: str, body: str) -> str:
    walls = ("-2 0 1", "0.05 2 1"), ("2 0 1", "0.05 2 1"), ("0 -2 1", "2 0.05 1"), ("0 2 1", "2 0.05 1")
    boxes = "".join(f'<geom type="box" pos="{place}" size="{size}"/>' for place, size in walls)
    return f'<mujoco>{above}<worldbody><geom type="plane" size="3 3 0.1"/>{boxes}{body}</worldbody></mujoco>'


def _attack(texts: Mapping[str, str], file: str, words: tuple[str, ...]) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        name = list(texts)[case.number % len(texts)]
        (case.folder / file).write_text(texts[name])
        (case.folder / "small.yaml").write_text(SMALL_SCENARIO)
        ended = deepgps(*words, "--out", "out", cwd=case.folder, time_s=LIMIT_S, memory_mb=LIMIT_MB)
        faults = {
            ended.fell: ended.fell,
            "ran code": os.path.lexists(case.folder / "fallen"),
            f"{len(ended.complaints)} lines": ended.code and len(ended.complaints) != 1,
            "a line of thousands of characters": ended.said > MAX_LINE_LETTERS,
            "left litter": ended.code and any(os.path.lexists(case.folder / one) for one in ("MUJOCO_LOG.TXT", "out")),
        }
        kind = next((kind for kind, found in faults.items() if found), "")
        return Verdict(
            kind or ("refused in a line" if ended.code else "taken, at no cost"),
            not kind,
            f"{name}: {ended.said} characters: {ended.show()}",
        )

    return attempt
