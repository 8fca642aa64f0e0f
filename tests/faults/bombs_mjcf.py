"""Hostile rooms: MJCF files, small, and made to hang, fill the memory, reach out, or fall out of a parser."""

import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

Write = Callable[[Path, random.Random], None]
"""Writes ``room.xml``, and what it draws on, to a folder."""
WALLS = "".join(
    f'<geom type="box" pos="{x} {y} 1" size="{a} {b} 1"/>'
    for x, y, a, b in ((-2, 0, 0.05, 2), (2, 0, 0.05, 2), (0, -2, 2, 0.05), (0, 2, 2, 0.05))
)
FLOOR = '<geom type="plane" size="3 3 0.1"/>'
CUBE = "\n".join(
    [f"v {x} {y} {z}" for x in (0, 0.2) for y in (0, 0.2) for z in (0, 0.2)]
    + ["f 1 2 3", "f 5 6 7", "f 1 2 5", "f 3 4 7", "f 1 3 5", "f 2 4 6"]
)


def room(body: str = "", above: str = "") -> str:
    """A whole room of 4 m x 4 m with something in it, and something above its world."""
    return f"<mujoco>{above}<worldbody>{FLOOR}{WALLS}{body}</worldbody></mujoco>"


def _body(*texts: str) -> Write:
    """One of these in the room; ``#`` stands for a large number."""
    return lambda folder, rng: save(folder, room(_large(rng.choice(texts), rng)))


def _above(*texts: str) -> Write:
    """One of these above the world; ``#`` stands for a large number."""
    return lambda folder, rng: save(folder, room("", _large(rng.choice(texts), rng)))


def _whole(*texts: str | bytes) -> Write:
    return lambda folder, rng: save(folder, rng.choice(texts))


def save(folder: Path, text: str | bytes, name: str = "room.xml") -> None:
    """Write a file."""
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())


def _large(text: str, rng: random.Random) -> str:
    return text.replace("#", str(rng.choice([10**5, 10**6, 10**7, 10**8, 10**9]) * rng.randint(2, 9)))


def _tower(folder: Path, rng: random.Random) -> None:
    """Files that each include the next more than once."""
    height, times = rng.randint(18, 30), rng.randint(2, 3)
    for n in range(height):
        inner = f'<include file="part{n + 1}.xml"/>' * times if n < height - 1 else "<worldbody/>"
        save(folder, f"<mujoco>{inner}</mujoco>", "room.xml" if n == 0 else f"part{n}.xml")


def _chain(folder: Path, rng: random.Random) -> None:
    """Files that each include the next once, without end to speak of."""
    height = rng.randint(500, 2000)
    for n in range(height):
        inner = f'<include file="part{n + 1}.xml"/>' if n < height - 1 else "<worldbody/>"
        save(folder, f"<mujoco>{inner}</mujoco>", "room.xml" if n == 0 else f"part{n}.xml")


def _circle(folder: Path, rng: random.Random) -> None:
    names = [f"part{n}.xml" for n in range(rng.randint(1, 6))]
    for here, after in zip(["room.xml", *names], [*names, "room.xml"], strict=True):
        save(folder, f'<mujoco><include file="{after}"/></mujoco>', here)


def _repeat(before: str, unit: str, after: str, low: int, high: int) -> Write:
    """Something again and again; ``{}`` is its number."""

    def write(folder: Path, rng: random.Random) -> None:
        count = rng.randint(low, high)
        save(folder, room(before + "".join(unit.replace("{}", str(n)) for n in range(count)) + after))

    return write


def _nested(start: str, end: str, low: int, high: int) -> Write:
    def write(folder: Path, rng: random.Random) -> None:
        depth = rng.randint(low, high)
        save(folder, room(start * depth + '<geom size="0.1"/>' + end * depth))

    return write


def png(width: int, height: int) -> bytes:
    """A black grey-scale picture, which packs a thousandfold."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    row = bytes(1 + (width + 7) // 8)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _picture(element: str, used: str) -> Write:
    def write(folder: Path, rng: random.Random) -> None:
        side = rng.randint(30_000, 50_000)
        (folder / "bomb.png").write_bytes(png(side, side))
        save(folder, room(used, f"<asset>{element}</asset>"))

    return write


def _asset(name: str, *contents: bytes) -> Write:
    """A mesh or another file that is not what it says, as an asset that is used."""
    kind = "hfield" if name.endswith((".bin", ".png")) else "mesh"
    used = f'<geom type="{kind}" {kind}="a"/>'
    size = ' size="1 1 1 1"' if kind == "hfield" else ""

    def write(folder: Path, rng: random.Random) -> None:
        (folder / name).write_bytes(rng.choice(contents))
        save(folder, room(used, f'<asset><{kind} name="a" file="{name}"{size}/></asset>'))

    return write


STL = b"x" * 80 + struct.pack("<I", 0xFFFFFFF0) + bytes(50 * 4)
NAN_STL = b"x" * 80 + struct.pack("<I", 4) + struct.pack("<12fH", *[float("nan")] * 12, 0) * 4
ROOMS: dict[str, Write] = {
    "25 files, each includes the next twice": _tower,
    "2,000 files, each includes the next": _chain,
    "files that include each other": _circle,
    "replicate": _body('<replicate count="#"><geom size="0.01"/></replicate>'),
    "replicate in replicate": _body(
        '<replicate count="1000"><replicate count="1000"><replicate count="1000"><geom size="0.01"/></replicate>'
        "</replicate></replicate>",
        '<replicate count="200"><replicate count="300"><body><geom size="0.01"/></body></replicate></replicate>',
    ),
    "replicate of nothing": _body(
        '<replicate count="#" offset="1 0 0"/>', '<replicate count="-1"><geom size="1"/></replicate>'
    ),
    "texture by its size": _above(
        '<asset><texture name="t" type="2d" builtin="checker" width="60000" height="60000"/></asset>',
        '<asset><texture name="t" type="2d" builtin="flat" width="#" height="2"/></asset>',
        '<asset><texture name="t" type="skybox" builtin="gradient" width="40000" height="240000"/></asset>',
        '<asset><texture name="t" type="cube" builtin="flat" width="30000" height="30000"/></asset>',
        '<asset><texture name="t" type="2d" builtin="flat" width="9000" height="9000" nchannel="#"/></asset>',
    ),
    "30 textures of 8,192": lambda folder, rng: save(
        folder,
        room(
            "",
            "<asset>"
            + "".join(
                f'<texture name="t{n}" type="2d" builtin="flat" width="8192" height="8192"/>'
                for n in range(rng.randint(25, 60))
            )
            + "</asset>",
        ),
    ),
    "height field by its size": _above(
        '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
        '<asset><hfield name="h" nrow="#00" ncol="2" size="1 1 1 1"/></asset>',
        '<asset><hfield name="h" nrow="2147483647" ncol="2147483647" size="1 1 1 1"/></asset>',
    ),
    "picture that unpacks to 1 GB, as texture": _picture('<texture name="t" type="2d" file="bomb.png"/>', ""),
    "picture that unpacks to 1 GB, as height field": _picture(
        '<hfield name="h" file="bomb.png" size="1 1 1 1"/>', '<geom type="hfield" hfield="h"/>'
    ),
    "mesh by builtin size": _above(
        '<asset><mesh name="m" builtin="supersphere" params="30000 0.5 0.5"/></asset>',
        '<asset><mesh name="m" builtin="sphere" params="14"/></asset>',
        '<asset><mesh name="m" builtin="supertorus" params="#"/></asset>',
    ),
    "mesh file that lies about its length": _asset("a.stl", STL, STL[:84], b"solid", b""),
    "mesh of NaN": _asset("a.stl", NAN_STL),
    "mesh of numbers that are none": _asset(
        "a.obj",
        CUBE.replace("0.2", "nan").encode(),
        CUBE.replace("0.2", "1e308").encode(),
        CUBE.replace("f 1 2 3", "f 1 2 99999999").encode(),
        CUBE.replace("f 1 2 3", "f -99 0 1").encode(),
        b"v 0 0 0\n" * 3 + b"f 1 2 3\n",
        b"\x00\xff" * 500,
    ),
    "mesh file of MuJoCo's that lies": _asset(
        "a.msh", struct.pack("<4i", 2**31 - 1, 0, 0, 2**31 - 1), struct.pack("<4i", -1, 0, 0, -1)
    ),
    "height-field file that lies": _asset(
        "a.bin", struct.pack("<2i", 60000, 60000), struct.pack("<2i", -5, -5), b"\x01"
    ),
    "mesh of 3 million inline vertices": lambda folder, rng: save(
        folder,
        room(
            '<geom type="mesh" mesh="m"/>',
            (f'<asset><mesh name="m" vertex="{"0 0 1 " * rng.randint(900_000, 3_000_000)}"/></asset>'),
        ),
    ),
    "300,000 geoms": _repeat("", '<geom size="0.1" pos="0 {} 0"/>', "", 150_000, 300_000),
    "100,000 bodies": _repeat("", '<body pos="0 {} 0"><geom size="0.1"/></body>', "", 60_000, 100_000),
    "100,000 lights": _repeat("", '<light pos="0 {} 3"/>', "", 60_000, 100_000),
    "200,000 sites": _repeat("", '<site pos="0 {} 3"/>', "", 100_000, 200_000),
    "100,000 cameras": _repeat("", '<camera pos="0 {} 3"/>', "", 60_000, 100_000),
    "bodies in bodies": _nested("<body>", "</body>", 2_000, 30_000),
    "frames in frames": _nested("<frame>", "</frame>", 2_000, 100_000),
    "XML a million deep": _nested("<a>", "</a>", 300_000, 1_000_000),
    "200,000 classes": lambda folder, rng: save(
        folder,
        room(
            "",
            "<default>"
            + "".join(f'<default class="c{n}"/>' for n in range(rng.randint(50_000, 200_000)))
            + "</default>",
        ),
    ),
    "composite": _body(
        '<composite type="cable" count="# 1 1" size="1 1 1"><geom size="0.1"/></composite>',
        '<composite type="grid" count="1000 1000 1000" spacing="0.1"><geom size="0.01"/></composite>',
        '<composite type="cable" curve="s" count="30000 1 1" size="9" offset="0 0 1"><geom size="1"/></composite>',
    ),
    "flexible bodies": _body('<flexcomp name="f" type="grid" count="# 100 100" spacing="0.1 0.1 0.1"/>'),
    "memory by declaration": _above(
        *('<size memory="900G"/>', '<size nstack="#"/>', '<size njmax="#" nconmax="#"/>', '<size nuser_geom="#"/>'),
        *(
            '<custom><numeric name="n" size="#"/></custom>',
            '<size nkey="#"/>',
            '<size nuserdata="#"/>',
            '<size memory="-1"/>',
        ),
        *('<size nuser_body="#"/>', '<size nuser_cam="#"/>', '<size nuser_site="#"/>'),
    ),
    "pictures by declaration": _above(
        '<visual><global offwidth="#" offheight="#"/></visual>',
        '<visual><quality shadowsize="#" offsamples="#"/></visual>',
        '<visual><quality numslices="#" numstacks="#" numquads="#"/></visual>',
        '<visual><map znear="nan" zfar="inf"/></visual>',
    ),
    "numbers that are none": _body(
        *('<geom type="box" size="0.1 0.1 0.1" pos="nan 0 0"/>', '<geom size="0.1" pos="1e308 0 0"/>'),
        *('<geom size="nan"/>', '<geom size="inf"/>', '<geom size="1e-320"/>', '<geom size="0.1" quat="0 0 0 0"/>'),
        *('<geom size="0.1" pos="inf 0 0"/>', '<body pos="nan nan nan"><geom size="0.1"/></body>', '<geom size="-1"/>'),
        *('<body quat="nan 0 0 1"><geom size="0.1"/></body>', '<geom size="0.1" euler="1e300 nan 0"/>'),
        *('<geom type="plane" size="nan nan nan"/>', '<geom size="1e308"/>', '<geom size="0.1" mass="nan"/>'),
        *('<light pos="nan nan nan"/>', '<geom size="0.1" rgba="nan 1 1 1"/>', '<geom size="0.1" friction="nan"/>'),
        *('<body pos="1e38 0 0"><body pos="1e38 0 0"><geom type="box" size="1 1 1"/></body></body>',),
    ),
    "a room of 1,000 km": _body(
        '<geom type="box" size="500000 500000 1" pos="0 0 9"/>',
        '<geom type="box" size="1 1 1" pos="# 0 1"/>',
        '<geom type="box" size="1 1 1" pos="# # 1"/><geom type="box" size="1 1 1" pos="-# -# 1"/>',
    ),
    "names of the robot's": _body(
        *(
            f'<body name="{name}"><geom size="0.1" pos="1 1 1"/></body>'
            for name in ("robot/base", "robot/", "robot", "base")
        ),
        '<geom name="robot/base" size="0.1" pos="1 1 1"/>',
        '<body name="robot/base"><freejoint/><geom name="robot/left" size="0.1" pos="1 1 1"/></body>',
        '<camera name="robot/fisheye"/><site name="robot/base"/><light name="robot/base"/>',
    ),
    "names of the robot's among assets": _above(
        '<asset><material name="robot/black"/><material name="robot/"/></asset>',
        '<default><default class="robot/"/></default>',
        '<default class="robot/main"/>',
    ),
    "no room to drive": _whole(
        *(f"<mujoco><worldbody>{text}</worldbody></mujoco>" for text in ("", '<geom type="box" size="9 9 9"/>')),
        *(
            "<mujoco/>",
            "<mujoco><worldbody/></mujoco>",
            '<mujoco><worldbody><geom type="plane" size="0 0 1"/></worldbody></mujoco>',
        ),
    ),
    "entities": _whole(
        '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><mujoco model="&b;"/>',
        '<!DOCTYPE m [<!ENTITY a SYSTEM "file:///etc/passwd">]><mujoco model="&a;"/>',
        '<!DOCTYPE m SYSTEM "http://127.0.0.1:9/x.dtd"><mujoco/>',
        '<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE m [<!ENTITY a "b">]><mujoco model="&a;"/>'.encode("utf-16"),
        b"<?xml version='1.0' encoding='utf-7'?>+ADwAIQ-DOCTYPE m+AD4-<mujoco/>",
    ),
    "not XML": _whole(
        "",
        "<",
        "<mujoco",
        "<mujoco></worldbody>",
        b"\x00" * 999,
        b"\xff\xfe\xff",
        "<a/><b/>",
        "<urdf/>",
        "{}",
        "<mujoco>\x01</mujoco>",
    ),
    "wrong MJCF": _body(
        *(
            "<nothing/>",
            '<geom type="ball" size="1"/>',
            '<geom size="x"/>',
            '<geom size="0.1" material="none"/>',
            "<geom/>",
        ),
        *(
            '<geom name="a" size="1"/><geom name="a" size="1"/>',
            '<geom type="mesh"/>',
            '<body childclass="none"/>',
            "<joint/>",
        ),
        *(
            '<body><joint type="free"/></body>',
            '<geom size="1 2 3 4 5 6 7 8 9"/>',
            f'<geom name="{"n" * 500_000}" size="x"/>',
        ),
    ),
    "reaching out": _above(
        *(
            '<asset><mesh name="m" file="/etc/passwd"/></asset>',
            '<asset><texture name="t" type="2d" file="../../x.png"/></asset>',
        ),
        *(
            '<include file="/etc/passwd"/>',
            '<include file="../x.xml"/>',
            '<compiler meshdir="/"/>',
            '<compiler assetdir=".."/>',
        ),
        *('<asset><model name="m" file="/etc/passwd"/></asset>', '<extension><plugin plugin="x"/></extension>'),
        *(
            '<asset><hfield name="h" file="file:///etc/passwd" size="1 1 1 1"/></asset>',
            '<asset><skin file="/etc/x.skn"/></asset>',
        ),
    ),
}
"""What is said of it, and what writes it: a room that must be refused, or driven as if it were none of this."""
