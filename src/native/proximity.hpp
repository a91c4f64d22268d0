// Distances that are kept from tick to tick: bounds that fall as bodies move, measured again where they matter.
#pragma once

#include "narrowphase.hpp"

namespace strips {

// What is known of each (node, body, part): arrays (N, G, P), or (N, G, P, 3); see ObstacleProximity.
struct Distances {
  double *bound, *since, *exact, *direction, *witness;
  const double* limit;  // (P)
  std::size_t nodes, bodies, parts, stamp = 0;

  std::size_t index(std::size_t n, std::size_t g, std::size_t p) const { return (n * bodies + g) * parts + p; }
};

// What was kept of the nodes (N) when they were last looked at: coordinates (N, nv), capsule ends (N, G, 2, 3),
// rotations (N, G, 3, 3); boxes (C, 3) that hold candidates for what is inside, which of them holds each node, and how
// deep.
struct Nodes {
  double *coordinates, *ends, *rotations;
  const double *cover_low, *cover_high;
  std::int64_t* cover;
  double* margin;
};

// Lower the bounds of nodes that moved by how far any point of each body can have moved, and keep where they are now;
// returns those that are less than `influence` deep in their box.
std::vector<std::int64_t> follow(const Bodies& bodies, const Frames& frames, const double* coordinates,
                                 double influence, Nodes& nodes, Distances& distances);

// Make exact what is below `influence` and has moved by more than its limit since it was measured.
void refine(Queries& ask, double influence, Distances& distances);

// Make a single pair exact whose bound is below `reach` and may be stale.
void refine_at(Queries& ask, std::size_t node, std::size_t body, std::size_t part, double reach, Distances& distances);

}  // namespace strips
