"""Who may import whom: every import is parsed, type-only ones and those inside functions too."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in ("sim", "deepgps")
    for path in sorted((ROOT / package).rglob("*.py"))
}

ORDER = (
    ("sim",),
    ("sim.sensors.catalog",),
    ("sim.rooms.furniture", "sim.apriltag"),
    ("sim.rooms",),
    ("sim.robot", "sim.sensors"),
    ("sim.recording",),
    ("sim.planar", "sim.tools", "sim.environment", "sim.live_robot", "sim.robot_log"),
    ("deepgps.config", "deepgps.terminal"),
    ("deepgps.data", "deepgps.runs"),
    ("deepgps.diagnosis", "deepgps.initial_map", "deepgps.learning"),
    ("deepgps.positioner",),
    ("deepgps.methods", "deepgps.tracking"),
    ("deepgps.navigation",),
    ("deepgps.evaluation",),
    ("deepgps.reports",),
    ("deepgps.studies",),
    ("deepgps.viewer",),
    ("deepgps.run",),
    ("deepgps.api",),
    ("deepgps.robot_io", "deepgps.__init__"),
    ("deepgps.commands",),
)
"""The packages in the order of imports: a module takes only what comes earlier; those side by side are apart."""

NOT_IN_SIM = {"torch", "rerun", "tyro"}
WITHOUT_MUJOCO = {
    *(
        "sim",
        "sim.settings",
        "sim.plugins",
        "sim.errors",
        "sim.files",
        "sim.rng",
        "sim.processes",
    ),
    *(
        "sim.geometry",
        "sim.alignment",
        "sim.recording.format",
        "sim.recording.manifest",
        "sim.recording.derive",
        "sim.recording.renderers",
        "sim.recording.turns",
        "sim.rooms.mjcf_files",
    ),
    *(
        "sim.sensors.catalog",
        "sim.sensors.visual_compass",
        "sim.sensors.compass_fit",
        "sim.sensors.camera.lens",
        "sim.sensors.camera.mount",
        "sim.sensors.camera.unwrap",
        "sim.sensors.encoder",
        "sim.sensors.camera.faults",
    ),
    *(f"sim.files.{name}" for name in ("atomic", "checksums")),
    *(f"sim.settings.{name}" for name in ("group", "robot", "world")),
    "sim.robot_log.mcap_file",
}
ENTRY_POINTS = ("deepgps.commands", "deepgps.runs.collect", "deepgps.run", "deepgps.navigation.simulate")
STARTED_BY_ENTRY_POINTS = (
    *("sim.recording.collect", "sim.planar", "sim.tools", "sim.sensors.camera.gl", "sim.robot_log", "sim.live_robot"),
)
ONLY_IN = {"rerun": "deepgps.viewer", "tyro": "deepgps.commands", "ray": "deepgps.studies.engine.ray_cluster"}
OPENS_TRUTH = (
    *("deepgps.evaluation", "deepgps.viewer", "deepgps.data.labels"),
    *("deepgps.reports.run_figures", "deepgps.reports.plots"),
    "deepgps.robot_io.trajectories",  # which writes the truth beside the methods' poses
    "deepgps.api.record",  # which writes the truth that its caller has, and reads none
    "deepgps.studies.reports.from_runs",
)
OPENS_ALIGNMENT = ("deepgps.evaluation", "deepgps.api.run", "deepgps.viewer")
"""The alignment of a map with the world is fitted on the truth."""
READS_LABELS = (
    *("deepgps.evaluation", "deepgps.data.labels"),
    "deepgps.methods.baselines",
)
MAKES_LABELS = ("sim.apriltag",)
MAKES_PATHS = {"joinpath", "join", "Path", "PurePath"}
GENERATORS = {"default_rng", "Generator", "SeedSequence", "BitGenerator", "PCG64", "PCG64DXSM", "Philox"}
GLOBAL_SEEDS = {
    "torch.manual_seed",
    "torch.seed",
    "torch.cuda.manual_seed",
    "torch.cuda.manual_seed_all",
    "random.seed",
}


@dataclass(frozen=True)
class Import:
    """One import: the module that is taken, and whether that happens inside a function."""

    module: str
    line: int
    in_function: bool


@cache
def parse(source: str) -> ast.Module:
    """The tree of a module, which every law looks at."""
    return ast.parse(source)


def find_imports(tree: ast.AST, modules: set[str], in_function: bool = False) -> Iterator[Import]:
    """Every import below ``tree``; ``from a import b`` counts as ``a.b`` where ``modules`` has that."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            for name in node.names:
                yield Import(name.name, node.lineno, in_function)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            for name in node.names:
                part = f"{base}.{name.name}"
                yield Import(part if part in modules else base, node.lineno, in_function)
        inside = in_function or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        yield from find_imports(node, modules, inside)


def is_in(module: str, *packages: str) -> bool:
    """Whether a module is one of these or lives in one of them."""
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def rank(module: str) -> tuple[int, str]:
    """Place in the order of packages, and the package that decides it; ``deepgps`` itself offers the interface."""
    module = "deepgps.__init__" if module == "deepgps" else module
    places = [
        (len(package), place, package) for place, row in enumerate(ORDER) for package in row if is_in(module, package)
    ]
    return max(places)[1:]


def break_import_law(module: str, source: str) -> list[str]:
    """What in a module's imports is not allowed, one line each."""
    return [
        f"{module}:{taken.line} imports {taken.module}: {fault}"
        for taken in find_imports(parse(source), set(MODULES))
        if (fault := judge_import(module, taken))
    ]


def judge_import(module: str, taken: Import) -> str | None:
    """Why a module may not take this import, or None."""
    top = taken.module.partition(".")[0]
    if taken.module.startswith("."):
        return "relative imports hide where a name comes from"
    if top in (NOT_IN_SIM if is_in(module, "sim") else {"mujoco", "dm_control"}):
        return f"{module.partition('.')[0]} never imports {top}"
    if top in ONLY_IN and not is_in(module, ONLY_IN[top]):
        return f"only {ONLY_IN[top]} may"
    if top in {"sim", "deepgps"}:
        return judge_order(module, taken.module) or judge_simulation(module, taken)
    return None


def judge_order(module: str, taken: str) -> str | None:
    """Why a module of ours comes too early to take another, or None."""
    (own, package), (other, other_package) = rank(module), rank(taken)
    if other < own or package == other_package:
        return None
    return f"{package} comes before {other_package} or is its neighbour"


def judge_simulation(module: str, taken: Import) -> str | None:
    """Why a module of deepgps may not take one of sim, or None."""
    if is_in(module, "sim") or is_in(taken.module, "deepgps") or taken.module in WITHOUT_MUJOCO:
        return None
    if is_in(module, *ENTRY_POINTS) and is_in(taken.module, *STARTED_BY_ENTRY_POINTS):
        return None if taken.in_function else "only inside a function"
    return "deepgps takes of sim only the modules without MuJoCo"


def break_truth_law(module: str, source: str) -> list[str]:
    """Where a module of deepgps, or one that makes labels, opens a recording's truth though it may not."""
    if not is_in(module, "deepgps", *MAKES_LABELS) or is_in(module, *OPENS_TRUTH):
        return []
    tree = parse(source)
    texts = find_docstrings(tree)
    faults = []
    for node in ast.walk(tree):
        names = {getattr(node, "id", None), getattr(node, "attr", None), getattr(node, "name", None)}
        text = node.value if isinstance(node, ast.Constant) and id(node) not in texts else None
        if names & {"open_truth", "load_free_space", "TRUTH"} or is_truth_path(text) or joins_truth(node):
            faults.append(f"{module}:{getattr(node, 'lineno', 0)} opens the truth")
    return faults


def break_alignment_law(module: str, source: str) -> list[str]:
    """Where a module of deepgps opens the alignments that evaluation has fitted on the truth though it may not."""
    if not is_in(module, "deepgps") or is_in(module, *OPENS_ALIGNMENT):
        return []
    tree = parse(source)
    taken = [
        f"{module}:{one.line} takes alignments"
        for one in find_imports(tree, set(MODULES))
        if one.module == "deepgps.evaluation.stored_alignment"
    ]
    named = [
        f"{module}:{node.lineno} names the file of an alignment"
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value.rpartition("/")[2] == "alignment.json"
    ]
    return taken + named


def break_label_law(module: str, source: str) -> list[str]:
    """Where a module of deepgps takes labels though it neither evaluates nor learns from labels."""
    if not is_in(module, "deepgps") or is_in(module, *READS_LABELS):
        return []
    faults = [
        f"{module}:{taken.line} takes labels"
        for taken in find_imports(parse(source), set(MODULES))
        if taken.module == "deepgps.data.labels"
    ]
    names = [
        node
        for node in ast.walk(parse(source))
        if "open_labels" in {getattr(node, "id", None), getattr(node, "attr", None), getattr(node, "name", None)}
    ]
    return faults + [f"{module} opens labels"] * bool(names)


def is_truth_path(text: object) -> bool:
    """Whether a string names the folder ``truth`` or a file in it."""
    return isinstance(text, str) and "truth" in text.split("/") and " " not in text and text != "truth"


def joins_truth(node: ast.AST) -> bool:
    """Whether a path with ``truth`` in it is put together: by ``/``, or by a call such as ``joinpath`` or ``Path``."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
        parts = [node.left, node.right]
    elif isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in MAKES_PATHS:
        parts = node.args
    else:
        parts = []
    return any(isinstance(part, ast.Constant) and part.value == "truth" for part in parts)


def find_docstrings(tree: ast.AST) -> set[int]:
    """Identities of the constants that are docstrings or stand alone as a statement."""
    return {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}


def break_seed_law(module: str, source: str) -> list[str]:
    """Where a global generator is seeded or used."""
    faults = []
    for node in ast.walk(parse(source)):
        if isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            numpy_random = name.startswith(("np.random.", "numpy.random.")) and name.count(".") == 2
            if name in GLOBAL_SEEDS or (numpy_random and node.attr not in GENERATORS):
                faults.append(f"{module}:{node.lineno} uses {name}: randomness is an argument")
        elif isinstance(node, ast.ImportFrom) and node.module in {"random", "numpy.random"}:
            taken = {name.name for name in node.names}
            if node.module == "random" or taken - GENERATORS:
                faults.append(
                    f"{module}:{node.lineno} takes {sorted(taken)} from {node.module}: randomness is an argument"
                )
        elif isinstance(node, ast.Import) and "random" in {name.name for name in node.names}:
            faults.append(f"{module}:{node.lineno} imports random: randomness is an argument")
    return faults


def find_cycle(sources: dict[str, str]) -> list[str]:
    """The modules of one import cycle, imports inside functions included; empty where there is none."""
    graph = {
        module: {taken.module for taken in find_imports(parse(source), set(sources))} & sources.keys() - {module}
        for module, source in sources.items()
    }
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        return list(error.args[1])
    return []


def read(module: str) -> str:
    return MODULES[module].read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "law", [break_import_law, break_truth_law, break_alignment_law, break_label_law, break_seed_law]
)
def test_every_module_keeps_the_law(law):
    assert [fault for module in MODULES for fault in law(module, read(module))] == []


@pytest.mark.parametrize("package", ["sim", "deepgps"])
def test_package_has_no_import_cycle(package):
    assert find_cycle({module: read(module) for module in MODULES if module.startswith(package)}) == []


FISHEYE, TRAINER = "sim.sensors.camera.fisheye", "deepgps.learning.trainer"
COLLECT, RECORD = "deepgps.runs.collect", "sim.recording.collect"
BREAKS = (
    (break_import_law, FISHEYE, "import torch", "sim never imports torch"),
    (break_import_law, FISHEYE, "def f():\n    from deepgps.learning import trainer", "sim.sensors comes before"),
    (break_import_law, FISHEYE, "from sim.robot.model import BASE", "is its neighbour"),
    (break_import_law, "sim.rooms.build", f"import {RECORD}", "sim.rooms comes before sim.recording"),
    (break_import_law, FISHEYE, "if TYPE_CHECKING:\n    import rerun as rr", "never imports rerun"),
    (break_import_law, FISHEYE, "from . import lens", "relative"),
    (break_import_law, TRAINER, "from deepgps.methods import baselines", "comes before deepgps.methods"),
    (break_import_law, TRAINER, "import rerun", "only deepgps.viewer may"),
    (break_import_law, TRAINER, "from tyro import cli", "only deepgps.commands may"),
    (break_import_law, "deepgps.run", "import ray", "only deepgps.studies.engine.ray_cluster may"),
    (break_import_law, TRAINER, "import mujoco.viewer", "never imports mujoco"),
    (break_import_law, TRAINER, f"def f():\n    import {RECORD}", "only the modules without MuJoCo"),
    (break_import_law, COLLECT, f"import {RECORD}", "only inside a function"),
    (break_import_law, COLLECT, "def f():\n    import sim.robot.world", "only the modules without MuJoCo"),
    (break_truth_law, TRAINER, "from sim.recording.format import open_truth", "the truth"),
    (break_truth_law, TRAINER, "from sim import records\nrecords.open_truth(folder)", "the truth"),
    (break_truth_law, TRAINER, "np.load(folder / 'truth/pose.npy')", "the truth"),
    (break_truth_law, TRAINER, "np.load(recording.folder / 'truth' / 'pose.npy')", "the truth"),
    (break_truth_law, TRAINER, "np.load(recording.folder.joinpath('truth', 'pose.npy'))", "the truth"),
    (break_truth_law, TRAINER, "open(os.path.join(folder, 'truth', 'pose.npy'))", "the truth"),
    (break_truth_law, TRAINER, "from sim.recording.format import TRUTH", "the truth"),
    (break_truth_law, "sim.apriltag.bundle_adjustment", "from sim.recording.format import open_truth", "the truth"),
    (break_alignment_law, TRAINER, "from deepgps.evaluation.stored_alignment import read_alignment", "alignment"),
    (break_alignment_law, TRAINER, "from deepgps.evaluation import stored_alignment", "alignment"),
    (break_alignment_law, TRAINER, "read_json(folder / 'alignment.json')", "alignment"),
    (break_alignment_law, "deepgps.methods.deepgps", "open('runs/tiny/deepgps/alignment.json')", "alignment"),
    (break_label_law, "deepgps.methods.deepgps", "from deepgps.data.labels import read_places", "labels"),
    (break_label_law, "deepgps.methods.deepgps", "from sim.recording.format import open_labels", "labels"),
    (break_label_law, "deepgps.methods.compass", "import deepgps.data.labels", "labels"),
    (break_seed_law, "sim.robot.drive", "np.random.seed(0)", "randomness is an argument"),
    (break_seed_law, "sim.robot.drive", "np.random.normal(size=3)", "randomness is an argument"),
    (break_seed_law, "sim.robot.drive", "from numpy.random import normal", "randomness is an argument"),
    (break_seed_law, "sim.robot.drive", "torch.manual_seed(0)", "randomness is an argument"),
    (break_seed_law, "sim.robot.drive", "import random", "randomness is an argument"),
    (break_seed_law, "sim.robot.drive", "from random import shuffle", "randomness is an argument"),
)
KEEPS = (
    (break_import_law, "deepgps.viewer.scene", "import rerun\nfrom sim.recording.format import open_recording"),
    (break_import_law, COLLECT, f"def f():\n    from {RECORD} import collect"),
    (break_import_law, FISHEYE, "import mujoco, cv2"),
    (break_import_law, "deepgps.commands.parse", "import tyro"),
    (break_truth_law, "deepgps.evaluation.evaluate", "np.load(folder / 'truth/pose.npy')"),
    (break_truth_law, TRAINER, '"""Never opens truth/pose.npy."""'),
    (break_truth_law, TRAINER, "places = field['truth']"),
    (break_truth_law, RECORD, "from sim.recording.format import load_free_space"),
    (break_alignment_law, "deepgps.api.run", "from deepgps.evaluation.stored_alignment import read_alignment"),
    (break_alignment_law, TRAINER, "from sim.alignment import fit_alignment"),
    (break_label_law, "deepgps.methods.baselines", "from deepgps.data.labels import read_places"),
    (break_seed_law, "sim.robot.drive", "rng = np.random.default_rng(np.random.SeedSequence(0))"),
)


def test_a_law_can_be_broken():
    for law, module, source, fault in BREAKS:
        (line,) = law(module, source)[:1]
        assert fault in line, (module, source)


def test_a_law_allows_what_it_should():
    assert [law(module, source) for law, module, source in KEEPS if law(module, source)] == []


def test_cycle_is_found():
    assert set(find_cycle({"sim.a": "import sim.b", "sim.b": "def f():\n    from sim import a"})) == {"sim.a", "sim.b"}
    assert find_cycle({"sim.a": "import sim.b", "sim.b": "import numpy"}) == []


LEARNING = sorted(module for module in MODULES if is_in(module, "deepgps") and rank(module) < rank("deepgps.viewer"))


@pytest.mark.parametrize(
    ("modules", "banned"),
    [
        (
            sorted({*WITHOUT_MUJOCO, "sim.planar.drive", "sim.planar.worlds"}),
            ("mujoco", "dm_control", "torch", "rerun", "tyro", "OpenGL"),
        ),
        (LEARNING, ("mujoco", "dm_control", "rerun", "tyro", "OpenGL", "ray")),
        (["deepgps.commands.main"], ("mujoco", "dm_control", "rerun", "torch", "OpenGL", "ray")),
    ],
    ids=["sim", "learning", "cli"],
)
def test_importing_leaves_out_what_is_not_needed(modules, banned):
    code = f"import sys, {', '.join(modules)}; print(sorted(set({banned}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.returncode) == ("[]", 0), done.stderr
