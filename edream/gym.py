"""Gymnasium environments of every task: `import edream.gym`, then `gymnasium.make("edream/GrabPaperCup-v0")`.

What is observed is the simulator's raw rendering, a dreamed image, the make-believe reality, or numbers alone. Many at once:
`gymnasium.make_vec("edream/GrabPaperCup-v0", 8, vectorization_mode="async")`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from edream import catalog
from edream.core.errors import EdreamError, unknown_name
from edream.core.policy import Observation, World
from edream.core.task import Task
from edream.sim.camera import prepare_graphics
from edream.sim.eyes import Images
from edream.sim.robot import RobotModel, load_robot
from edream.sim.workcell import SimulatedWorkcell

if TYPE_CHECKING:
    from edream.vision.dreamer import Dreamer, Past

ROBOTS = Path(__file__).parent / "robots"
SITES = {"arm6": "ee", "cobot": "left_ee"}
OBSERVED = ("raw", "dreamed", "reality", "state")


class WorkcellEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """A robot at its bench.

    Actions are position commands [rad or m] of every actuator. An episode lasts as long as a trial; its reward is 1 at each
    step at which the task is done, and what counts is whether it is done at the end (`info["success"]`).

    Args:
        task: an entry of `edream/tasks/`.
        robot: arm6 or cobot.
        observed: raw, dreamed, reality or state.
        cameras: views, for raw and reality; the one view of a dream model.
        height, width: size of the images [pixel].
        rate: control steps per second [Hz].
        model: an MJCF to simulate, such as a calibrated one; the published robot where None.
        hook: the hook file that came with it.
        truth: a sealed truth, for `reality`.
        dreamer: a dream model, for `dreamed`.
        render_mode: rgb_array or None.

    Raises:
        EdreamError: an argument is unknown or missing, or this machine cannot render.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012 - gymnasium reads it from the class

    def __init__(
        self,
        task: str = "grab_paper_cup",
        robot: str = "arm6",
        observed: Literal["raw", "dreamed", "reality", "state"] = "raw",
        cameras: tuple[str, ...] = ("cam_high",),
        height: int = 64,
        width: int = 64,
        rate: float = 25.0,
        model: Path | None = None,
        hook: Path | None = None,
        truth: Path | None = None,
        dreamer: "Dreamer | None" = None,
        render_mode: str | None = None,
    ) -> None:
        if observed not in OBSERVED:
            raise unknown_name("observation", observed, OBSERVED)
        if robot not in SITES:
            raise unknown_name("robot with a workcell", robot, SITES)
        if (observed == "dreamed") != (dreamer is not None) or (observed == "reality") != (truth is not None):
            raise EdreamError("A dreamer is for observed='dreamed' and a truth for observed='reality'; expected each with its own.")
        prepare_graphics()
        self.metadata = self.metadata | {"render_fps": round(rate)}
        self.render_mode, self.observed, self._dreamer = render_mode, observed, dreamer
        self._past: Past | None = None
        self._images: Mapping[str, np.ndarray] = {}
        published = load_robot(ROBOTS / f"{robot}.xml", robot, SITES[robot])
        entry, size = catalog.load("tasks", task, Task), (height, width)
        if truth is not None:
            self.world: World = _reality(published, truth, entry, rate, cameras, size)
        else:
            simulated = published if model is None else RobotModel(robot, Path(model).read_text(), {}, SITES[robot])
            seen = Images(cameras, height, width, raw=observed == "raw")
            self.world = SimulatedWorkcell(simulated, entry, rate, seen, hook)
        low, high = self.world.low.astype(np.float32), self.world.high.astype(np.float32)
        self.action_space = spaces.Box(low, high, dtype=np.float32)
        inside: dict[str, spaces.Space[Any]] = {"joints": spaces.Box(low - 1.0, high + 1.0, dtype=np.float32)}
        for name in cameras if observed != "state" else ():
            inside[name] = spaces.Box(0, 255, (height, width, 3), np.uint8)
        if observed == "state":
            for name in sorted(self.world.state()):
                inside[name] = spaces.Box(-10.0, 10.0, (7,), np.float32)
        self.observation_space = spaces.Dict(inside)  # type: ignore[assignment]
        self._step = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin a trial; `options={"start": number}` says which, else chance does."""
        super().reset(seed=seed)
        start = int((options or {}).get("start", self.np_random.integers(2**31)))
        self._step, self._past = 0, self._dreamer.start() if self._dreamer else None
        seen = self.world.reset(start)
        return self._seen(seen), self._info() | {"start": start}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Hold a command for one control step."""
        seen = self.world.step(np.asarray(action, float))
        self._step += 1
        info = self._info()
        return self._seen(seen), float(info["success"]), False, self._step >= self.world.steps, info

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """The first camera's image."""
        if self.render_mode is None:
            return None
        images = self._images
        if not images and isinstance(self.world, SimulatedWorkcell):
            images = self.world.raw()
        return next(iter(images.values())).copy()

    def close(self) -> None:
        """Free the graphics."""
        self.world.close()

    def _info(self) -> dict[str, Any]:
        outcome = self.world.outcome()
        return {"success": outcome.success, "grasped": bool(outcome.grasped), "distance": outcome.distance}

    def _seen(self, seen: Observation) -> dict[str, np.ndarray]:
        self._images = self._dreamed() if self._dreamer else dict(seen.images)
        out = {"joints": seen.joints.astype(np.float32), **self._images}
        if self.observed == "state":
            out |= {name: pose.astype(np.float32) for name, pose in sorted(self.world.state().items())}
        return out

    def _dreamed(self) -> dict[str, np.ndarray]:
        from edream.vision.dreamer import Render

        assert self._dreamer is not None and self._past is not None
        ((name, now),) = self.world.conditions().items()
        self._past, image = self._dreamer.step(self._past, Render(now.composite, now.robot, now.composite, now.object))
        return {name: image}


def _reality(robot: RobotModel, truth: Path, task: Task, rate: float, cameras: tuple[str, ...], size: tuple[int, int]) -> World:
    from edream.reality.cell_look import CellLook
    from edream.reality.truth import unseal
    from edream.reality.workcell import RealWorkcell

    return RealWorkcell(robot, unseal(truth), task, rate, CellLook(cameras, *size))


def identifier(task: str) -> str:
    """Under which id a task is registered."""
    return f"edream/{''.join(part.capitalize() for part in task.split('_'))}-v0"


for _task in catalog.names("tasks"):
    gymnasium.register(identifier(_task), entry_point="edream.gym:WorkcellEnv", kwargs={"task": _task})
