#include "proximity.hpp"

#include <algorithm>
#include <cmath>

namespace strips {

std::vector<std::int64_t> follow(const Bodies& bodies, const Frames& frames, const double* coordinates,
                                 double influence, Nodes& nodes, Distances& d) {
  const std::size_t G = bodies.size(), nv = static_cast<std::size_t>(bodies.tree.nv);
  std::vector<std::int64_t> lost;
  for (std::size_t n = 0; n < d.nodes; ++n) {
    const double* q = coordinates + n * nv;
    double* kept = nodes.coordinates + n * nv;
    if (std::equal(q, q + nv, kept)) continue;
    std::copy(q, q + nv, kept);
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (std::size_t g = 0; g < G; ++g) {
      const double *T = frames.at(bodies.joint[g], n), radius = bodies.radius[g];
      double *e = nodes.ends + (n * G + g) * 6, *r = nodes.rotations + (n * G + g) * 9;
      Vec3 one, two;
      bodies.ends_at(frames, n, g, one, two);
      const double way =
          std::max((one - Vec3(e[0], e[1], e[2])).squaredNorm(), (two - Vec3(e[3], e[4], e[5])).squaredNorm());
      double turn = 0.0;
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
          const double change = T[4 * i + k] - r[3 * i + k];
          turn += change * change;
          r[3 * i + k] = T[4 * i + k];
        }
        e[i] = one[i];
        e[3 + i] = two[i];
        low[i] = std::min(low[i], std::min(one[i], two[i]) - radius);
        high[i] = std::max(high[i], std::max(one[i], two[i]) + radius);
      }
      double shift = std::sqrt(way) + radius * std::sqrt(0.5 * turn);
      if (std::isnan(shift)) shift = FAR;
      double *bound = d.bound + d.index(n, g, 0), *since = d.since + d.index(n, g, 0);
      for (std::size_t p = 0; p < d.parts; ++p) {
        bound[p] -= shift;
        since[p] += shift;
      }
    }
    double depth = nodes.cover[n] < 0 ? -1.0 : INFINITY;
    for (int i = 0; i < 3 && nodes.cover[n] >= 0; ++i) {
      const std::size_t c = static_cast<std::size_t>(nodes.cover[n]) * 3 + i;
      depth = std::min(depth, std::min(low[i] - nodes.cover_low[c], nodes.cover_high[c] - high[i]));
    }
    nodes.margin[n] = depth;
    if (!(depth >= influence)) lost.push_back(static_cast<std::int64_t>(n));
  }
  return lost;
}

// Bound one pair by its capsule, and measure it where that is below `reach`.
static void measure(Queries& ask, std::size_t node, std::size_t body, std::size_t part, const Vec3& one,
                    const Vec3& two, double reach, Distances& d) {
  Vec3 shift;
  double uncertainty = 0.0;
  const Vec3* moves = ask.moving.at(static_cast<double>(node), part, shift, uncertainty) ? &shift : nullptr;
  const std::size_t k = d.index(node, body, part);
  ++ask.counts.pairs;
  const double cheap = capsule_bound(*ask.narrow.bodies, one, two, body, ask.parts, part, moves, uncertainty);
  if (cheap >= reach) {
    d.bound[k] = cheap;
    d.exact[k] = INFINITY;
    d.since[k] = FAR;
    return;
  }
  ++ask.counts.queries;
  const Found found = ask.exact(node, body, part, moves);
  d.exact[k] = found.distance - uncertainty;
  d.bound[k] = d.exact[k] - GJK_EXCESS;
  d.since[k] = 0.0;
  Eigen::Map<Vec3>(d.direction + 3 * k) = found.direction;
  Eigen::Map<Vec3>(d.witness + 3 * k) = found.witness;
}

void refine(Queries& ask, double influence, Distances& d) {
  for (std::size_t n = 0; n < d.nodes; ++n) {
    for (std::size_t g = 0; g < d.bodies; ++g) {
      const double *bound = d.bound + d.index(n, g, 0), *since = d.since + d.index(n, g, 0);
      bool placed = false;
      Vec3 one, two;
      for (std::size_t p = 0; p < d.parts; ++p) {
        if (!(bound[p] < influence && since[p] > d.limit[p])) continue;
        if (!placed) {
          ask.narrow.bodies->ends_at(ask.frames, n, g, one, two);
          placed = true;
        }
        measure(ask, n, g, p, one, two, influence, d);
      }
    }
  }
}

void refine_at(Queries& ask, std::size_t node, std::size_t body, std::size_t part, double reach, Distances& d) {
  const std::size_t at = d.index(node, body, part);
  if (!(d.bound[at] < reach && d.since[at] > 0.0)) return;
  Vec3 one, two;
  ask.narrow.bodies->ends_at(ask.frames, node, body, one, two);
  measure(ask, node, body, part, one, two, reach, d);
}

}  // namespace strips
