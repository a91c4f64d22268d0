// Distances that are kept from tick to tick: bounds that fall as bodies move, measured again where they matter.
#pragma once

#include "narrowphase.hpp"

namespace strips {

// What is known of the parts near each body of each node: arrays (K), or (K, 3), row by row of (node, body), the parts
// of a row ascending; see ObstacleProximity. Row r has the places start[r] to start[r + 1].
struct Distances {
  double *bound, *since, *exact, *direction, *witness;
  const double* limit;               // (P)
  const std::int64_t *start, *part;  // (N * G + 1), (K)
  double* floor;                     // (N, G): all other parts are at least so far from the body
  std::size_t kept, nodes, bodies, parts, stamp = 0;

  std::size_t begin(std::size_t n, std::size_t g) const { return static_cast<std::size_t>(start[n * bodies + g]); }
  std::size_t end(std::size_t n, std::size_t g) const { return static_cast<std::size_t>(start[n * bodies + g + 1]); }
};

// Parts that are near the bodies of nodes, as Distances has them, and at which place each pair was among others.
struct Near {
  std::vector<std::int64_t> start, part, from;
};

// Balls about bodies: centres (N, G, 3) and radii (N, G). Boxes of P parts: low and high (P, 3).
struct Balls {
  const double *center, *radius, *low, *high;
  std::size_t nodes, bodies, parts;
};

// Rows of the parts whose boxes the balls meet, and of those that are `always` there (P). Nodes that are not `fresh`
// (N) keep the rows (start, part) that they had. `source` (P) says which part each was there, -1 for a new one.
Near near_parts(const Balls& balls, const bool* always, const bool* fresh, const std::int64_t* start,
                const std::int64_t* part, const std::int64_t* source);

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

// Make the pair at place `at` of a row exact whose bound is below `reach` and may be stale.
void refine_at(Queries& ask, std::size_t node, std::size_t body, std::size_t at, double reach, Distances& distances);

}  // namespace strips
