"""Workcells for tests."""

from pathlib import Path

import numpy as np

from edream import catalog
from edream.core.bench import bench_of
from edream.core.policy import World
from edream.core.task import Task
from edream.reality.truth import Truth, draw, drawn_effects, with_cell
from edream.sim.expert import Expert
from edream.sim.robot import RobotModel, load_robot

ROBOTS = Path(__file__).resolve().parent.parent / "edream" / "robots"


def robot(name: str = "arm6") -> RobotModel:
    return load_robot(ROBOTS / f"{name}.xml", name, "ee" if name == "arm6" else "left_ee")


def task(name: str = "grab_paper_cup") -> Task:
    return catalog.load("tasks", name, Task)


def hidden(name: str = "arm6", seed: int = 1, effects: tuple[str, ...] | None = None) -> Truth:
    """A truth with the effects that robots at work commonly have, or those named."""
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
    return with_cell(draw(robot(name), drawn_effects(seed) if effects is None else effects, rng), seed)


def played(world: World, name: str, chore: str, starts: range) -> list[bool]:
    """Whether the expert succeeds, start by start."""
    expert, out = Expert(robot(name), bench_of(name), task(chore), world.rate), []
    for start in starts:
        seen = world.reset(start)
        expert.begin(world.scene.layout, start)  # type: ignore[attr-defined]
        for _ in range(world.steps):
            seen = world.step(expert.act(seen, world.hand()))  # type: ignore[attr-defined]
        out.append(world.outcome().success)
    return out
