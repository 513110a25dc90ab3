"""Reports: one page that stands alone, says its sentence first, and trusts no name."""

import re
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from edream.core.parameters import Parameter
from edream.diagnosis.evidence import usual_number
from edream.diagnosis.set_up import how_to_record
from edream.report.calibration import calibration_page
from edream.report.diagnosis import diagnosis_page, next_motion
from edream.report.overview import interval, ladder, positions
from edream.report.page import draw, mrad, number
from edream.report.signature import SHOWS, signature
from edream.report.traces import Trace, worst_stretch

HOSTILE = '"><script>alert(1)</script>--> $\\frac{ <img src=x onerror=alert(1)>'
VOID = {"meta", "link", "img", "br", "hr", "input"}


@pytest.mark.parametrize(("guessed", "stood"), [(True, 0.0), (False, 0.05)])
def test_a_named_usual_number_stood_as_published_before_and_not_where_its_search_began(guessed: bool, stood: float) -> None:
    rotor = Parameter("armature.inertia[lift]", "kg m^2", 0.0005, 1.0, 0.05, scale="log", guessed=guessed)
    found = {"value": 0.2, "low": 0.19, "high": 0.21}
    row = usual_number(rotor, None, found)
    assert row["published"] == stood and row["before"] == {"value": stood, "low": stood, "high": stood} and row["after"] == found
    assert usual_number(rotor, found, None)["before"] == found


def traces_of(joints: tuple[str, ...] = ("lift", "turn"), motions: int = 4, seconds: float = 6.0) -> list[dict[str, Any]]:
    rng = np.random.default_rng(5)
    time = np.arange(0.0, seconds, 0.02)
    rows = []
    for m in range(motions):
        for j, joint in enumerate(joints):
            command = 0.6 * np.sin((1 + 0.3 * m) * time + j) + 0.3 * (time > 2.0)
            measured = np.interp(time - 0.05, time, command) + 2e-4 * rng.standard_normal(len(time))
            shifts = {"published": 0.02, "before": 0.035, "after": 0.049}
            versions = {name: np.interp(time - lag, time, command) for name, lag in shifts.items()}
            plain = {
                "time": time,
                "command": command,
                "measured": measured,
                "speed": np.gradient(measured, time),
                "load": np.cos(measured),
            }
            rows.append({"motion": f"swing {m}", "joint": joint, **plain, **versions})
    return rows


def table_of(rows: list[dict[str, Any]]) -> pa.Table:
    length = len(rows[0]["time"])
    return pa.concat_tables(
        [pa.table({name: [v] * length if isinstance(v, str) else v for name, v in row.items()}) for row in rows]
    )


def ingested(joints: tuple[str, ...] = ("lift", "turn")) -> dict[str, Any]:
    summary = {
        "sentence": "4 episodes.",
        "joints": list(joints),
        "noticed": ["Encoder step: 0.001 rad."],
        "malformed": [{"name": HOSTILE, "reason": "truncated"}],
    }
    return {"summary.json": summary, "preview/front.png": b"\x89PNG\r\n\x1a\n not really"}


def diagnosis(verdict: str = "named", joint: str = "lift", effect: str = "stribeck") -> dict[str, Any]:
    joints = (joint, "turn")
    rows = traces_of(joints)
    names = [f"swing {m}" for m in range(4)]
    named = {
        "name": effect, "targets": [joint], "values": {"torque": 0.2154}, "intervals": {"torque": [0.2125, 0.2183]},
        "units": {"torque": "N m"}, "closed": 0.93,
        "runner_up": {"candidate": f"quadratic_drag[{joint}]", "closed": 0.41}, "confusable_with": [],
    }  # fmt: skip
    result = {
        "verdict": verdict,
        "sentence": f"Your simulator lacks friction that falls with speed (Stribeck) on {joint}.",
        "effects": [named] if verdict in ("named", "cannot_tell") else [],
        "gap": {"published_rad": 4.7e-3, "before_rad": 1.5e-3, "after_rad": 4e-4, "noise_floor_rad": 2e-4},
        "formula": "tau = +0.1 sin(q) N m" if verdict == "unnamed" else None,
        "parameters": {},
        "motions": {"fitted": names[:2], "proof": names[2:]},
        "model": "model.xml",
        "hook": "hook.py",
        "next_motion": None,
    }
    screened = [{"candidate": f"{effect}[{joint}]", "share": 0.5}, {"candidate": "payload[hand]", "share": 0.02}]
    tried = [{"candidate": f"{effect}[{joint}]", "closed": 0.93, "sure": True, "left_out_rad": 4e-4}]
    spread = {"value": 20.4, "low": 20.1, "high": 20.7}
    return {
        "summary.json": result,
        "traces.parquet": table_of([row for row in rows if row["motion"] in names[2:]]),
        "errors.json": {
            "joints": list(joints),
            "motions": names,
            "proof": 2,
            "before": [[2e-3, 1e-3]] * 4,
            "after": [[4e-4, 3e-4]] * 4,
        },
        "ladder.json": [
            {"step": s, "motions_rad": [e, 1.2 * e]}
            for s, e in (("published", 4e-3), ("calibrated", 1.5e-3), (f"+ {effect}[{joint}]", 5e-4))
        ],
        "ranking.json": [{"left_out_rad": 1.5e-3, "taken": f"{effect}[{joint}]", "screened": screened, "refitted": tried}],
        "nuisance.json": [
            {"name": f"servo_gain.kp[{joint}]", "unit": "N m/rad", "published": 20.0, "before": spread, "after": None}
        ],
        "difference.txt": f"--- published\n+++ found\n-<joint name={joint!r} frictionloss='0'/>\n+<joint frictionloss='0.2'/>\n",
        "hook.py": "def make(model):\n    return None\n",
    }


def calibration(joints: tuple[str, ...] = ("lift", "turn"), held: bool = True) -> dict[str, Any]:
    rows = traces_of(joints)
    names = [f"swing {m}" for m in range(4)]
    lists = {
        n: np.stack([np.concatenate([r[n] for r in rows if r["joint"] == j]) for j in joints], axis=1).tolist()
        for n in ("measured", "command", "before", "after")
    }
    replay = pa.table({"episode": np.repeat(names, len(rows[0]["time"])), "time": np.tile(rows[0]["time"], 4), **lists})
    short = {"joint_rmse_rad": 2e-3, "translation_m": 1e-3, "rotation_rad": 3e-3}
    side = {**short, "per_joint": dict.fromkeys(joints, 2e-3), "per_episode": {}, "by_horizon": {"0.1 s": short, "whole": short}}
    judge = {**side, "before": side, "perfect_tracking": side}
    estimate = {
        "value": 20.4,
        "unit": "kg m^2",
        "interval": [20.1, 20.7],
        "status": "not_identifiable",
        "confounded_with": ["armature.inertia[turn]"],
        "low": 0.1,
        "high": 200.0,
        "start": 20.0,
    }
    parameters = {
        f"servo_gain.kp[{joints[0]}]": estimate,
        "armature.inertia[turn]": {**estimate, "status": "converged", "confounded_with": []},
    }
    summary = {
        "sentence": "Your simulator was off by 0.0050 rad; it is now off by 0.0018 rad on 2 motions it never saw.",
        "model": "model.xml", "method": "gauss_newton",
        "converged": True, "simulations": 5600, "parameters": parameters, "open": ["The data hardly depend on it."],
        "error": {"heldout" if held else "train": judge},
    }  # fmt: skip
    details = {
        "correlation": {"names": list(parameters), "values": [[1.0, 0.5], [0.5, 1.0]]}, "history": [4e-5, 1e-5, 9e-6], "facts": {},
        "heldout": names[2:] if held else [], "train": names[:2] if held else names, "model_difference": None,
    }  # fmt: skip
    return {"summary.json": summary, "details.json": details, "replay.parquet": replay}


class Reader(HTMLParser):
    """Tags, addresses, text outside style, and whether tags nest."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if data.strip() and not {"style", "title"} & set(self.open):
            self.text.append(data.strip())


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    surrogate = {
        "summary.json": {
            "sentence": "Off by 1e-4 rad.",
            "kind": "mlp",
            "error": {"train": {"one_step_rad": 1e-4}, "heldout": {"one_step_rad": 2e-4}},
        }
    }
    return {
        "diagnosis": diagnosis_page(diagnosis(), ingested(), "arm"),
        "calibration": calibration_page(calibration(), ingested(), surrogate, "arm"),
    }


@pytest.mark.parametrize("which", ["diagnosis", "calibration"])
def test_the_first_line_is_the_sentence(pages: dict[str, str], which: str) -> None:
    assert Reader(pages[which]).text[0].startswith("Your simulator ")


def test_a_published_model_that_blew_up_has_no_error_that_counts(pages: dict[str, str]) -> None:
    found = diagnosis()
    found["summary.json"] |= {"unstable": ["swing 2"], "gap": found["summary.json"]["gap"] | {"published_rad": 10.0}}
    text = Reader(diagnosis_page(found, ingested(), "arm")).text
    assert text[text.index("published model") + 1] == "unstable" and "10000" not in text
    told = Reader(pages["diagnosis"]).text
    assert told[told.index("published model") + 1] == "4.70" and "unstable" not in told


@pytest.mark.parametrize(("published", "leaves"), [(0.17, True), (0.001, False)])
def test_a_published_model_that_is_far_off_leaves_the_scale_to_the_others(published: float, leaves: bool) -> None:
    drawing = ladder([("published", [published]), ("calibrated", [5.1e-4]), ("+ play", [3.7e-4])], 2e-4).drawing
    ticks = [float(word) for word in re.findall(r">\s*(\d+\.?\d*)\s*</text>", drawing)]
    assert ("beyond this scale" in drawing) == leaves and max(ticks) < 2.0
    assert all(f"{mrad(error)} mrad" in drawing for error in (published, 5.1e-4, 3.7e-4))


@pytest.mark.parametrize("which", ["diagnosis", "calibration"])
def test_a_report_loads_nothing_from_anywhere(pages: dict[str, str], which: str) -> None:
    for tag, attributes in Reader(pages[which]).tags:
        assert tag not in ("script", "iframe", "object")
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:")), (tag, attributes)
    assert "@import" not in pages[which]
    outside = set(re.findall(r"https?://[^\"'\s<>]+", pages[which]))
    assert outside <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    assert not re.findall(r"url\((?!#)", pages[which])


@pytest.mark.parametrize("which", ["diagnosis", "calibration"])
def test_every_figure_has_a_title_and_a_sentence(pages: dict[str, str], which: str) -> None:
    figures = re.findall(r"<figure.*?</figure>", pages[which], flags=re.DOTALL)
    assert len(figures) >= 5
    for figure in figures:
        assert re.search(r"<h3>.+?</h3>", figure)
        caption = re.search(r"<figcaption>(.+?)</figcaption>", figure)
        assert caption is not None and caption[1].strip().endswith(".")


def test_same_inputs_give_the_same_bytes() -> None:
    assert diagnosis_page(diagnosis(), ingested(), "arm") == diagnosis_page(diagnosis(), ingested(), "arm")
    assert calibration_page(calibration(), ingested(), None, "arm") == calibration_page(calibration(), ingested(), None, "arm")


def test_ids_are_unique_so_that_drawings_do_not_borrow_each_others_parts(pages: dict[str, str]) -> None:
    ids = [attributes["id"] for _, attributes in Reader(pages["diagnosis"]).tags if "id" in attributes]
    assert len(ids) == len(set(ids))


def test_names_from_strangers_stay_text() -> None:
    for page in (
        diagnosis_page(diagnosis(joint=HOSTILE), ingested(), HOSTILE),
        calibration_page(calibration((HOSTILE, "turn")), ingested((HOSTILE, "turn")), None, HOSTILE),
    ):
        reader = Reader(page)
        assert not reader.open
        assert "script" not in {tag for tag, _ in reader.tags}
        assert not [attributes for _, attributes in reader.tags if any(name.startswith("on") for name in attributes)]
        assert HOSTILE in " ".join(reader.text)


@pytest.mark.parametrize("verdict", ["none", "cannot_tell", "unnamed"])
def test_every_verdict_has_a_page(verdict: str) -> None:
    found = diagnosis(verdict)
    found["summary.json"]["effects"] = [
        {**one, "closed": None, "runner_up": None, "confusable_with": ["payload[hand]"]} for one in found["summary.json"]["effects"]
    ]
    assert not Reader(diagnosis_page(found, ingested(), "arm")).open


def test_the_page_says_which_motion_alone_shows_an_effect_and_which_was_set_aside() -> None:
    found = diagnosis()
    assert "Set aside" not in diagnosis_page(found, ingested(), "arm")
    found["summary.json"]["motions"]["set_aside"] = ["swing 3"]
    found["summary.json"]["effects"] = [
        {**one, "closed": None, "runner_up": None, "motion": "swing 1"} for one in found["summary.json"]["effects"]
    ]
    page = diagnosis_page(found, ingested(), "arm")
    assert "Of the fitted motions swing 1 alone shows it." in page and "<p>Set aside: swing 3.</p>" in page
    assert "A usual number, far from" not in page


@pytest.mark.parametrize(("verdict", "heading"), [("named", "What is missing"), ("unnamed", "What comes nearest")])
def test_what_is_no_answer_does_not_stand_under_what_is_missing(verdict: str, heading: str) -> None:
    found = diagnosis()
    found["summary.json"]["verdict"] = verdict
    assert f"<h2>{heading}</h2>" in diagnosis_page(found, ingested(), "arm")


def test_a_fit_without_held_out_motions_has_a_page() -> None:
    assert "fitted to" in calibration_page(calibration(held=False), ingested(), None, "arm")


def test_the_page_says_what_became_of_joints_that_hold_things() -> None:
    made = calibration()
    found = {"value": 390.0, "unit": "N/m", "interval": (380.0, 400.0)}
    seen = {"free_s": 30.0, "rmse_before": 3.7e-4, "rmse_after": 2.3e-5, "parameters": {"servo_gain.kp[jaw]": found}}
    never = {"free_s": 0.0, "rmse_before": None, "rmse_after": None, "parameters": {}}
    made["summary.json"] = {**made["summary.json"], "grips": {"jaw": seen, "claw": never}}
    text = calibration_page(made, ingested(), None, "arm")
    assert "Joints that hold things" in text and "390" in text and ">0.37<" in text and ">0.02<" in text
    assert "as published: it hardly moved without holding something" in text


@pytest.mark.parametrize("effect", [*sorted({kind: name for name, kind in SHOWS.items()}.values()), "never_heard_of"])
def test_every_kind_of_effect_has_its_picture(effect: str) -> None:
    rows = [{k: v for k, v in row.items() if k not in ("published", "speed")} for row in traces_of(motions=2)]
    figures = signature(effect, ("lift",), [Trace(**row) for row in rows])
    assert figures
    for figure in figures:
        assert "[" in figure.drawing or figure.drawing.startswith("<img")


@pytest.mark.parametrize("effect", ["stribeck", "load_friction", "torque_limit", "actuator_delay", "gain_fade", "never_heard_of"])
def test_what_torques_drive_is_drawn_without_a_following_error(effect: str) -> None:
    """A torque in N m less a position in rad was drawn as milliradians."""
    rows = [{k: v for k, v in row.items() if k not in ("published", "speed")} for row in traces_of(motions=2)]
    traces = [Trace(**{**row, "command": np.full(len(row["time"]), np.nan)}) for row in rows]
    figures = signature(effect, ("lift",), traces)
    assert figures and all("what is left along" in figure.title for figure in figures)
    assert not any("command less position" in figure.drawing for figure in figures)
    axis = SimpleNamespace(plot=lambda *values, label, **style: drawn.append(label))
    drawn: list[str] = []
    positions(axis, traces[0])
    assert drawn == ["measured", "before", "after"]


def test_an_effect_of_the_load_is_drawn_on_a_joint_that_gravity_loads() -> None:
    time = np.linspace(0.0, 4.0, 200)
    swing = np.sin(time)
    upright = Trace("m", "pan", time, swing, swing, swing + 0.5, swing, load=1e-16 * swing)  # the larger error, but no load
    loaded = Trace("m", "lift", time, swing, swing, swing + 0.1, swing, load=0.4 * np.cos(swing))
    titles = [figure.title for figure in signature("load_friction", ("pan", "lift"), [upright, loaded])]
    assert titles and all(title.startswith("lift") for title in titles)
    titles = [figure.title for figure in signature("stribeck", ("pan", "lift"), [upright, loaded])]
    assert titles and all(title.startswith("pan") for title in titles)


def test_a_large_drawing_becomes_a_bitmap() -> None:
    noise = np.random.default_rng(0).standard_normal((2, 20_000))
    figure = draw("big", "t", "c.", lambda canvas: canvas.subplots().plot(*noise, "."))
    assert figure.drawing.startswith("<img") and len(figure.drawing) < 1_000_000


def test_the_next_motion_is_drawn_joint_by_joint() -> None:
    figure = next_motion("time,lift,turn\n0,0.1,0.2\n0.02,0.3,0.4\n", [{}, {"servo_gain": 0.5}])
    assert figure is not None and "lift" in figure.drawing and "turn" in figure.drawing
    assert figure.caption.endswith(how_to_record([{}, {"servo_gain": 0.5}]))
    assert next_motion("time,lift\n", [{}]) is None


def test_numbers_keep_the_digits_that_their_interval_leaves() -> None:
    assert number(0.215432, [0.2125, 0.2183]) == "0.2154"
    assert number(23.13, [14.5, 36.9]) == "23"
    assert number(None) == "–"
    assert number(200.0) == "200"
    assert number(123456.0) == "123,000"
    assert mrad(0.0012345) == "1.23"
    assert mrad(0.5) == "500"


def test_the_bootstrap_interval_encloses_the_error() -> None:
    errors = np.array([1e-3, 2e-3, 3e-3, 2e-3])
    low, high = interval(errors)
    assert 1e-3 <= low < float(np.sqrt(np.mean(errors**2))) < high <= 3e-3


def test_the_worst_stretch_is_where_the_error_is() -> None:
    time = np.arange(0.0, 30.0, 0.02)
    measured = np.sin(time)
    before = measured + 0.1 * ((time > 20.0) & (time < 22.0))
    first, last = worst_stretch(Trace("m", "j", time, measured, measured, before, measured), 4.0)
    assert first <= 20.05 and last >= 21.95 and abs(last - first - 4.0) < 1e-6
