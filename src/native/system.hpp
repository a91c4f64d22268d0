// The step of a tick: forces and matrix of springs and contacts, the block tridiagonal solve, and rolling.
#pragma once

#include "certificate.hpp"

namespace strips {

// Forces (N, nv), diagonal blocks (N, nv, nv) and those above (N-1, nv, nv); see System.
struct System {
  double *force, *diagonal, *upper;
  std::size_t nodes, nv;
};

// Springs between neighbours along tangents v (N-1, nv) with stiffness `weight` (nv); returns their potential.
double add_elastic(System& system, bool planar, const double* v, const double* weight);

// Residuals, each at a node: a gradient (nv), a force along it and a stiffness.
void add_row(System& system, std::size_t node, const double* row, double force, double stiffness);

// How fast a point that a joint carries moves along a direction, per degree of freedom: adds nᵀJ to `row`.
// J (M, 6) are a node's Jacobian columns.
void add_directional(const Tree& tree, const double* J, std::int64_t joint, const double* point,
                     const double* direction, double* row);

// Repulsion at the witness points of what is within the influence distance; returns its potential.
double add_repulsion(System& system, const Bodies& bodies, const double* J, const Distances& distances,
                     double influence, double k_r, double near, double k_near);

// The same between own links that are nearer to each other than `repulsion` (S); frames with Jacobian columns.
double add_self_repulsion(System& system, const SelfPairs& pairs, const Frames& frames, const SelfDistances& distances,
                          const double* repulsion, double k_s);

// Joints are pulled to where `target` (N, nv) has them by k_p (nv), continuous ones the shorter way; their potential.
double add_posture(System& system, const double* coordinates, const double* target, const double* k_p,
                   const std::uint8_t* circular, std::size_t base_nv);

// Displacements (N, nv) of (D + K) delta = force, zero at both ends; no answer where the matrix is not positive
// definite.
void solve(const System& system, const double* damping, double* delta);

// Moves the inner poses (x, y, yaw) of rows (N, nv) until every segment can be driven; returns what is left sideways.
double project_rolling(double* coordinates, std::size_t n, int nv, int iterations, int& taken);

}  // namespace strips
