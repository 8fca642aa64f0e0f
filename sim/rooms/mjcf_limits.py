"""The cost of a user's own room, counted in its files before MuJoCo compiles them."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from sim.errors import InputError
from sim.rooms.asset_headers import count_triangles, measure_picture, measure_terrain
from sim.rooms.mjcf_files import Document, Files, list_references
from sim.user_input import quote, shorten

FARTHEST = 1e10
"""Largest magnitude of a number; MuJoCo itself treats a larger one as an error."""
DEEPEST = 100
MOST_SIDE_PX = 8192
MOST_MESH_PARAM = 256
"""Largest parameter of a mesh that MuJoCo generates: its sides, or the number of its subdivisions."""
_COUNTS = {
    "replicate": ("count",),
    "composite": ("count",),
    "texture": ("width", "height", "nchannel"),
    "hfield": ("nrow", "ncol"),
}
_TEXT = {"name", "class", "childclass", "prefix", "model", "frame", "body", "geom", "site", "joint", "camera", "target"}
_TEXT |= {"material", "mesh", "hfield", "texture", "objname", "refname", "content_type", "data", "memory"}
_SUSPECT = re.compile(r"nan|inf|0x|e\+?0*[1-9]|(?<![\d.])\d{11,}", re.IGNORECASE)
_WILD = re.compile(r"[+-]?(nan(\(.*\))?|inf(inity)?|0x.*)", re.IGNORECASE)


class Cost(NamedTuple):
    """What a room would contain once it is built."""

    elements: int = 0
    bodies: int = 0
    geoms: int = 0
    lights: int = 0
    cameras: int = 0
    copies: int = 0
    texture_bytes: int = 0
    cells: int = 0
    triangles: int = 0

    def plus(self, other: "Cost") -> "Cost":
        return Cost(*(one + two for one, two in zip(self, other, strict=True)))

    def times(self, count: int) -> "Cost":
        return Cost(*(count * one for one in self))


MOST = Cost(
    elements=200_000,
    bodies=8_000,
    geoms=20_000,
    lights=1_000,
    cameras=1_000,
    copies=10_000,
    texture_bytes=2_000_000_000,
    cells=16_000_000,
    triangles=10_000_000,
)
"""MuJoCo's compile time grows with the square of bodies and copies: two seconds at these limits."""
_NAMES = (
    *("elements", "bodies", "geoms", "lights", "cameras", "copies by replicate, composite and attach"),
    *("bytes of textures", "cells of terrain", "triangles"),
)


def refuse_excess(files: Files) -> None:
    """Refuse invalid numbers and rooms that would be too large; raise InputError naming the cause."""
    for element in files.elements():
        _judge_numbers(element, files.what)
    scales = _Scales(files)
    for document in files.documents.values():  # attached documents come before those that attach them
        scales.weigh(document)


class _Scales:
    """Counts what each document of a room contains, each document once."""

    def __init__(self, files: Files) -> None:
        self.files, self.what = files, files.what
        self.known: dict[int, Cost] = {}
        self.pictures: dict[Path, tuple[int, int]] = {}
        # A texture without its own size or type takes it from a default; any of the defaults may apply.
        defaults = [
            each for element in files.elements() if element.tag == "default" for each in element.iter("texture")
        ]
        sides = [[_count(each, name, self.what) for each in defaults] for name in ("width", "height")]
        self.width, self.height = (max([0, *side]) for side in sides)
        self.flat = {each.get("type") for each in defaults if "type" in each.attrib} == {"2d"}

    def weigh(self, document: Document) -> Cost:
        if id(document) not in self.known:
            main = next(iter(document.roots.values()))
            self.known[id(document)] = self._weigh(main, document, 0)
        return self.known[id(document)]

    def _weigh(self, element: ET.Element, document: Document, depth: int) -> Cost:
        if depth > DEEPEST:
            raise InputError(f"{self.what}: more than {DEEPEST} elements, one in the other")
        cost = self._weigh_one(element, document)
        for child in [*element, *(child for root in document.included.get(element, []) for child in root)]:
            cost = cost.plus(self._weigh(child, document, depth + 1))
        if element.tag in {"replicate", "composite"}:
            count = 1
            for word in element.get("count", "1").split():
                count *= max(1, int(word))
            cost = cost.times(count)
            cost = cost._replace(copies=cost.copies + cost.elements - count)
        # Costs only grow: what is too large here is too large in total, and checking early keeps the numbers small.
        _refuse_large(cost, self.what)
        return cost

    def _weigh_one(self, element: ET.Element, document: Document) -> Cost:
        tag = element.tag
        cost = Cost(1, tag in {"body", "composite"}, tag == "geom", tag == "light", tag == "camera")
        if element.tag == "texture":
            cost = cost._replace(texture_bytes=self._weigh_texture(element))
        elif element.tag == "hfield":
            cost = cost._replace(cells=self._weigh_terrain(element))
        elif element.tag == "mesh":
            cost = cost._replace(triangles=self._weigh_mesh(element))
        elif element.tag == "attach":
            cost = self._weigh_attached(element.get("model"), document)
        return cost

    def _weigh_attached(self, name: str | None, document: Document) -> Cost:
        named = {element: models for element, models in document.models.items() if element.get("name") == name}
        costs = [self.weigh(model) for models in (named or document.models).values() for model in models]
        if not costs:
            raise InputError(f"{self.what}: attach model {quote(name)}: no file has that model")
        cost = Cost(*(max(parts) for parts in zip(*costs, strict=True)))
        return cost._replace(copies=cost.copies + cost.elements)

    def _weigh_texture(self, element: ET.Element) -> int:
        what = f"{self.what}: texture {shorten(element.get('name', ''))}"
        faces = 1 if element.get("type", "2d" if self.flat else "cube") == "2d" else 6
        channels = max(3, _count(element, "nchannel", self.what))
        references, bytes_ = list_references(element), 0
        for name, _ in references:
            for path in self.files.find(element, name):
                if path not in self.pictures:
                    self.pictures[path] = measure_picture(path, what) or (0, 0)
                size = self.pictures[path]
                _refuse_side(max(size), what)
                bytes_ += size[0] * size[1] * channels if any(size) else path.stat().st_size
        if references:
            return bytes_ * faces // max(1, len(references))
        width = _count(element, "width", self.what) or self.width
        height = _count(element, "height", self.what) or self.height
        return width * (height if faces == 1 else 6 * width) * channels

    def _weigh_terrain(self, element: ET.Element) -> int:
        what = f"{self.what}: hfield {shorten(element.get('name', ''))}"
        paths = self.files.find_used(element)
        own = _count(element, "nrow", self.what) * _count(element, "ncol", self.what)
        return max([own, *(measure_terrain(path, what) for path in paths)])

    def _weigh_mesh(self, element: ET.Element) -> int:
        for word in element.get("params", "").split() if "builtin" in element.attrib else ():
            if _number(word) > MOST_MESH_PARAM:
                name = shorten(element.get("name", ""))
                raise InputError(f"{self.what}: mesh {name}: params {shorten(word)} must be at most {MOST_MESH_PARAM}")
        paths = self.files.find_used(element)
        inline = element.get("face", "").count(" ") // 3
        return max([inline, *(count_triangles(path) for path in paths)])


def _judge_numbers(element: ET.Element, what: str) -> None:
    """Refuse values that are infinite, NaN, or implausibly large where a number belongs."""
    for name in _COUNTS.get(element.tag, ()):
        _count(element, name, what)
    if element.tag == "texture" and max(_count(element, name, what) for name in ("width", "height")) > MOST_SIDE_PX:
        _refuse_side(MOST_SIDE_PX + 1, f"{what}: texture {shorten(element.get('name', ''))}")
    for name, value in element.attrib.items():
        if name in _TEXT or name.startswith("file") or not _SUSPECT.search(value):
            continue
        for word in re.finditer(r"\S+", value):
            if _number(word[0]) > FARTHEST:
                raise InputError(
                    f"{what}: {element.tag} {name} {shorten(word[0])}: a number must lie between "
                    f"{-FARTHEST:g} and {FARTHEST:g}"
                )


def _number(word: str) -> float:
    """Return the magnitude of a number: infinity for NaN, infinite or hexadecimal values, 0 for text."""
    if _WILD.fullmatch(word):
        return float("inf")
    try:
        return abs(float(word))
    except ValueError:
        return 0.0


def _count(element: ET.Element, name: str, what: str) -> int:
    """Return the largest of the integers in an attribute, 0 if there is none."""
    words = element.get(name, "").split()
    for word in words:
        if not re.fullmatch(r"[+-]?\d{1,9}", word, re.ASCII):
            raise InputError(f"{what}: {element.tag} {name} {shorten(word)} must be a whole number below 10^9")
    return max([0, *map(int, words)])


def _refuse_side(side_px: int, what: str) -> None:
    if side_px > MOST_SIDE_PX:
        raise InputError(f"{what}: a side of a texture has at most {MOST_SIDE_PX} pixels")


def _refuse_large(cost: Cost, what: str) -> None:
    for amount, most, name in zip(cost, MOST, _NAMES, strict=True):
        if amount > most:
            raise InputError(f"{what}: more than {most} {name}")
