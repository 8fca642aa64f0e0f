"""The files of a user's own room, found and parsed before MuJoCo sees them; none may be outside the room's folder."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from os.path import exists, isdir, isfile, realpath
from pathlib import Path

from sim.errors import InputError
from sim.user_input import read_file, shorten

LARGEST_MJCF = 64 * 1024 * 1024
"""Largest size of each XML file of a user's own room or robot, in bytes."""
MOST_ELEMENTS = 100_000
MOST_ATTRIBUTES = 1_000_000
MOST_FILES = 200
MOST_CHECKS = 20_000
LARGEST_ASSETS = 2 * 1024**3
"""Total bytes of the files that a room uses."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_REFUSED = {"plugin": "plugins", "extension": "extensions", "flex": "flexible bodies", "flexcomp": "flexible bodies"}


@dataclass
class Document:
    """An MJCF file with what it includes, and the models that it may attach.

    Attributes:
        roots: Parsed files by path: the file itself and all that it includes.
        included: Roots of the files that an element includes; two if its path may mean either of two files.
        models: Documents that the file may attach, by the element that names them.
    """

    roots: dict[Path, ET.Element] = field(default_factory=dict)
    included: dict[ET.Element, list[ET.Element]] = field(default_factory=dict)
    models: dict[ET.Element, list["Document"]] = field(default_factory=dict)

    def elements(self) -> Iterator[ET.Element]:
        """Iterate over every element of the file and of what it includes."""
        for root in self.roots.values():
            yield from root.iter()


class Files:
    """All files of a room, each read once.

    Attributes:
        what: Beginning of every error message.
        main: Document of the room's own file.
        documents: The main document and all models, by path.
    """

    def __init__(self, path: Path, field: str = "room.mjcf") -> None:
        """Read a room's file and all XML files that it names.

        Raises:
            InputError: A file cannot be read or parsed or is outside the folder, or there are too many files.
        """
        self.what = f"{field} {shorten(str(path), 300)}"
        try:
            self.folder = path.resolve().parent
        except (OSError, RuntimeError):
            raise InputError(f"{self.what}: cannot be found: its links lead in a circle") from None
        self.documents: dict[Path, Document] = {}
        self._found: dict[str, list[Path]] = {}
        self._elements = self._attributes = self._checks = 0
        self.main = self._read_document(path, [])
        root = self.main.roots[path.resolve()]
        if root.tag != "mujoco":
            raise InputError(f"{self.what}: not an MJCF file: its root is <{shorten(root.tag)}>, and must be <mujoco>")
        self.roots = {path: root for document in self.documents.values() for path, root in document.roots.items()}
        self._places = self._find_places()

    def elements(self) -> Iterator[ET.Element]:
        """Iterate over every element of every file."""
        for root in self.roots.values():
            yield from root.iter()

    def refuse_forbidden(self) -> None:
        """Refuse plugins, and references to anything outside the room's folder."""
        assets: dict[Path, int] = {}
        for element in self.elements():
            if element.tag in _REFUSED:
                raise InputError(f"{self.what}: {_REFUSED[element.tag]} are not allowed (<{element.tag}>)")
            for path in self.find_used(element):
                assets[path] = path.stat().st_size
        if sum(assets.values()) > LARGEST_ASSETS:
            raise InputError(f"{self.what}: its files have more than {LARGEST_ASSETS // 2**30} GiB")

    def list_used(self) -> list[Path]:
        """The other files that the room uses, sorted: XML files that it names, meshes and textures."""
        assets = {path for element in self.elements() for path in self.find_used(element)}
        return sorted((assets | set(self.roots)) - set(list(self.main.roots)[:1]))

    def find_used(self, element: ET.Element) -> list[Path]:
        """The existing files that all attributes of an element can mean."""
        return [path for name, _ in list_references(element) for path in self.find(element, name)]

    def find(self, element: ET.Element, name: str) -> list[Path]:
        """Return the existing files that an element's attribute can mean, all in the room's own folder."""
        value = element.get(name, "")
        if value not in self._found:
            self._found[value] = self._find_all(value, f"{element.tag} {name}")
        return self._found[value]

    def _find_all(self, value: str, name: str) -> list[Path]:
        found = []
        for base in self._places:
            # With strippath, MuJoCo uses only the last part of a path.
            for part in dict.fromkeys((value, Path(value).name)):
                path = self._inside(part, base, name)
                if exists(path) and not isfile(path) and not isdir(path):
                    raise InputError(f"{self.what}: {name} {shorten(value)} is a pipe or a device")
                found += [path] if isfile(path) else []
        return list(dict.fromkeys(found))

    def _read_document(self, path: Path, chain: list[Path]) -> Document:
        resolved = path.resolve()
        if resolved in chain:
            raise InputError(f"{self.what}: {path.name} includes itself")
        if resolved not in self.documents:
            document = Document()
            self._read_into(document, path, [*chain, resolved])
            self.documents[resolved] = document
        return self.documents[resolved]

    def _read_into(self, document: Document, path: Path, chain: list[Path]) -> None:
        """Read a file of a document, and the files that it includes and attaches."""
        resolved = path.resolve()
        if resolved in document.roots:
            raise InputError(f"{self.what}: {shorten(path.name)} is included twice")
        if len(document.roots) + len(self.documents) >= MOST_FILES:
            raise InputError(f"{self.what}: more than {MOST_FILES} XML files")
        root = document.roots[resolved] = self._parse(path)
        for element in root.iter():
            if element.tag not in {"include", "model"} or (element.tag == "model" and "file" not in element.attrib):
                continue
            targets = self._find_xml(element, resolved.parent)
            if element.tag == "model":
                document.models[element] = [self._read_document(target, chain) for target in targets]
                continue
            for target in targets:
                if target in chain:
                    raise InputError(f"{self.what}: {shorten(target.name)} includes itself")
                self._read_into(document, target, [*chain, target])
            document.included[element] = [document.roots[target] for target in targets]

    def _find_xml(self, element: ET.Element, folder: Path) -> list[Path]:
        value = element.get("file", "")
        places = dict.fromkeys((self.folder, folder))
        found = [self._inside(value, base, f"{element.tag} file") for base in places]
        found = [path for path in dict.fromkeys(found) if isfile(path)]
        if not found:
            raise InputError(f"{self.what}: {element.tag} file {shorten(value)}: no such file")
        return found

    def _parse(self, path: Path) -> ET.Element:
        if not isfile(path) and not exists(path):
            raise InputError(f"{self.what}: no such file")
        named = f"{self.what}: {shorten(path.name)}"
        data = read_file(path, LARGEST_MJCF, named).removeprefix(b"\xef\xbb\xbf")
        try:
            if not data.isascii():
                data.decode("utf-8")
        except UnicodeDecodeError:
            raise InputError(f"{named} is not UTF-8 text") from None
        # Entities could name other files or expand without limit, and MJCF does not need them.
        if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
            raise InputError(f"{self.what}: a DOCTYPE or an entity is not allowed in {shorten(path.name)}")
        self._elements += data.count(b"<") - data.count(b"</")
        self._attributes += data.count(b"=")
        if self._elements > MOST_ELEMENTS:
            raise InputError(f"{self.what}: more than {MOST_ELEMENTS} elements")
        if self._attributes > MOST_ATTRIBUTES:
            raise InputError(f"{self.what}: more than {MOST_ATTRIBUTES} attributes")
        try:
            root = ET.fromstring(data, ET.XMLParser(encoding="utf-8"))
        except (ET.ParseError, ValueError) as error:
            raise InputError(f"{self.what}: not XML: {error} in {shorten(path.name)}") from None
        for element in root.iter():
            # MuJoCo has no namespaces: it would read <a:b> and <b xmlns="a"> as different elements than we do.
            if "{" in element.tag:
                raise InputError(f"{self.what}: a namespace is not allowed in {shorten(path.name)}")
        return root

    def _find_places(self) -> list[Path]:
        """Return the folders in which MuJoCo may look for a file.

        Which folder it uses depends on the last file that sets one, so a reference must be valid in all of them.
        """
        bases = dict.fromkeys([self.folder, *(path.parent for path in self.roots)])
        places = list(bases)
        for element in self.elements():
            if element.tag == "compiler":
                for key in _FOLDERS:
                    if value := element.get(key):
                        places += [self._inside(value, base, key) for base in bases]
        return list(dict.fromkeys(places))

    def _inside(self, value: str, base: Path, name: str) -> Path:
        """Return the path that a reference names; refuse it if it, or a link on it, leads out of the room's folder."""
        what = f"{self.what}: {name} {shorten(value)}"
        self._checks += 1
        if self._checks > MOST_CHECKS:
            raise InputError(f"{self.what}: too many references to files, or too many folders to find them in")
        if Path(value).is_absolute() or "\\" in value or ":" in value or not value.isprintable():
            raise InputError(f"{what}: must be a path relative to the room's own folder")
        try:
            target = Path(realpath(base / value))
        except (OSError, ValueError):
            raise InputError(f"{what}: cannot be found") from None
        if ".." in Path(value).parts or not target.is_relative_to(self.folder):
            raise InputError(f"{what}: lies outside the room's own folder")
        return target


def list_references(element: ET.Element) -> list[tuple[str, str]]:
    """Return the attributes of an element that name files, with their values."""
    return [(name, value) for name, value in element.attrib.items() if name.startswith("file")]
