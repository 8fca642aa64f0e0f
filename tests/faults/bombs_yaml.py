"""Hostile settings files: small, and made to hang, fill the memory, fill the screen, or fall out of a parser."""

import random
from collections.abc import Callable

Make = Callable[[random.Random], str | bytes]


def _laughs(field: str) -> Make:
    """Lists of lists that share each other: few bytes, and billions of values."""

    def make(rng: random.Random) -> str:
        depth, width = rng.randint(8, 11), rng.randint(8, 11)
        lines = ["x0: &x0 [lol, lol]"]
        lines += [f"x{n}: &x{n} [{', '.join([f'*x{n - 1}'] * width)}]" for n in range(1, depth)]
        return "\n".join([*lines, f"{field}: *x{depth - 1}", ""])

    return make


def _merges(rng: random.Random) -> str:
    depth, width = rng.randint(8, 12), rng.randint(8, 12)
    lines = ["a0: &a0 {seed: 1}"]
    lines += [f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * width)}]}}" for n in range(1, depth)]
    return "\n".join([*lines, f"room: *a{depth - 1}", ""])


def _repeated(before: str, unit: str, after: str = "", most: int = 900_000, least: int = 1) -> Make:
    """One thing again and again, up to what a settings file may be long."""

    def make(rng: random.Random) -> str:
        count = rng.randint(max(least, most // len(unit) // 2), most // len(unit))
        return before + unit * count + after * count + "\n"

    return make


def _keys(text: str, count: int) -> Make:
    return lambda rng: "\n".join(text.format(n) for n in range(rng.randint(count // 2, count))) + "\n"


def _plain(*texts: str | bytes) -> Make:
    return lambda rng: rng.choice(texts)


SCENARIOS: dict[str, Make] = {
    "aliases of aliases in a number": _laughs("seed"),
    "aliases of aliases in a group": _laughs("room"),
    "aliases of aliases in a list": _laughs("methods"),
    "aliases of aliases in a key": lambda rng: "\n".join(str(_laughs("y")(rng)).split("\n")[:-2]) + "\n? *x7\n: 1\n",
    "merges of merges": _merges,
    "a list that holds itself": _plain("seed: &a [*a]\n", "methods: &a [*a, *a]\n", "room: &a {kind: *a}\n"),
    "a mapping merged with itself": _plain("room: &a {<<: *a}\n", "&a <<: *a\n"),
    "100,000 keys": _keys("k{}: 1", 95_000),
    "100,000 keys in a group": lambda rng: (
        "room: {" + ", ".join(f"k{n}: 1" for n in range(rng.randint(40_000, 80_000))) + "}\n"
    ),
    "20,000 near misses of a setting": _keys("methods{}: 1", 40_000),
    "100,000 equal keys": _keys("seed: {}", 90_000),
    "100,000 anchors": _keys("- &a{} 1", 60_000),
    "100,000 documents": _repeated("seed: 1\n", "--- 1\n"),
    "a deep list": _repeated("seed: ", "[", "]", 400_000),
    "a deep list that does not end": _repeated("seed: ", "["),
    "a deep mapping": _repeated("", "{a: ", "}", 300_000),
    "deep by indentation": lambda rng: "\n".join(" " * n + "a:" for n in range(rng.randint(700, 1300))) + "\n",
    "deep dashes": _repeated("seed:\n", "- "),
    "complex keys": _repeated("", "? "),
    "a text of 900 kB": _repeated("name: ", "x"),
    "a text of 900 kB for a number": _repeated("seed: ", "y"),
    "a key of 900 kB": lambda rng: "k" * rng.randint(400_000, 900_000) + ": 1\n",
    "a list of 400,000 for a number": _repeated("seed: [", "1,", "", 900_000),
    "a number of 900,000 digits": lambda rng: f"seed: {'9' * rng.randint(100_000, 900_000)}\n",
    "a number of 900,000 digits, hexadecimal": lambda rng: f"seed: 0x{'f' * rng.randint(100_000, 900_000)}\n",
    "a number of 900,000 digits, octal": lambda rng: f"seed: 0{'7' * rng.randint(100_000, 900_000)}\n",
    "a number of 900,000 digits, binary": lambda rng: f"seed: 0b{'1' * rng.randint(100_000, 900_000)}\n",
    "a number to base 60": lambda rng: f"seed: 1{':59' * rng.randint(50_000, 300_000)}\n",
    "a fraction to base 60": lambda rng: f"seed: 1{':59' * rng.randint(50_000, 300_000)}.5\n",
    "a number of 5,000 digits": lambda rng: f"seed: {'7' * rng.randint(4_301, 6_000)}\n",
    "a comment of 900 kB and nothing": _repeated("# ", "c"),
    "a line of quotes": _repeated("name: ", "''"),
    "escapes": _repeated('name: "', "\\x41"),
    "a date that is none": _plain("seed: 2024-13-45\n", "seed: 2024-02-30 25:61:61\n", "room: {seed: 9999-99-99}\n"),
    "tags that do not fit": _plain(
        *(f"seed: !!{kind} abc\n" for kind in ("int", "float", "bool", "timestamp", "null", "binary", "seq", "set")),
        *("seed: !!binary é\n", "seed: !!omap [a]\n", "seed: !!pairs [a]\n", "seed: !!int ''\n", "seed: !!bool ''\n"),
        *("seed: !!float '-'\n", "seed: !!int '+'\n", "seed: !!timestamp ''\n", "? !!map {a: 1}\n: 2\n"),
    ),
    "tags of Python": _plain(
        *("seed: !!python/object/apply:os.system ['touch fallen']\n", "seed: !!python/name:os.system\n"),
        "!!python/object/new:os._exit [7]\n",
    ),
    "keys that cannot be keys": _plain(
        "{[1, 2]: 3}\n", "? {a: 1}\n: 2\n", "!!set {? [1]}\n", "1: 2\n", "null: 1\n", "~\n"
    ),
    "infinities": _plain(
        "drive: {spacing_m: .inf}\n", "grid: {spacing_m: .nan}\n", "learn: {train: {learning_rate: 1e999}}\n"
    ),
    "bytes that are no text": _plain(
        b"\xff\xfe\x00\x00", b"seed: \xff\n", b"\x00" * 1000, b"seed: 1\x00\n", b"\xef\xbb\xbf\xff"
    ),
    "UTF-16 and UTF-32": _plain(*("seed: x\n".encode(code) for code in ("utf-16", "utf-32", "utf-16-be"))),
    "control characters": _plain(
        "name: \x1b[2J\n", "name: '\x07'\n", 'name: "\\u0000"\n', "name: \x7f\n", 'name: "\\ud800"\n'
    ),
    "escape sequences in a quoted name": _plain('name: "\\e[31mred\\e[0m"\n', 'name: "[red]x[/red]\\r\\n"\n'),
    "names that lead out": _plain("name: ../../x\n", "name: /etc\n", "name: ''\n", "name: .\n"),
    "a file of 30 MB": lambda rng: "# " + "x" * rng.randint(2_000_000, 30_000_000) + "\nseed: 1\n",
    "not a mapping": _plain(
        "", "\n", "[]\n", "1\n", "- a\n", "---\n...\n", "%YAML 9.9\n---\na: 1\n", "%TAG ! x\n", "@\n", "`\n"
    ),
    "syntax": _plain(
        "a: b: c\n", "\tseed: 1\n", "seed: 'x\n", "seed: {\n", "seed: *nothing\n", "seed: &a\n- *a", "- a\nb: 1\n"
    ),
}
"""What is said of it, and what makes it: a scenario that must be refused."""


def _grid(*lengths: int) -> Make:
    names = ("learn.seed", "room.seed", "obstacles.seed", "learn.train.steps")

    def make(rng: random.Random) -> str:
        axes = [f"  {name}: {list(range(rng.randint(n * 3 // 4, n)))}" for name, n in zip(names, lengths, strict=False)]
        return "\n".join(["scenario: landmarks", "axes:", *axes, ""])

    return make


STUDIES: dict[str, Make] = {
    "a billion runs on three axes": _grid(1000, 1000, 1000),
    "10^15 runs on five axes": _grid(1000, 1000, 1000, 1000, 1000),
    "a hundred million runs on two axes": _grid(10_000, 10_000),
    "200,000 seeds": lambda rng: f"scenario: landmarks\nseeds: {list(range(rng.randint(60_000, 120_000)))}\n",
    "axes of aliases of aliases": lambda rng: (
        "scenario: tiny\n"
        + "\n".join(
            line if line.startswith("x") else "axes: {learn.seed: *x7}"
            for line in str(_laughs("y")(rng)).split("\n")[:-1]
        )
    ),
    "20 axes of 20": lambda rng: (
        "scenario: tiny\naxes:\n" + "".join(f"  a{n}: {list(range(rng.randint(15, 20)))}\n" for n in range(20))
    ),
    "cases, seeds and axes": lambda rng: (
        f"scenario: tiny\nseeds: {list(range(rng.randint(500, 2000)))}\naxes: {{learn.seed: {list(range(500))}}}\n"
        "cases:\n" + "".join(f"- {{room.seed: {n}}}\n" for n in range(500))
    ),
    "a date that is none": _plain("scenario: tiny\naxes: {seed: [2024-13-45]}\n", "scenario: 2024-13-45\n"),
    "values that are no values": _plain(
        *("scenario: tiny\naxes: {learn.seed: [!!int abc]}\n", "scenario: tiny\naxes: {learn.seed: {a: 1}}\n"),
        *(
            "scenario: tiny\nseeds: [1.5]\n",
            "scenario: tiny\nseeds: many\n",
            "scenario: [tiny]\n",
            "scenario: tiny\nseeds: []\n",
        ),
        *("scenario: tiny\nset: {learn: 1}\n", "scenario: tiny\nset: {'': 1}\n", "scenario: tiny\nset: {'..': 1}\n"),
        *(
            "scenario: tiny\naxes: {scenario: [../x]}\n",
            "scenario: ../../../etc/passwd\n",
            "scenario: tiny\nreport: x\n",
        ),
        *(
            "scenario: tiny\ncases: [1]\n",
            "scenario: tiny\ncases: []\n",
            "scenario: tiny\ntarget: {x: 1}\n",
            "scenario: ''\n",
        ),
        *(
            "scenario: tiny\naxes: {learn.seed.x: [1]}\n",
            "scenario: tiny\naxes: {1: [1]}\n",
            "scenario: tiny\nname: a/b\n",
        ),
    ),
    "a setting's name of 1,000 dots": lambda rng: f"scenario: tiny\nset: {{{'a.' * rng.randint(500, 100_000)}b: 1}}\n",
    "target of 50,000": lambda rng: "scenario: tiny\ntarget: {" + ", ".join(f"f{n}: 1" for n in range(50_000)) + "}\n",
    "a scenario's name of 500 kB": lambda rng: f"scenario: {'s' * rng.randint(300_000, 900_000)}\n",
    "many wrong values": lambda rng: (
        "scenario: tiny\naxes: {drive.samples: [" + ", ".join(f"w{n}" for n in range(rng.randint(500, 1500))) + "]}\n"
    ),
}
"""What is said of it, and what makes it: a study that must be refused."""
