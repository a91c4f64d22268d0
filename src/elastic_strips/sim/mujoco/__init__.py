"""MuJoCo: a physical machine (extra ``sim``)."""

from __future__ import annotations

from .plant import MujocoPlant

__all__ = ["MujocoPlant"]
