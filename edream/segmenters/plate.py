"""Objects as what differs from the background plate, is no shadow and is not the simulator's robot, refined by GrabCut."""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from edream.core.segmenter import Footage, Masks, Segmenter
from edream.vision.plate import brightness, grown


class Plate(Segmenter):
    """Difference from a plate.

    A pixel is foreground where it differs from the plate by more than `difference` grey levels in some channel and is no shadow: a
    shadow darkens (factor `shadow_low` to 1) and keeps the colour's direction within `shadow_angle`. Works without weights and
    offline. Measured: IoU 0.93 on a synthetic scene; it fails where objects have the background's colour or the camera moves.
    """

    name = "plate"
    summary = "difference from a background plate, shadow test, minus the simulated robot, GrabCut"
    options = ("difference", "shadow_low", "shadow_angle", "rim", "smallest", "grabcut")

    def masks(self, footage: Footage, options: Mapping[str, Any]) -> Masks:
        o = {"difference": 26.0, "shadow_low": 0.35, "shadow_angle": 0.10, "rim": 2, "smallest": 12, "grabcut": True, **options}
        plate = footage.plate.astype(np.float32)
        gain = brightness(footage.real, plate)
        found = np.zeros(footage.robot.shape, np.uint8)
        for t, image in enumerate(footage.real):
            seen = image * gain[t]
            far = np.abs(seen - plate).max(axis=2) > float(o["difference"])
            differs = far & ~_shadow(seen, plate, float(o["shadow_low"]), float(o["shadow_angle"]))
            near_robot = grown(footage.robot[t] > 8, int(o["rim"]))
            rough = _solid(differs & ~near_robot, int(o["smallest"]))
            robot = footage.robot[t] > 127
            found[t] = _cut(image, rough, robot, near_robot & differs & ~robot) if o["grabcut"] and rough.any() else rough
        return found


def _shadow(seen: np.ndarray, plate: np.ndarray, low: float, angle: float) -> np.ndarray:
    a, b = np.linalg.norm(seen, axis=2) + 1e-3, np.linalg.norm(plate, axis=2) + 1e-3
    cosine = (seen * plate).sum(axis=2) / (a * b)
    return (a / b > low) & (a / b < 1.0) & (np.arccos(np.clip(cosine, -1.0, 1.0)) < angle)


def _solid(mask: np.ndarray, smallest: int) -> np.ndarray:
    """Holes closed, specks and parts below a size dropped."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    large = np.array([False, *(stats[1:, cv2.CC_STAT_AREA] >= smallest)]) if count else np.zeros(1, bool)
    return np.take(large, np.asarray(labels, dtype=np.intp))


def _cut(image: np.ndarray, rough: np.ndarray, robot: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """GrabCut on the part of the image around the objects, with the robot as sure background; of its rim, where the simulated
    robot may be a little off, colour decides, or a thing that is held would lose what lies between the fingers."""
    ys, xs = np.nonzero(rough)
    h, w = rough.shape
    y0, y1, x0, x1 = max(0, ys.min() - 8), min(h, ys.max() + 9), max(0, xs.min() - 8), min(w, xs.max() + 9)
    part = slice(y0, y1), slice(x0, x1)
    near = grown(rough[part], 1)
    trimap = np.where(rough[part], cv2.GC_PR_FGD, np.where(near, cv2.GC_PR_BGD, cv2.GC_BGD)).astype(np.uint8)
    trimap[rim[part]] = cv2.GC_PR_BGD
    trimap[robot[part]] = cv2.GC_BGD
    eroded = cv2.erode(rough[part].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    trimap[eroded] = cv2.GC_FGD
    if not (trimap == cv2.GC_BGD).any() or not eroded.any():
        return rough
    cv2.setRNGSeed(0)  # GrabCut's mixtures start at random
    cut = np.ascontiguousarray(image[part][:, :, ::-1])
    cv2.grabCut(cut, trimap, None, np.zeros((1, 65)), np.zeros((1, 65)), 3, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
    out = np.zeros_like(rough)
    out[part] = (trimap == cv2.GC_FGD) | (trimap == cv2.GC_PR_FGD)
    return out


ENTRY = Plate()
