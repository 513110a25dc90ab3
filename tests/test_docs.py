"""The documentation's own code runs, its commands compose, and its links lead somewhere."""

import importlib.util
import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from edream import config
from edream.calibration.settings import RobotSettings
from edream.cli import app
from edream.core.episode import Episode, Recording
from edream.core.format import Malformed, ReadOptions
from edream.learn.policy import PolicyShape, Seen
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"])
COMMANDS = {command.name or command.callback.__name__.replace("_", "-") for command in app.registered_commands if command.callback}


def entry(page: str, folder: Path) -> Any:
    """`ENTRY` of the one file that a page shows."""
    shown = re.search(r'```python title="([\w/.]+)"\n(.*?)```', (ROOT / "docs" / "add" / page).read_text(), re.DOTALL)
    assert shown is not None
    path = folder / Path(shown[1]).name
    path.write_text(shown[2])
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.ENTRY.name == path.stem == Path(shown[1]).stem
    return module.ENTRY


def test_the_effect_of_the_docs_is_absent_at_its_start_and_each_number_of_it_moves_the_robot(tmp_path: Path) -> None:
    effect = entry("effect.md", tmp_path)
    robot = config.read(config.compose(["robot=pan_tilt"]).robot, RobotSettings, "robot").load()
    times = np.arange(0.0, 1.5, 0.02)
    command = 0.5 * np.sin(2.0 * np.pi * times)[:, None] * np.ones(2)
    motion = whole([Episode("moves", robot.joints, times, np.zeros_like(command), times, command)])
    placed = SimulatedRobot(robot, (Placement(effect, ("pan",)),))
    plain = rollout(SimulatedRobot(robot, ()), np.zeros(0), motion, threads=1)[0]
    start = placed.space.start()
    assert np.array_equal(rollout(placed, start, motion, threads=1)[0], plain)
    sets = ((0.3, 2.0), (0.3, 8.0), (0.1, 2.0))
    braked = [rollout(placed, np.array(values), motion, threads=1)[0] for values in sets]
    for one, other in ((0, 1), (0, 2)):
        assert np.abs(braked[one] - braked[other]).max() > 1e-4
    assert np.abs(braked[0] - plain).max() > 1e-3


def test_the_format_of_the_docs_reads_what_it_says_and_names_what_is_broken(tmp_path: Path) -> None:
    form = entry("format.md", tmp_path)
    folder = tmp_path / "logs"
    folder.mkdir()
    rows = [{"t": 0.02 * i, "cmd": {"pan": 0.1 * i}, "pos": {"pan": 0.09 * i}} for i in range(20)]
    (folder / "good.jsonl").write_text("\n".join(map(json.dumps, rows)))
    (folder / "torn.jsonl").write_text("\n".join(map(json.dumps, rows))[:-9])
    assert form.recognise(folder) and form.recognise(ROOT / "docs") is None
    good, torn = form.recordings(folder, ReadOptions())
    assert isinstance(good, Recording) and good.channels == ("pan",) and np.allclose(good.command[:, 0], 0.1 * np.arange(20))
    assert isinstance(torn, Malformed) and torn.name == "torn"


def test_the_policy_of_the_docs_learns(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = entry("policy.md", tmp_path).build(PolicyShape(3, 5, 0, 0, 0, 2), {})
    seen = Seen(torch.randn(64, 3), torch.zeros(64, 0, 0, 0, 3, dtype=torch.uint8), torch.randn(64, 2))
    actions, valid = seen.joints[:, None].repeat(1, 5, 1), torch.ones(64, 5, dtype=torch.bool)
    optimiser, losses = torch.optim.Adam(network.parameters(), 0.03), []
    for _ in range(80):
        losses.append(network.loss(seen, actions, valid, torch.Generator()))
        optimiser.zero_grad()
        losses[-1].backward()
        optimiser.step()
    assert network.chunk(seen).shape == (64, 5, 3) and losses[-1] < 0.3 * losses[0]


def commands() -> list[tuple[str, str]]:
    """Every `edream ...` line of the documentation's blocks, continued lines joined."""
    found = []
    for page in PAGES:
        for block in re.findall(r"```(?:sh|bash)?\n(.*?)```", page.read_text(), re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                if re.match(r"\$? ?edream [a-z]", line):
                    found.append((page.relative_to(ROOT).as_posix(), line.removeprefix("$ ")))
    return found


@pytest.mark.parametrize(("page", "line"), commands())
def test_every_command_of_the_docs_exists_and_its_settings_compose(page: str, line: str) -> None:
    words = shlex.split(line.replace("...,", ""), comments=True)[1:]
    assert words[0] in COMMANDS, f"{page}: {line}"
    settings = [word for word in words[1:] if "=" in word and not word.startswith("-") and "..." not in word]
    config.compose([word.replace(",...", "") for word in settings])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_of_the_docs_leads_to_a_file(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:|#)([^)\s]+)\)", page.read_text()):
        path = (page.parent / target.partition("#")[0]).resolve()
        assert path.exists(), f"{page.relative_to(ROOT)} links to {target}"


@pytest.mark.parametrize("page", [p for p in PAGES if p.name != "README.md"], ids=lambda page: page.name)
def test_every_page_is_in_the_navigation(page: Path) -> None:
    assert page.relative_to(ROOT / "docs").as_posix() in (ROOT / "mkdocs.yml").read_text()
