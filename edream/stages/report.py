"""Report: one self-contained page about a calibration, a diagnosis, dreamed video, a policy, or all of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from edream import catalog
from edream.calibration.methods import methods
from edream.calibration.problem import Fitter
from edream.core.stage import Artifact, Bundle, Stage, Work
from edream.report.calibration import calibration_page
from edream.report.diagnosis import diagnosis_page
from edream.report.dream import dream_page
from edream.report.policy import policy_page
from edream.report.whole import whole_page

PAGE = "report.html"
DREAM = ("score", "dream", "condition", "masks", "render", "camera", "ingest")


@dataclass(frozen=True)
class ReportOptions:
    """What the page is about: the stage `fit`, `diagnose`, `dream` or `evaluate`, or `whole`, all that several runs made.

    Attributes:
        of: which of them.
        parts: for `whole`, artifacts by need and run, such as "fit run=mine"; `edream report --whole` finds them.
        hidden: for `whole`, what was hidden in a make-believe robot.
    """

    of: Literal["fit", "diagnose", "dream", "evaluate", "whole"]
    parts: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReportedRobot:
    """Of the robot only its name counts here."""

    name: str | None = None


@dataclass(frozen=True)
class ReportedFit:
    """Of the fit its method counts here, which says whether there is a surrogate to report on, and what it is compared with."""

    method: str = "gauss_newton"
    compare: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReportedRender:
    """Of the rendering it only counts whether there is a robot in it."""

    model: str = "fit"


@dataclass(frozen=True)
class ReportedPolicies:
    """Of the evaluation it counts which policies were judged."""

    of: tuple[str, ...] = ("sft", "rl")


@dataclass(frozen=True)
class ReportConfig:
    """What report reads."""

    report: ReportOptions
    robot: ReportedRobot
    fit: ReportedFit
    render: ReportedRender = ReportedRender()
    evaluate: ReportedPolicies = ReportedPolicies()


def needs(config: ReportConfig) -> tuple[str, ...]:
    """What the page is about, the recordings, and the surrogate where one was used."""
    if config.report.of == "whole":
        return config.report.parts
    if config.report.of == "diagnose":
        return ("diagnose", "ingest")
    if config.report.of == "dream":
        return tuple(name for name in DREAM if name != "camera" or config.render.model != "none")
    if config.report.of == "evaluate":
        return ("evaluate", "ingest", *dict.fromkeys(["sft", *config.evaluate.of]))
    others = [method for method in dict.fromkeys(config.fit.compare) if method != config.fit.method]
    beside = [f"{need} fit.method={method}" for method in others for need in _fit_by(method)]
    return (*_fit_by(config.fit.method), "ingest", *beside)


def _fit_by(method: str) -> tuple[str, ...]:
    return ("fit", "sweep", "surrogate") if catalog.load("fitters", method, Fitter).needs_surrogate else ("fit",)


def run(inputs: Mapping[str, Artifact], config: ReportConfig, work: Work) -> Bundle:
    """Draw and write the page."""
    robot = config.robot.name or "your robot"
    if config.report.of == "whole":
        return {PAGE: whole_page(by_run(inputs), config.report.hidden, robot)}
    if config.report.of == "diagnose":
        return {PAGE: diagnosis_page(inputs["diagnose"], inputs["ingest"], robot)}
    if config.report.of == "dream":
        return {PAGE: dream_page(inputs, robot)}
    if config.report.of == "evaluate":
        return {PAGE: policy_page(inputs, robot)}
    return {PAGE: calibration_page(inputs["fit"], inputs["ingest"], inputs.get("surrogate"), robot, methods(inputs))}


def by_run(inputs: Mapping[str, Artifact]) -> dict[str, dict[str, Artifact]]:
    """Run -> need -> artifact, of parts such as "fit fit.method=annealing run=mine"."""
    found: dict[str, dict[str, Artifact]] = {}
    for part, artifact in inputs.items():
        need, _, run = part.rpartition(" run=")
        found.setdefault(run, {})[need] = artifact
    return found


ENTRY = Stage("report", 12, needs, ReportConfig, run, None, ("matplotlib",))
