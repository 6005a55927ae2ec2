"""A small vocabulary of ORB descriptors for ORB-SLAM3 (DBoW2's text format), learnt from images of the twin.

ORB-SLAM3's own is not part of the wheel. The tree (Gálvez-López & Tardós 2012) has 10 branches, 4 levels and bitwise
means as nodes; words are weighted by inverse document frequency.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

BRANCHES, LEVELS, ROUNDS = 10, 4, 6
Bits = NDArray[np.float32]


@dataclass
class _Node:
    centre: Bits
    children: list[_Node] = field(default_factory=list)
    weight: float = 0.0


def write_vocabulary(images: Iterable[NDArray[np.uint8]], file: Path, rng: np.random.Generator) -> int:
    """Learns a tree and writes it.

    Args:
        images: (H, W) grey.
        file: Output file.
        rng: Draws the first centres.

    Returns:
        Number of words.
    """
    orb = cv2.ORB_create(nfeatures=500)
    descriptors = [orb.detectAndCompute(image, None)[1] for image in images]
    each = [np.unpackbits(d, axis=1).astype(np.float32) for d in descriptors if d is not None]
    bits, image = np.concatenate(each), np.repeat(np.arange(len(each)), [len(d) for d in each])
    root = _Node(centre=np.zeros(256, np.float32))
    _grow(root, bits, image, len(each), 1, rng)
    lines = [f"{BRANCHES} {LEVELS} 0 0", *_lines(root)]
    file.write_text("\n".join(lines), encoding="ascii")  # its reader takes an empty last line for a node
    return sum(line.split(" ", 2)[1] == "1" for line in lines[1:])


def _grow(node: _Node, bits: Bits, image: NDArray[np.intp], images: int, level: int, rng: np.random.Generator) -> None:
    if level > LEVELS or len(bits) <= BRANCHES:
        node.weight = float(np.log(images / max(len(np.unique(image)), 1)))
        return
    centres = bits[rng.choice(len(bits), BRANCHES, replace=False)]
    for _ in range(ROUNDS):
        nearest = _nearest(bits, centres)
        for k in np.unique(nearest):
            centres[k] = bits[nearest == k].mean(axis=0) > 0.5
    nearest = _nearest(bits, centres)
    for k in np.unique(nearest):
        child = _Node(centre=centres[k].copy())
        node.children.append(child)
        in_cluster = nearest == k
        _grow(child, bits[in_cluster], image[in_cluster], images, level + 1, rng)


def _nearest(bits: Bits, centres: Bits) -> NDArray[np.intp]:
    """(N,) index of the centre at the least Hamming distance."""
    return np.asarray(np.argmin(centres.sum(axis=1) - 2.0 * bits @ centres.T, axis=1))


def _lines(root: _Node) -> Iterator[str]:
    """One line per node, level by level: parent, whether it is a word, its 32 bytes, its weight."""
    level, number = [(0, root)], 0
    while level:
        below = []
        for parent, node in level:
            for child in node.children:
                number += 1
                below.append((number, child))
                octets = " ".join(str(b) for b in np.packbits(child.centre.astype(np.uint8)))
                yield f"{parent} {int(not child.children)} {octets} {child.weight:.6g}"
        level = below
