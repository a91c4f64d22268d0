"""Passage: on which side of two obstacles a strip goes."""

from __future__ import annotations

import numpy as np

from elastic_strips.scene import Scene
from elastic_strips.strip import Strip


def passage(strip: Strip, scene: Scene, gap: tuple[str, str] | None) -> str | None:
    """``"between"`` two obstacles, ``"around-left"`` or ``"around-right"`` of both (seen along the way), or None.

    The base's path is followed across the straight line through the obstacles' centres; its last crossing decides.
    """
    if gap is None or not strip.robot.space.planar or any(name not in scene for name in gap):
        return None
    one, two = (scene.obstacle(name).pose[:2, 3] for name in gap)
    path = strip.robot.space.to_chart(strip.sample(0.05))[:, :2]
    along = two - one
    normal = np.array([-along[1], along[0]])
    side = (path - one) @ normal
    crossings = np.flatnonzero(np.sign(side[:-1]) * np.sign(side[1:]) <= 0)
    if len(crossings) == 0 or along @ along == 0.0:
        return None
    k = int(crossings[-1])
    denominator = side[k] - side[k + 1]
    s = side[k] / denominator if denominator != 0 else 0.5
    point = path[k] + s * (path[k + 1] - path[k])
    fraction = float((point - one) @ along / (along @ along))
    if 0.0 < fraction < 1.0:
        return "between"
    way = path[-1] - path[0]
    offset = point - 0.5 * (one + two)
    return "around-left" if way[0] * offset[1] - way[1] * offset[0] > 0 else "around-right"
