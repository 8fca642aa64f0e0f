"""The reports "camera", "change", "reality", "knowing": what a fault or a change in deployment costs, what is said."""

import json
from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.config.scenario import Scenario
from deepgps.studies.reports.record import ACCEPTED_ERRORS, ERRORS, GRID, RATIOS, Dots, StudyReport, Table, Target
from deepgps.studies.reports.render import add_base
from deepgps.studies.table import Row, is_seed, read_setting
from sim.sensors.camera.faults import FAULTS, RAW_TITLES
from sim.settings import DeploymentImageFaultSettings

NO_FAULT, NO_CHANGE = "no fault", "no change"
IMAGE_TITLES = {name: title for fault in FAULTS for name, title in fault.titles.items()} | RAW_TITLES
# formats of a fault's strength, by the setting's name
TITLES = {
    **{f"image_faults.{name}": title for name, title in IMAGE_TITLES.items()},
    **{f"deployment.image_faults.{name}": IMAGE_TITLES[name] for name in DeploymentImageFaultSettings.model_fields},
    "drive.samples": "the first {:g} images",
    "camera.rings": "{:g} rings",
    "camera.sectors": "{:g} sectors",
    "camera_mount.driven_m": "driven {:g} m during exposure",
    "camera_mount.roll_deg": "tilted {:g}° to the right",
    "camera_mount.pitch_deg": "tilted {:g}° forward",
    "camera_mount.wobble_deg": "wobbling by {:g}°",
    "camera_mount.ahead_m": "{:g} m ahead of the axle",
    "camera_mount.left_m": "{:g} m to the left of the axle",
    "camera_mount.centre_px": "optical centre off by {:g} of 480 px",
    "deployment.light": "all light x {:g}",
    "deployment.lamps": "lamps x {:g}",
    "deployment.daylight": "daylight x {:g}",
    "deployment.lamp_on": "a lamp switched on",
    "deployment.exposure": "automatic exposure",
    "deployment.person": "{:g} persons in view",
    "deployment.moved_m": "furniture moved {:g} m",
    "deployment.camera_mount.roll_deg": "knocked {:g}° to the right",
    "deployment.camera_mount.wobble_deg": "wobbling by {:g}°",
    "deployment.camera_mount.centre_px": "knocked, optical centre off by {:g} of 480 px",
}
SINGULARS = {("deployment.person", 1): "a person in view"}  # Words for single values
TRAINING_NAMES = ("drive.person", "drive.mixed_light")
"""Settings that bring a change in deployment into training: its title is that of the other."""
LEANS = {"camera_mount.roll_deg": "tilted", "deployment.camera_mount.roll_deg": "knocked"}
CHANGE_TIMES = {True: "deployment only", False: "training and deployment"}
CAMERA_NOTE = (
    f"Means over seeds. {GRID}Base: the mean without faults. Changes between training and deployment do not appear in "
    "the training images. Test positions that moved furniture covers are left out. DeepGPS with compass sets the "
    "images of a camera that leans upright, by turns in training and deployment. Folded: maps that flip more than a "
    "tenth of the neighbourhoods, which includes maps that are wrong only in deployment; said: maps that the detector, "
    "which uses only the training images, reports as folded."
)
LIGHT, VALUES, ROOM = "drive.mixed_light", "learn.features.values", "room.kind"
LIGHTS = {False: "one light", True: "several lights"}
WORST_FIGURES = {
    "light_0.5_ratio": ("all light x 0.5",),
    "light_0.2_ratio": ("all light x 0.2",),
    "lamps_0_ratio": ("lamps x 0",),
    "mixed_ratio": ("daylight x 1, lamps x 0", "daylight x 0.3", "daylight x 0", "a lamp switched on"),
    "person_ratio": ("a person in view",),
}
"""Figures with a target, and the changes of which the worst is taken."""
CHANGE_NOTE = (
    f"Means over seeds. {GRID}Base: the mean without a change, with the same training. The training images show "
    "none of the changes but that of the light, and that only with several lights: daylight 0.3, lamps off, night. "
    "Test positions that moved furniture covers are left out."
)
REALITY_NOTE = (
    f"{GRID}Everything is rendered in the faulty camera, room or light. Base: the mean without faults. In training and "
    "deployment: the method has learned from faulty images, too; in deployment only, from sound ones. Furniture is "
    "moved after training alone, and coarser or fewer images are those of training, too. Test positions that moved "
    "furniture covers are left out."
)
DRIVES = "drives"  # The column of the report "knowing" that holds deployment drives as JSON
KNOWING_NOTE = (
    "All of the deployment drive. Refused: share of its images; then the share of the images with each cause, also of "
    "accepted ones where the light has changed or images are frozen. Named: the causes of the drive, that of most "
    "images first; a lean is one of all images. Radii: share of the accepted images whose true position is within. "
    "Black and white images, a covered lens, frozen images and the drive in another room are derived from the run "
    "without a change; for 'a part not driven' its method is trained again without the segments that enter the last "
    "30 % of its map."
)


def name_faults(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with their fault in words and where it is present, deployment alone last, and the errors without faults.

    A camera that leans and has no other fault is named as its figure is.
    """
    usual = {name: read_setting(Scenario(), name) for name in varied if not is_seed(name)}
    named = []
    for row in rows:
        faults = [name for name in usual if row[name] != usual[name]]
        shown = [name for name in faults if name not in TRAINING_NAMES] or faults
        forms = (SINGULARS.get((name, row[name])) or TITLES.get(name, f"{name} {{}}") for name in shown)
        title = ", ".join(form.format(row[name]) for form, name in zip(forms, shown, strict=True)) or NO_FAULT
        deployed = bool(faults) and all(name.startswith("deployment.") for name in faults)
        lean = f"{LEANS[faults[0]]}_{row[faults[0]]:g}" if len(faults) == 1 and faults[0] in LEANS else None
        case = f"{title}, {CHANGE_TIMES[True]}" if deployed else title
        named.append({**row, "fault": title, "in": CHANGE_TIMES[deployed], "case": case, "lean": lean})
    named.sort(key=lambda row: row["in"] == CHANGE_TIMES[True])
    return add_base(named, {"fault": NO_FAULT}, ["method"])


def pair_faults(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """The same rows, those of a fault in deployment alone after those of the same fault in training, too."""
    named = name_faults(rows, varied)
    order = list(dict.fromkeys(row["fault"] for row in named))
    return sorted(named, key=lambda row: order.index(row["fault"]))


def name_changes(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with the change in deployment in words, what was learned from, and the errors without a change."""
    changes = name_faults(rows, [name for name in varied if name.startswith("deployment.")])
    named = [
        {
            **row,
            "change": NO_CHANGE if row["fault"] == NO_FAULT else row["fault"],
            "values": row.get(VALUES, "ranks"),
            "mixed": bool(row.get(LIGHT)),
            "training": f"trained in {LIGHTS[bool(row.get(LIGHT))]}"
            + (f", features of {row[VALUES]}" if row.get(VALUES) else ""),
        }
        for row in changes
    ]
    return add_base(named, {"change": NO_CHANGE}, ["training", "method"])


def list_drives(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """A row for each deployment drive, and one for each cause of its images, from the column of drives."""
    from deepgps.tracking.causes import TITLES as CAUSES  # here, since it needs torch

    drives = []
    for row in name_changes(rows, [name for name in varied if name.startswith("deployment.")]):
        training = f"{title_of(row['method'])}, features of {row['values']}, {row.get(ROOM) or 'one room'}"
        for one in json.loads(row[DRIVES]):
            causes, expected = one["causes"], one["expected"]
            named, shares = causes["named"], causes["shares"]
            seen = {**shares, **({"camera": 1.0} if "camera" in named else {})}
            right = None if not shares else shares.get(expected, 0.0) / sum(shares.values())
            drive = {
                **{"method": row["method"], "training": training, "values": row["values"], "expected": expected},
                **{"fault": one["fault"] or row["change"], "refused": 1.0 - one["accepted"]},
                "named": ", ".join(CAUSES[name] for name in named) or "-",
                "first_right": named[:1] == [expected] if expected else None,
                "right_share": seen.get("camera", 0.0) if expected == "camera" else right,
            }
            drives.append({**drive, **one["figures"], "kind": "drive"})
            drives += [
                {**drive, "kind": "cause", "cause": title, "images": seen.get(name, 0.0)}
                for name, title in CAUSES.items()
            ]
    return drives


def _list_targets_of_camera() -> list[Target]:
    ours, compass = {"method": "deepgps"}, {"method": "deepgps_compass", "lean": lambda lean: lean is not None}
    targets = [Target("clean_rms_m", "RMS without faults", "rms_m", {**ours, "fault": NO_FAULT})]
    for key, deployed in (("both", False), ("deployment", True)):
        faulty = {**ours, "in": CHANGE_TIMES[deployed], "fault": lambda fault: fault != NO_FAULT}
        for of, word in (("rms_m", "RMS"), ("median_m", "median")):
            title = f"{word} / without faults, worst fault in {CHANGE_TIMES[deployed]}"
            targets.append(Target(f"{key}_{word.lower()}_ratio", title, f"{of}/base", faulty, each="fault"))
    title = "{label}: median / without faults, {fault}"
    return [*targets, Target("compass_{lean}_ratio", title, "median_m/base", compass, each="fault", per="lean")]


def _list_targets_of_reality() -> list[Target]:
    name, title, both = "{method}_%s_median_m", "{label}: median, %s", CHANGE_TIMES[False]
    return [
        Target(name % key, title % fault, "median_m", {"fault": fault, "in": both}, per="method")
        for key, fault in (("clean", NO_FAULT), ("wobble_1", "wobbling by 1°"))
    ]


def _list_targets_of_change() -> list[Target]:
    ours, title = (
        {"method": "deepgps_compass", "values": "ranks", "mixed": False},
        "median / without a change, {change}",
    )
    return [
        Target(name, title, "median_m/base", {**ours, "change": changes}, each="change")
        for name, changes in WORST_FIGURES.items()
    ]


def _list_targets_of_knowing() -> list[Target]:
    drives = {"kind": "drive", "values": "ranks"}
    faulty = {**drives, "expected": lambda cause: cause != ""}
    right = "drives with a fault whose first cause is right, of {count}"
    images = "images with a cause that have the right one, means over drives"
    moved, room, covered = ({**drives, "expected": cause} for cause in ("furniture", "other_room", "covered"))
    return [
        Target("drives_right", right, "first_right:share", faulty, at_least=True),
        Target("images_right", images, "right_share", faulty, at_least=True),
        Target("clean_refused", "refused without a change", "refused", {**drives, "expected": ""}),
        Target("moved_refused", "errors > 10 cm refused, furniture moved", "large_refused", moved, at_least=True),
        Target("other_room_refused", "refused, another room", "refused", room, at_least=True),
        Target("covered_refused", "refused, lens covered", "refused", covered, at_least=True),
    ]


_DRIVES = Table(
    "fault",
    "refused named grid_68 grid_95 use_68 use_95 large_refused",
    section="training",
    across="cause",
    each="images",
)
REPORTS = {
    "camera": StudyReport(
        (Table("fault in method", f"runs {ERRORS} {RATIOS} folded fold_found"),),
        CAMERA_NOTE,
        name_faults,
        targets=_list_targets_of_camera(),
        pictures={"camera": Dots("case", clean={"fault": NO_FAULT})},
    ),
    "change": StudyReport(
        (Table("change method", f"runs {ERRORS} {RATIOS} {ACCEPTED_ERRORS}", section="training"),),
        CHANGE_NOTE,
        name_changes,
        targets=_list_targets_of_change(),
        pictures={"change": Dots("change", "training", clean={"change": NO_CHANGE})},
        varies=(LIGHT,),
    ),
    "reality": StudyReport(
        (Table("fault in", "", across="method", each="median_m rms_m accepted rms_accepted_m"),),
        REALITY_NOTE,
        pair_faults,
        targets=_list_targets_of_reality(),
        pictures={"reality": Dots("case", clean={"fault": NO_FAULT})},
    ),
    "knowing": StudyReport(
        (_DRIVES,),
        KNOWING_NOTE,
        list_drives,
        targets=_list_targets_of_knowing(),
        columns="knowing:add_drives",
    ),
}
