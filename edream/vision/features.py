"""A small, fixed feature space for distances between images: energies of oriented filters. No weights, the same on every machine.

It is not LPIPS' nor a trained network's; distances in it carry names of their own.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

WAVELENGTHS = (3.0, 6.0, 12.0)  # pixel
ANGLES = 4


def energies(image: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 18"]:
    """Gabor energies of luma at three wavelengths and four angles, and of two opponent colours at three scales, compressed by a
    root.

    E = sqrt(even^2 + odd^2 + 1e-4) of the image in 0..1
    """
    value = image.astype(np.float32) / 255.0
    luma = value @ np.array([0.299, 0.587, 0.114], np.float32)
    found = []
    for even, odd in _bank():
        a, b = cv2.filter2D(luma, cv2.CV_32F, even), cv2.filter2D(luma, cv2.CV_32F, odd)
        found.append(np.sqrt(a * a + b * b + 1e-4))
    for colour in (value[..., 0] - value[..., 1], value[..., 2] - 0.5 * (value[..., 0] + value[..., 1])):
        for scale in WAVELENGTHS:
            found.append(cv2.GaussianBlur(colour, (0, 0), scale / 3.0))
    return np.stack(found, axis=-1)


def frechet(a: Float[np.ndarray, "N F"], b: Float[np.ndarray, "M F"], ridge: float = 1e-6) -> float:
    """Frechet distance of two samples, by eigenvalues in double precision; `ridge` is added to all variances."""
    ca, cb = np.cov(a.T) + ridge * np.eye(a.shape[1]), np.cov(b.T) + ridge * np.eye(b.shape[1])
    values, vectors = np.linalg.eigh(ca)
    root = vectors @ np.diag(np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    cross = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ cb @ root), 0.0)).sum()
    return float(np.square(a.mean(axis=0) - b.mean(axis=0)).sum() + np.trace(ca) + np.trace(cb) - 2.0 * cross)


def _bank() -> list[tuple[np.ndarray, np.ndarray]]:
    bank = []
    for wavelength in WAVELENGTHS:
        size = int(2 * round(wavelength) + 1)
        for k in range(ANGLES):
            pair = []
            for phase in (0.0, np.pi / 2):
                kernel = cv2.getGaborKernel((size, size), wavelength / 2.5, np.pi * k / ANGLES, wavelength, 1.0, phase, cv2.CV_32F)
                kernel = kernel - kernel.mean()
                pair.append(kernel / np.abs(kernel).sum())
            bank.append((pair[0], pair[1]))
    return bank
