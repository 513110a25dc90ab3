"""Objects found by words: Grounding DINO boxes in the first image, SAM 2 masks through the video. Needs a GPU and local weights."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from edream.core.errors import EdreamError
from edream.core.segmenter import Footage, Masks, Segmenter

MEAN, SPREAD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class Sam2(Segmenter):
    """Folders `grounding` and `sam2` under `masks.weights`, each as transformers writes them; option `prompt`: "a red cup. a
    plate."

    Where option `boxes` is given, as for `track`, Grounding DINO is not asked. SAM fails on robot arms, so the robot's mask is the
    simulator's. On a CPU a frame takes 7 to 12 s.
    """

    name = "sam2"
    summary = "Grounding DINO and SAM 2 video through transformers, from local weights (masks.weights)"
    options = ("prompt", "boxes")

    def masks(self, footage: Footage, options: Mapping[str, Any]) -> Masks:
        weights = options.get("weights")
        if weights is None or not (Path(weights) / "sam2").is_dir():
            raise EdreamError(
                f"masks.segmenter=sam2 needs masks.weights=FOLDER with 'sam2' (and 'grounding') in it, not {weights}."
            )
        try:
            import transformers  # type: ignore[import-not-found]
        except ImportError as error:
            raise EdreamError("masks.segmenter=sam2 needs the package transformers; pip install 'edream[sam2]'.") from error
        boxes = options.get("boxes", {})
        given = boxes.get(footage.name, boxes.get("all"))
        h, w = footage.robot.shape[1:]
        if given is not None:
            x, y, bw, bh = (float(v) for v in given)
            found = [[x * w, y * h, (x + bw) * w, (y + bh) * h]]
        else:
            found = _grounded(transformers, Path(weights) / "grounding", footage.real[0], str(options.get("prompt", "")))
        if not found:
            return np.zeros_like(footage.robot)
        masks = _followed(transformers, Path(weights) / "sam2", footage.real, found)
        return (masks & (footage.robot <= 127)).astype(np.uint8)


def _grounded(transformers: Any, folder: Path, image: np.ndarray, prompt: str) -> list[list[float]]:
    """Boxes [x0, y0, x1, y1] of what the words name."""
    import torch

    if not prompt or not folder.is_dir():
        raise EdreamError(f"Grounding DINO needs masks.options.prompt and weights in {folder}; or give masks.options.boxes.")
    model = _read(transformers.AutoModelForZeroShotObjectDetection, folder)
    words = transformers.AutoTokenizer.from_pretrained(folder, local_files_only=True)(prompt, return_tensors="pt")
    with torch.no_grad():
        out = model(pixel_values=_pixels(image[None], 800), **words)
    sure = out.logits.sigmoid()[0].max(dim=-1).values > 0.35
    centre = out.pred_boxes[0][sure]
    h, w = image.shape[:2]
    return [
        [float(x - bw / 2) * w, float(y - bh / 2) * h, float(x + bw / 2) * w, float(y + bh / 2) * h]
        for x, y, bw, bh in centre.tolist()
    ]


def _followed(transformers: Any, folder: Path, images: np.ndarray, boxes: list[list[float]]) -> np.ndarray:
    """The session is built by hand, for the processors need torchvision, of which there is no build to rely on."""
    import torch
    from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession  # type: ignore[import-not-found]

    device = "cuda" if torch.cuda.is_available() else "cpu"
    model = _read(transformers.Sam2VideoModel, folder).to(device)
    side = int(model.config.image_size)
    count, h, w = images.shape[:3]
    session = Sam2VideoInferenceSession(
        video=_pixels(images, side).to(device), video_height=h, video_width=w, inference_device=device, dtype=torch.float32
    )
    for number, box in enumerate(boxes):
        index = session.obj_id_to_idx(number)
        scaled = torch.tensor([[[box[0] / w, box[1] / h], [box[2] / w, box[3] / h]]], device=device)[None] * side
        session.add_point_inputs(index, 0, {"point_coords": scaled, "point_labels": torch.tensor([[[2, 3]]], device=device)})
        session.obj_with_new_inputs.append(number)
    masks = np.zeros((count, h, w), bool)
    with torch.no_grad():
        for found in model.propagate_in_video_iterator(session, start_frame_idx=0):
            large = torch.nn.functional.interpolate(found.pred_masks.float(), (h, w), mode="bilinear", align_corners=False)
            masks[found.frame_idx] = (large > 0).any(dim=0)[0].cpu().numpy()
    return masks


def _read(kind: Any, folder: Path) -> Any:
    """A model from a local folder, its weights from safetensors."""
    from safetensors import SafetensorError

    try:
        return kind.from_pretrained(folder, local_files_only=True, use_safetensors=True).eval()
    except (OSError, ValueError, KeyError, RuntimeError, SafetensorError) as error:
        raise EdreamError(f"{folder} holds no model that transformers reads: {' '.join(str(error).split())[:300]}.") from error


def _pixels(images: np.ndarray, side: int) -> Any:
    import torch

    value = torch.from_numpy(np.ascontiguousarray(images)).movedim(-1, 1).float() / 255.0
    large = torch.nn.functional.interpolate(value, (side, side), mode="bilinear", align_corners=False)
    return (large - torch.tensor(MEAN)[:, None, None]) / torch.tensor(SPREAD)[:, None, None]


ENTRY = Sam2()
