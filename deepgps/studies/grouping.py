"""Group the rows of a study's table by the settings that vary."""

from collections.abc import Mapping, Sequence

from deepgps.config.methods import title_of
from deepgps.studies.table import Row, is_seed

Groups = Mapping[tuple[str, ...], Sequence[Row]]


def choices(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """Names that vary by choice, without seeds, which only repeat runs, and names that follow from earlier names."""
    found: list[str] = []
    for name in varied:
        before, after = (len({tuple(row[one] for one in names) for row in rows}) for names in (found, [*found, name]))
        if not is_seed(name) and after > before:
            found.append(name)
    return found


def group_rows(rows: Sequence[Row], names: Sequence[str]) -> Groups:
    """Rows by the values of these names followed by the method."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault((*(str(row[name]) for name in names), row["method"]), []).append(row)
    return groups


def describe(key: tuple[str, ...], names: Sequence[str]) -> str:
    """Describe a group in words; numbers and flags appear with their names."""
    pairs = zip(shorten(names), key, strict=False)
    words = [value if value[:1].islower() else f"{name} {value}" for name, value in pairs]
    return ", ".join([*words, title_of(key[-1])])


def shorten(names: Sequence[str]) -> list[str]:
    """Dotted names without their groups, except for the last group where two names would otherwise be equal."""
    last = [name.rpartition(".")[2] for name in names]
    return [
        short if last.count(short) == 1 else ".".join(name.split(".")[-2:])
        for name, short in zip(names, last, strict=True)
    ]
