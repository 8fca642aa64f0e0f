"""The documentation: its commands run, its code works, its tables are complete, its generated parts say everything."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from deepgps.config.methods import METHODS
from deepgps.config.scenario import Scenario, names_in
from deepgps.evaluation.error_field import read_fields
from docs import times
from docs.generate import (
    GENERATED,
    describe_settings,
    fill_in,
    list_groups,
)
from sim.files import SCENARIOS, STUDIES
from sim.files.checksums import read_json
from sim.settings import EncoderSettings
from tests.helpers.pages import PAGES, ROOT, check_block, find_blocks
from tests.helpers.reader import Reader

RUN = {"bash", "python", "yaml"}
SHOWN_LANGUAGES = {"text", "xml", "toml", "bibtex", "{eval-rst}"}
"""Languages that are only shown; an xml block is a file that a command reads."""
FORMATS = (ROOT / "docs" / "reference" / "formats.md").read_text(encoding="utf-8").replace("methods.<name>.", "")


def test_every_command_setting_and_import_of_the_pages_exists(finished_run: Path, tmp_path: Path) -> None:
    for page in PAGES:
        for block in find_blocks(page):
            assert block.language in RUN | SHOWN_LANGUAGES, block.place
            check_block(block, tmp_path, finished_run)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory, finished_run: Path) -> Reader:
    return Reader(tmp_path_factory.mktemp("reader"), finished_run)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_of_a_page_runs(page: Path, reader: Reader) -> None:
    for block in find_blocks(page):
        reader.follow(block)


def test_a_page_s_blocks_are_found_with_their_languages_and_without_indents(tmp_path: Path) -> None:
    page = ROOT / "docs" / "how-to" / "study.md"
    assert [block.language for block in find_blocks(page)][:3] == ["bash", "yaml", "bash"]
    inner = [block.text for block in find_blocks(ROOT / "README.md") if "tiny --out" in block.text]
    assert inner == ["deepgps run tiny --out runs/first && deepgps view runs/first\n"]


def test_the_readme_is_a_door() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 130
    links = [link for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text) if "://" not in link]
    assert links and not [link for link in links if not (ROOT / link).exists()]


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_s_headings_skip_no_level(page: Path) -> None:
    """Sphinx takes a skipped level for an error; published tables are pages of the documentation too."""
    prose = re.sub(r"^(`{3,}).*?^\1", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    levels = [0, *(len(marks) for marks in re.findall(r"^(#+) ", prose, re.MULTILINE))]
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


def test_the_readme_has_the_table_that_make_times_prints() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (.+?) +\| +[\d.]+ \w+ \| +([\d.]+) (?:s|min) \|$", text, re.MULTILINE))
    assert list(rows) == [name for name, _ in times.COMMANDS.values()]
    assert all(re.search(rf"^\|  .*\| +{column}\b", text, re.MULTILINE) for column in times.COLUMNS)


def test_of_two_machines_the_one_that_was_measured_has_its_own_time() -> None:
    assert list(times.list_rows({"demo": 360.0}, slow=True)) == [("`make demo` after it", "2 min", "6 min")]
    assert list(times.list_rows({"tiny": 12.0}, slow=False)) == [("`deepgps run tiny`", "10 s", "40 s")]


DATED_COMMIT = re.compile(r"\b([0-9a-f]{7}) \(\d{1,2} \w+ 20\d\d\)")
"""A commit and its date."""


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs" / "results").glob("*/table.md")), ids=lambda page: page.parent.name
)
def test_a_published_page_names_commit_and_date_and_so_does_the_page_of_results(page: Path) -> None:
    made = DATED_COMMIT.findall(page.read_text(encoding="utf-8"))
    assert made, "it names no commit with its date"
    results = (ROOT / "docs" / "results.md").read_text(encoding="utf-8").replace("\n", " ")
    told = {commit: re.findall(r"`(\S+?)`", names) for commit, names in re.findall(r"\b(\w{7}) \((`.+?)\)", results)}
    assert [commit for commit in made if page.parent.name not in told.get(commit, [])] == []


@pytest.mark.parametrize("page", GENERATED, ids=lambda page: page.name)
def test_the_kept_pages_of_the_reference_are_what_the_code_says(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "<!-- generated: " in text and text == fill_in(text), "run make docs"


def test_every_setting_is_described_with_its_default() -> None:
    described = dict(re.findall(r"^\| `(\S+)` \| `(.*?)`; [^|]+ \| [^|]", describe_settings(), re.MULTILINE))
    groups = dict(list_groups(Scenario))
    defaults = {
        f"{name}.{key}".lstrip("."): list(value) if isinstance(value, tuple) else value
        for name, group in groups.items()
        for key, value in group()
        if f"{name}.{key}".lstrip(".") not in groups
    }
    assert {name: yaml.safe_load(text) for name, text in described.items()} == defaults


def test_limits_and_choices_of_settings_are_told() -> None:
    page = describe_settings()
    assert "| `encoder.ticks_per_rev` | `4096`; integer, 4 to 65,536 |" in page
    assert "number, more than 0.01, at most 0.5 | " in page.partition("| `drive.speed_mps`")[2]
    assert "| `room.width_m` | `null`; number, 2 to 30 or `null` |" in page
    assert all(f"`{method}`" in page for method in METHODS)


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("how-to/run.md", names_in(SCENARIOS)),
        ("how-to/study.md", names_in(STUDIES)),
        (
            "how-to/encoder-faults.md",
            [f"encoder.{name}" for name in EncoderSettings.model_fields if name != "plugins"],
        ),
    ],
    ids=["scenarios", "studies", "encoder faults"],
)
def test_a_table_of_names_is_complete(page: str, names: list[str]) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert not [name for name in names if f"`{name}`" not in text]


def test_every_file_of_a_run_is_in_the_page_of_formats(finished_run: Path) -> None:
    paths = [path.relative_to(finished_run).as_posix() for path in finished_run.rglob("*") if path.is_file()]
    names = {re.sub(r"^recording/(use/)?", "", path) for path in paths if not path.startswith("pairs/")}
    names = {re.sub("(?<=/)fisheye(?=[._])", "<sensor>", name) for name in names}
    parts = {part for name in names for part in (name, name.rpartition("/")[2], f"{name.partition('/')[0]}/")}
    known = {part for part in parts if f"`{part}`" in FORMATS} | {f"{method}/" for method in METHODS}
    lost = [
        name
        for name in names
        if not {name, name.rpartition("/")[2]} & known and not name.startswith(("features/", "figures/"))
    ]
    assert len(names) > 20 and lost == []


def test_arrays_of_a_recording_have_the_shape_and_type_of_the_page(finished_run: Path) -> None:
    rows = dict(re.findall(r"^\| `(\S+\.npy)` \| (\(.*?\) \w+) \|", FORMATS, re.MULTILINE))
    paths = [path for path in (finished_run / "recording").rglob("*.npy") if path.parent.name != "test"]
    for path in paths:
        name = path.relative_to(finished_run / "recording").as_posix().replace("fisheye", "<sensor>")
        name = name.removeprefix("use/")  # a recording too
        if name in ("observations/<sensor>.npy", "observations/<sensor>_turn.npy"):
            continue  # by kind: below
        array = np.load(path, mmap_mode="r")
        shape, kind = rows[name].rsplit(" ", 1)
        assert (len(shape.split(",")) - shape.endswith(",)"), kind) == (array.ndim, str(array.dtype)), name
    for name in ("fisheye", "fisheye_turn"):
        images = np.load(finished_run / "recording" / "observations" / f"{name}.npy", mmap_mode="r")
        assert (images.ndim, images.dtype) == (4, np.uint8) and "(N, rings, sectors, 3) uint8" in FORMATS


def test_every_key_of_metrics_and_manifest_is_in_the_page_of_formats(finished_run: Path) -> None:
    metrics, manifest = (
        read_json(finished_run / "metrics.json"),
        read_json(finished_run / "recording" / "manifest.json"),
    )
    first, *_ = metrics["methods"].values()
    nested = {f"{key}.{inner}" for key in ("test", "coverage", "trajectory", "distances") for inner in metrics[key]}
    groups = {"fold", "turned"} & set(first)
    signs = {f"{key}.{inner}" for key in groups for inner in first[key]}
    named = {"format", "sensors", "settings", "sha256", "odometry", "samples", "segments", "readings", "seed"}
    wanted = {*metrics, *nested, *first, *signs, *manifest} - {"test", "coverage", "trajectory", "distances"}
    wanted -= {"methods", "checksum", *groups}
    assert named <= wanted
    assert sorted(key for key in wanted if f"`{key}`" not in FORMATS) == []


def test_the_error_field_is_as_the_page_of_formats_says(finished_run: Path) -> None:
    field = np.load(finished_run / "error_field.npz")
    (cells, _), (headings,) = field["truth"].shape, field["heading"].shape
    assert field["deepgps"].shape == (cells, headings, 2)
    worst = np.linalg.norm(field["deepgps"] - field["truth"][:, None], axis=-1).max(axis=1)
    np.testing.assert_allclose(worst, read_fields(finished_run)["deepgps"].error)


def test_the_script_of_the_page_on_trust_counts_what_metrics_say(
    finished_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (block,) = [block for block in find_blocks(ROOT / "docs" / "trust.md") if block.language == "python"]
    exec(block.text.replace("runs/first", str(finished_run)), {})
    measured = read_json(finished_run / "metrics.json")["methods"]["knn"]
    share, *radii = map(float, re.findall(r"\d\.\d+", capsys.readouterr().out))
    assert share == pytest.approx(measured["accepted"], abs=0.001)
    told = [measured[name] for name in ("radius_68_holds", "radius_95_holds") if name in measured]
    assert radii == pytest.approx(told)


def test_every_file_and_folder_of_the_code_that_a_page_names_exists() -> None:
    named = re.compile(r"(?<![\w./-])(?:deepgps|sim|tests|docs)/[a-z_0-9/]+(?:\.py|/)")
    pages = [
        path for path in (ROOT / "docs").rglob("*") if path.suffix in {".md", ".svg"} and "results" not in path.parts
    ]
    for page in [*pages, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]:
        paths = set(named.findall(page.read_text(encoding="utf-8")))
        assert [path for path in paths if not (ROOT / path).exists()] == [], page
