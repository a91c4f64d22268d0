"""Implicit update: the banded solve equals the dense one."""

from __future__ import annotations

import numpy as np
from cases import each, refused

from elastic_strips.strip.solver import BandedSolver, System


def random_system(rng: np.random.Generator, n: int, nv: int) -> System:
    """A random block tridiagonal positive semidefinite system: JᵀJ of residuals between neighbours."""
    system = System(n, nv)
    for j in range(n - 1):
        a, b = rng.normal(size=(nv, nv)), rng.normal(size=(nv, nv))
        system.diagonal[j] += a.T @ a
        system.diagonal[j + 1] += b.T @ b
        system.upper[j] += a.T @ b
    system.force[:] = rng.normal(size=(n, nv))
    return system


def dense_solution(system: System, damping: np.ndarray) -> np.ndarray:
    """Ends fixed: the rows and columns of the inner nodes alone."""
    n, nv = system.force.shape
    inner = n - 2
    matrix = np.zeros((inner * nv, inner * nv))
    for j in range(inner):
        here = slice(j * nv, (j + 1) * nv)
        matrix[here, here] = system.diagonal[j + 1] + np.diag(damping)
        if j + 1 < inner:
            there = slice((j + 1) * nv, (j + 2) * nv)
            matrix[here, there] = system.upper[j + 1]
            matrix[there, here] = system.upper[j + 1].T
    out = np.zeros((n, nv))
    out[1:-1] = np.linalg.solve(matrix, system.force[1:-1].ravel()).reshape(inner, nv)
    return out


@each("n, nv", [(3, 1), (3, 10), (4, 3), (20, 10), (7, 11), (64, 4)])
def test_banded_equals_dense(n, nv, rng):
    system, damping = random_system(rng, n, nv), rng.uniform(0.05, 1.0, nv)
    kept = [system.force.copy(), system.diagonal.copy(), system.upper.copy()]
    delta = BandedSolver().solve(system, damping)
    np.testing.assert_allclose(delta, dense_solution(system, damping), rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(delta[[0, -1]], 0.0)
    for before, after in zip(kept, (system.force, system.diagonal, system.upper), strict=True):
        np.testing.assert_array_equal(before, after)


def test_the_workspace_forgets_its_last_system(rng):
    """Buffers are used again: results do not depend on what was solved before."""
    solver, damping = BandedSolver(), np.full(5, 0.3)
    for n in (12, 6, 6, 20, 12):
        system = random_system(rng, n, 5)
        np.testing.assert_allclose(solver.solve(system, damping), dense_solution(system, damping), atol=1e-9)


@each("n", [0, 1, 2])
def test_strips_without_inner_nodes_do_not_move(n):
    delta = BandedSolver().solve(System(n, 4), np.ones(4))
    np.testing.assert_array_equal(delta, np.zeros((n, 4)))


@each(
    "bad",
    [
        np.nan,
        np.inf,
        -10.0,
    ],
)
def test_what_is_not_positive_definite_is_an_error(bad, rng):
    system = random_system(rng, 6, 3)
    system.diagonal[2, 1, 1] = bad
    with refused(FloatingPointError, "definite"):
        BandedSolver().solve(system, np.full(3, 0.1))


def test_damping_shortens_the_step(rng):
    system = random_system(rng, 10, 4)
    sizes = [np.abs(BandedSolver().solve(system, np.full(4, d))).max() for d in (0.1, 1.0, 100.0)]
    assert sizes[0] > sizes[1] > sizes[2]
