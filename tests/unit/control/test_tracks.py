"""Mover tracks: who brakes or turns is expected to go on so; who is new, or has taken another course, is not."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.control.params import Margins, ObstacleAssumptions
from elastic_strips.control.prediction import Outlook
from elastic_strips.control.tracks import MoverTracks
from elastic_strips.scene import Cylinder, Scene, Twist, UnknownMotion


def sensed(time: float, **velocities: tuple[float, float] | None) -> Scene:
    """Movers by name and velocity; None: of unknown motion."""
    motions = {n: UnknownMotion(1.0) if v is None else Twist(np.array([*v, 0.0])) for n, v in velocities.items()}
    movers = [Cylinder(0.2, 1.0, at=(k, 0.0, 0.5), name=n, motion=m) for k, (n, m) in enumerate(motions.items())]
    return Scene(movers, time=time)


def trend(tracks: MoverTracks, scene: Scene) -> dict[str, np.ndarray]:
    """Of the movers, by name."""
    outlook = Outlook.of(scene, ObstacleAssumptions(), Margins(0.02, 0.005))
    return dict(zip(scene.names, tracks.trend(outlook), strict=True))


def test_the_trend_is_the_acceleration_of_late():
    tracks = MoverTracks()
    for k in range(31):
        t = 0.05 * k
        velocities = {
            "steady": (0.5 + 0.018 * (-1.0) ** (k // 4), 0.0),  # as sensed
            "braking": (0.8 - 0.4 * t, 0.0),
            "turning": (0.8 * np.cos(0.5 * t), 0.8 * np.sin(0.5 * t)),
            "jumping": (0.8, 0.0) if t < 1.4 else (-0.8, 0.0),
            "unknown": None,
        }
        if k == 30:
            velocities["new"] = (1.0, 0.0)
        scene = sensed(t, **velocities)
        tracks.take(scene)
        tracks.take(scene)  # it is not newer, and says nothing
    found = trend(tracks, scene)
    np.testing.assert_allclose(found["braking"], (-0.4, 0.0, 0.0), atol=1e-9)
    assert np.linalg.norm(found["turning"]) == pytest.approx(0.4, abs=0.02)
    assert found["turning"] @ scene.obstacle("turning").velocity()[0] == pytest.approx(0.0, abs=0.03)
    for name in ("steady", "jumping", "unknown", "new"):
        assert not found[name].any()


@pytest.mark.parametrize("gap", [1.0, 0.05])
def test_a_track_begins_anew_after_a_gap(gap):
    tracks = MoverTracks()
    for k in range(11):
        tracks.take(sensed(0.05 * k, braking=(0.8 - 0.02 * k, 0.0)))
    scene = sensed(0.5 + gap, braking=(0.58, 0.0))
    tracks.take(scene)
    assert trend(tracks, scene)["braking"].any() == (gap < 0.5)
