"""The camera of a recording session: images for the recordings, and beside the data set what its owner would know about them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from edream.core.camera import as_json
from edream.core.episode import Video
from edream.core.scene import Scene, scene_json
from edream.reality.look import Look, Session, Studio
from edream.sim.robot import RobotModel

CAMERA = "cam_high"


class Filming:
    """Films one motion after the other. Images are rendered when they are read, never held."""

    def __init__(self, robot: RobotModel, look: Look, seed: int) -> None:
        self.studio, self.look = Studio(robot, look, seed), look
        self._seeds = np.random.SeedSequence((seed, 0xF11))
        self._sessions: dict[int, Session] = {}

    def __call__(self, index: int, times: np.ndarray, joints: np.ndarray) -> Mapping[str, Video]:
        """The images of motion `index`, whose links were at `joints` (T, nq) at `times` (T,)."""
        chance = np.random.SeedSequence(self._seeds.entropy, spawn_key=(index,))
        rng = np.random.default_rng(chance)
        thing = self.studio.wander(times, rng) if self.look.things else None
        session = Session(times, joints, thing, int(rng.integers(2**31)))
        self._sessions[index] = session
        return {CAMERA: Video(times, self.look.height, self.look.width, lambda: self.studio.frames(session))}

    def leave(self, names: Sequence[str], out: Path) -> dict[str, str]:
        """Write what lies beside the data set: the camera as calibrated, the object with its tracked pose, an empty scene's
        picture, and, sealed off under the name of truth, where the object was to be seen.

        Args:
            names: of the recordings, in order.
            out: the data set folder.

        Returns:
            What each file is -> its path.
        """
        paths = {what: out.with_name(out.name + end) for what, end in FILES.items()}
        paths["cameras"].write_text(json.dumps(as_json({CAMERA: self.studio.camera}), indent=1))
        tracks = {names[i]: {"block": s.thing} for i, s in self._sessions.items() if s.thing is not None}
        objects = (self.studio.thing(),) if tracks else ()
        paths["scene"].write_text(json.dumps(scene_json(Scene(objects, tracks))))
        cv2.imwrite(str(paths["plate"]), self.studio.plate()[:, :, ::-1])
        masks = {names[i]: np.stack(list(self.studio.masks(s))) for i, s in self._sessions.items()}
        np.savez_compressed(paths["truth masks"], **masks)  # type: ignore[arg-type]
        return {what: str(path) for what, path in paths.items()}


FILES = {"cameras": ".cameras.json", "scene": ".scene.json", "plate": ".plate.png", "truth masks": ".truth.masks.npz"}
