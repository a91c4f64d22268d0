"""Methods room: obstacle avoidance of a mobile base by the methods that the paper builds on or compares with."""

from __future__ import annotations
