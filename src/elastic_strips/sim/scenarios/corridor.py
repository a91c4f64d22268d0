"""The corridor: a seeded generator of 8 m of clutter whose straight whole-body sweep is blocked."""

from __future__ import annotations

import numpy as np

from elastic_strips.errors import ScenarioError
from elastic_strips.scene import Box, Capsule, Cone, ConvexHull, Cylinder, Obstacle, Scene, Sphere

LENGTH = 8.0
"""Distance [m] from start to goal, along x."""
HALF_WIDTH = 2.0
"""Half the distance [m] between the two walls."""
_OBSTACLES = 32
_BLOCKERS = 4
PASSAGE = 0.56
"""Half width [m] kept free about the guide curve: base radius, arm and room to turn."""
_ENDS = 0.95  # radius [m] about start and goal kept free: robot and influence distance
_STEPS = 400


def corridor_scene(seed: int = 0, *, obstacles: int = _OBSTACLES) -> Scene:
    """Two walls and boxes, cylinders, capsules, cones, hulls and spheres, standing and hanging, from x = 0 to x = 8 m.

    A smooth random guide curve from start to goal is kept free, so that a way exists; some obstacles stand on the
    straight line beside it. Start (0, 0) and goal (8, 0) keep a free disc.

    Args:
        seed: of the generator.
        obstacles: number of obstacles, walls included.

    Raises:
        ScenarioError: fewer obstacles than walls and blockers.
    """
    if obstacles < 2 + _BLOCKERS:
        raise ScenarioError(
            f"corridor: obstacles={obstacles} must be at least {2 + _BLOCKERS}: two walls, {_BLOCKERS} blockers"
        )
    rng = np.random.default_rng(seed)
    guide = _guide(rng)
    items: list[Obstacle] = [
        Box((LENGTH + 3.0, 0.1, 1.2), at=(LENGTH / 2, side * (HALF_WIDTH + 0.05), 0.6), name=name)
        for side, name in ((1.0, "wall-left"), (-1.0, "wall-right"))
    ]
    blockers = 0
    kinds = ("box", "cylinder", "capsule", "cone", "convex", "sphere", "hanging-box", "hanging-sphere")
    for _attempt in range(20_000):
        if len(items) == obstacles:
            return Scene(items)
        block = blockers < _BLOCKERS
        kind = kinds[int(rng.integers(6 if block else len(kinds)))]
        radius = float(rng.uniform(0.1, 0.28))
        x = float(rng.uniform(0.0, LENGTH)) if not block else float(rng.uniform(1.2, LENGTH - 1.2))
        y = float(rng.uniform(-0.12, 0.12)) if block else float(rng.uniform(-HALF_WIDTH, HALF_WIDTH))
        free = np.min(np.hypot(guide[:, 0] - x, guide[:, 1] - y))
        if free < radius + PASSAGE or min(np.hypot(x, y), np.hypot(x - LENGTH, y)) < radius + _ENDS:
            continue
        items.append(_obstacle(kind, radius, x, y, rng, f"{kind}-{len(items)}"))
        blockers += block
    raise ScenarioError(f"corridor: seed {seed} found no room for {obstacles} obstacles; ask for fewer")


def corridor_guide(seed: int) -> np.ndarray:
    """The curve (K, 2) [m] from start to goal about which the corridor of that seed is free."""
    return _guide(np.random.default_rng(seed))


def _guide(rng: np.random.Generator) -> np.ndarray:
    """A smooth curve from start to goal that swings to both sides: (K, 2)."""
    x = np.linspace(0.0, LENGTH, _STEPS)
    envelope = np.sin(np.pi * x / LENGTH) ** 0.5
    waves = rng.integers(1, 3)
    y = envelope * float(rng.uniform(0.95, 1.25)) * np.sin(np.pi * waves * x / LENGTH + rng.uniform(-0.3, 0.3))
    if rng.random() < 0.5:
        y = -y
    return np.column_stack((x, np.clip(y, -HALF_WIDTH + 0.62, HALF_WIDTH - 0.62)))


def _obstacle(kind: str, radius: float, x: float, y: float, rng: np.random.Generator, name: str) -> Obstacle:
    height = float(rng.uniform(0.35, 1.5))
    yaw = float(rng.uniform(-np.pi, np.pi))
    quat = (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    side = radius * np.sqrt(2.0)
    if kind == "box":
        return Box((side, side, height), at=(x, y, height / 2), quat=quat, name=name)
    if kind == "cylinder":
        return Cylinder(radius, height, at=(x, y, height / 2), name=name)
    if kind == "capsule":
        return Capsule(radius, height, at=(x, y, radius + height / 2), name=name)
    if kind == "cone":
        return Cone(radius, height, at=(x, y, height / 2), name=name)
    if kind == "convex":
        angle = np.sort(rng.uniform(0, 2 * np.pi, 5)) + np.arange(5) * 1e-3
        ring = radius * np.column_stack((np.cos(angle), np.sin(angle)))
        ring = np.vstack((ring, radius * np.array([[1, 0], [-0.5, 0.8], [-0.5, -0.8]])))
        low = np.column_stack((ring, np.full(len(ring), -height / 2)))
        high = np.column_stack((0.6 * ring, np.full(len(ring), height / 2)))
        return ConvexHull(np.vstack((low, high)), at=(x, y, height / 2), name=name)
    if kind == "sphere":
        return Sphere(radius, at=(x, y, radius), name=name)
    if kind == "hanging-box":
        return Box((side, side, 0.4), at=(x, y, float(rng.uniform(0.9, 1.5))), quat=quat, name=name)
    return Sphere(radius, at=(x, y, float(rng.uniform(0.8, 1.4))), name=name)
