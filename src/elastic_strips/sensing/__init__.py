"""Sensing room: range sensors of a robot, simulated or real, and what they say about obstacles."""

from __future__ import annotations

from .readings import NO_ANSWER, NOTHING, LaserScan, RangeRing, Reading

__all__ = ["LaserScan", "RangeRing", "Reading", "NOTHING", "NO_ANSWER"]
