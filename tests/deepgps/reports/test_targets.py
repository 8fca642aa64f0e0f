"""Figures beside their targets: how they are written, and when a target is met."""

import numpy as np

from deepgps.reports.targets import Figure, judge, middle_of, ratio_of, share_of, tabulate_targets, write


def test_written_value_has_its_unit_and_is_never_nothing_where_something_was() -> None:
    for value, unit, text in (
        (0.0123, "cm", "1.2 cm"),
        (0.00059, "mm", "0.59 mm"),
        (0.97, "%", "97.0 %"),
        (None, "s", "-"),
        (0.0, "mm", "0.00 mm"),
        (2e-9, "mm", "< 0.01 mm"),
        (0.2, "s", "< 1 s"),
        (0.0049, "", "< 0.01"),
        (0.0051, "", "0.01"),
    ):
        assert write(value, unit) == text


def test_target_is_met_at_most_or_at_least() -> None:
    for value, at_least, target, verdict in (
        (0.02, False, 0.02, "met"),
        (0.021, False, 0.02, "missed"),
        (0.5, True, 0.6, "missed"),
        (0.7, True, 0.6, "met"),
        (None, False, 0.02, "not measured"),
        (0.02, False, None, ""),
    ):
        assert judge(value, target, at_least) == verdict


def test_table_sets_each_figure_beside_the_target_and_the_paper_of_its_name() -> None:
    table = tabulate_targets({"rms": Figure("RMS", 0.0123, "cm", worst=0.03)}, {"rms": 0.01}, {"rms": 0.101})

    assert [cell.strip() for cell in table.splitlines()[-1].strip("|").split("|")] == [
        "RMS", "1.2 cm", "-", "3.0 cm", "<= 1.0 cm", "missed", "10.1 cm",
    ]  # fmt: skip


def test_intervals_hold_the_true_value_in_about_95_of_100_cases() -> None:
    rng, held = np.random.default_rng(0), {"mean": 0, "median": 0, "ratio": 0, "share": 0}
    for _ in range(60):
        ours, theirs = rng.normal(2.0, 0.5, (2, 30))
        found = {
            "mean": (middle_of("", np.mean, ours.tolist(), "cm"), 2.0),
            "median": (middle_of("", np.median, ours.tolist(), "cm"), 2.0),
            "ratio": (ratio_of("", ours.tolist(), theirs.tolist()), 1.0),
            "share": (share_of("", (rng.random(30) < 0.9).tolist()), 0.9),
        }
        for name, (figure, true) in found.items():
            assert figure.interval is not None and figure.value is not None
            low, high = figure.interval
            assert low <= figure.value <= high
            held[name] += low <= true <= high
    assert all(51 <= count <= 60 for count in held.values()), held


def test_few_values_have_no_interval_and_the_worst_is_on_the_wrong_side() -> None:
    assert middle_of("", np.mean, [1.0, 2.0, 3.0, 4.0], "cm").interval is None
    assert share_of("", []).value is None
    assert middle_of("", np.mean, [1.0, 2.0], "%", at_least=True).worst == 1.0
    assert ratio_of("", [1.0, 3.0], [2.0, 2.0]).worst == 1.5
