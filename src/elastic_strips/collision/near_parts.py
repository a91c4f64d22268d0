"""Near parts: which parts are near which bodies of a strip's nodes, so that of all others one number is enough.

Of thousands of parts near a strip, a body at a node is near to some dozens. They are its *row*; rows lie one behind the
other, in the order of nodes and bodies, and within a row parts ascend.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask, by_rows
from elastic_strips.native import kernel


@dataclass(frozen=True, eq=False)
class NearParts:
    """Rows of the parts near G bodies at N nodes, of P parts: K pairs in all.

    Attributes:
        shape: (N, G, P).
        start: (N·G + 1,) row r has the places ``start[r]`` to ``start[r + 1]``.
        part: (K,) the parts.
    """

    shape: tuple[int, int, int]
    start: Indices
    part: Indices

    @staticmethod
    def all_of(n: int, g: int, p: int) -> NearParts:
        """Rows of all parts."""
        return NearParts((n, g, p), np.arange(n * g + 1) * p, np.tile(np.arange(p), n * g))

    def __len__(self) -> int:
        return len(self.part)

    @cached_property
    def full(self) -> bool:
        """Whether every part is in every row."""
        n, g, p = self.shape
        return len(self) == n * g * p

    @cached_property
    def row(self) -> Indices:
        """(K,) the row of each place."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))

    def triple(self, at: Indices) -> tuple[Indices, Indices, Indices]:
        """Node, body and part (M,) of places ``at`` (M,)."""
        row = np.searchsorted(self.start, at, side="right") - 1
        return row // self.shape[1], row % self.shape[1], self.part[at]

    def neighbours(self) -> tuple[Indices, Indices]:
        """Places (M,) of pairs that are near at a node and at the next one, and their places there (M,)."""
        n, g, p = self.shape
        key = self.row * p + self.part
        here = np.arange(self.start[max(n - 1, 0) * g])
        there = np.minimum(np.searchsorted(key, key[here] + g * p), max(len(key) - 1, 0))
        both = key[there] == key[here] + g * p
        return here[both], there[both]

    def nodes(self, take: Indices | slice) -> tuple[NearParts, Indices | slice]:
        """Rows of nodes that were nodes ``take`` (M,), and at which place (K',) each pair was."""
        n, g, p = self.shape
        if isinstance(take, slice):
            first, last, _ = take.indices(n)
            start = self.start[first * g : last * g + 1]
            at = slice(int(start[0]), int(start[-1]))
            return NearParts((last - first, g, p), start - start[0], self.part[at]), at
        first, last = self.start[take * g], self.start[(take + 1) * g]
        rows = (take[:, None] * g + np.arange(g)).ravel()
        start = np.concatenate(([0], np.cumsum(self.start[rows + 1] - self.start[rows])))
        at = np.arange(start[-1]) + np.repeat(first - start[:-1:g], last - first)
        return NearParts((len(take), g, p), start, self.part[at]), at

    def again(
        self,
        center: Array,
        radius: Array,
        low: Array,
        high: Array,
        *,
        always: Mask,
        fresh: Mask,
        source: Indices,
    ) -> tuple[NearParts, Indices]:
        """Rows of what is near now.

        Args:
            center, radius: (N, G, 3), (N, G) balls about the bodies [m].
            low, high: (P, 3) boxes about the parts [m]; a part is near where its box meets the ball.
            always: (P,) parts that are in every row.
            fresh: (N,) nodes whose rows are made anew; the others keep theirs, and need the same parts as before.
            source: (P,) which part each was in these rows; −1 for a new one.

        Returns:
            The rows, and at which place (K',) each pair was; −1 where it was not there.
        """
        n, g, p = len(radius), radius.shape[1], len(low)
        module = kernel()
        if module is not None:
            center, radius, low, high = by_rows(center, radius, low, high)
            start, part, at = module.near_parts(
                center, radius, low, high, always, fresh, self.start, self.part, source, self.shape[2]
            )
            return NearParts((n, g, p), start, part), at
        near = np.zeros((n, g, p), dtype=bool)
        node, body, part = self.row // g, self.row % g, self.part
        keeps = ~fresh[node]
        near[node[keeps], body[keeps], part[keeps]] = True
        for k in np.flatnonzero(fresh).tolist():
            gap = np.maximum(np.maximum(low - center[k, :, None], center[k, :, None] - high), 0.0)
            gap *= gap
            near[k] = ~(gap[..., 0] + gap[..., 1] + gap[..., 2] > (radius[k] * radius[k])[:, None]) | always
        counts = near.sum(axis=2).ravel()
        new = NearParts((n, g, p), np.concatenate(([0], np.cumsum(counts))), np.nonzero(near)[2])
        if not len(self):
            return new, np.full(len(new), -1)
        key, wanted = self.row * self.shape[2] + self.part, new.row * self.shape[2] + source[new.part]
        at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        return new, np.where((key[at] == wanted) & (source[new.part] >= 0), at, -1)
