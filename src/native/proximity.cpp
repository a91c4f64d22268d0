#include "proximity.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

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
      d.floor[n * G + g] -= shift;
      double *bound = d.bound, *since = d.since;
      for (std::size_t k = d.begin(n, g), end = d.end(n, g); k < end; ++k) {
        bound[k] -= shift;
        since[k] += shift;
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
static void measure(Queries& ask, std::size_t node, std::size_t body, std::size_t k, const Vec3& one, const Vec3& two,
                    double reach, std::optional<PlacedBox>& box, Distances& d) {
  const std::size_t part = static_cast<std::size_t>(d.part[k]);
  Vec3 shift;
  double uncertainty = 0.0;
  const Vec3* moves = ask.moving.at(static_cast<double>(node), part, shift, uncertainty) ? &shift : nullptr;
  ++ask.counts.pairs;
  double cheap = capsule_bound(*ask.narrow.bodies, one, two, body, ask.parts, part, moves, uncertainty);
  if (!(cheap >= reach)) {
    if (!box) box.emplace(*ask.narrow.bodies, ask.frames, node, body);
    cheap = std::max(cheap, box->bound(ask.parts, part, moves, uncertainty));
  }
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
  const double *bound = d.bound, *since = d.since;
  for (std::size_t n = 0; n < d.nodes; ++n) {
    for (std::size_t g = 0; g < d.bodies; ++g) {
      bool placed = false;
      Vec3 one, two;
      std::optional<PlacedBox> box;
      for (std::size_t k = d.begin(n, g), end = d.end(n, g); k < end; ++k) {
        if (!(bound[k] < influence && since[k] > d.limit[d.part[k]])) continue;
        if (!placed) {
          ask.narrow.bodies->ends_at(ask.frames, n, g, one, two);
          placed = true;
        }
        measure(ask, n, g, k, one, two, influence, box, d);
      }
    }
  }
}

void refine_at(Queries& ask, std::size_t node, std::size_t body, std::size_t at, double reach, Distances& d) {
  if (!(d.bound[at] < reach && d.since[at] > 0.0)) return;
  Vec3 one, two;
  ask.narrow.bodies->ends_at(ask.frames, node, body, one, two);
  std::optional<PlacedBox> box;
  measure(ask, node, body, at, one, two, reach, box, d);
}

namespace {

// The box about several balls.
struct Range {
  double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};

  void add(const double* center, double radius) {
    for (int i = 0; i < 3; ++i) {
      const double from = center[i] - radius, to = center[i] + radius;
      low[i] = std::isnan(from) ? -INFINITY : std::min(low[i], from);  // what is not a number is anywhere
      high[i] = std::isnan(to) ? INFINITY : std::max(high[i], to);
    }
  }
};

// Boxes of several parts, coordinate by coordinate, so that several are looked at at once.
struct Boxes {
  std::vector<std::int64_t> part;
  std::vector<double> side[6];  // low x, y, z, high x, y, z
  std::vector<std::uint8_t> met;

  void resize(std::size_t count) {
    part.resize(count);
    for (auto& s : side) s.resize(count);
  }
  // Those of `all` that meet a range.
  void among(const Boxes& all, const Range& range) {
    const std::size_t most = all.part.size();
    met.assign(most, 1);
    for (std::size_t i = 0; i < 3; ++i) {
      const double *from = all.side[i].data(), *to = all.side[3 + i].data(), least = range.low[i],
                   largest = range.high[i];
      for (std::size_t k = 0; k < most; ++k) met[k] &= !(from[k] > largest) & !(to[k] < least);
    }
    resize(most);
    std::size_t count = 0;
    for (std::size_t k = 0; k < most; ++k) {
      if (!met[k]) continue;
      part[count] = all.part[k];
      for (int i = 0; i < 6; ++i) side[i][count] = all.side[i][k];
      ++count;
    }
    resize(count);
  }
  // Squares of their distances from a point.
  void distances(const double* at, std::vector<double>& squares) const {
    const std::size_t count = part.size();
    squares.assign(count, 0.0);
    double* sum = squares.data();
    for (std::size_t i = 0; i < 3; ++i) {
      const double *low = side[i].data(), *high = side[3 + i].data(), x = at[i];
      for (std::size_t k = 0; k < count; ++k) {
        // one of the two is 0; without branches, so that several are computed at once
        const double before = low[k] - x, behind = x - high[k];
        const double gap = 0.5 * (before + std::abs(before)) + 0.5 * (behind + std::abs(behind));
        sum[k] += gap * gap;
      }
    }
  }
};

constexpr std::size_t kBlock = 8;  // nodes that are looked at together first

}  // namespace

Near near_parts(const Balls& b, const bool* always, const bool* fresh, const std::int64_t* start,
                const std::int64_t* part, const std::int64_t* source) {
  const std::size_t G = b.bodies;
  Near near;
  near.start.reserve(b.nodes * G + 1);
  near.start.push_back(0);
  Boxes all, some;
  all.resize(b.parts);
  std::int64_t most = 0;
  for (std::size_t p = 0; p < b.parts; ++p) {
    most = std::max(most, source[p] + 1);
    all.part[p] = static_cast<std::int64_t>(p);
    for (std::size_t i = 0; i < 3; ++i) {
      all.side[i][p] = always[p] ? -INFINITY : b.low[3 * p + i];  // what is always there meets every box
      all.side[3 + i][p] = always[p] ? INFINITY : b.high[3 * p + i];
    }
  }
  std::vector<Boxes> few(G);                                             // about each body at the nodes of a block
  std::vector<std::int64_t> places(static_cast<std::size_t>(most), -1);  // of parts in a former row
  std::vector<double> squares;
  for (std::size_t first = 0; first < b.nodes; first += kBlock) {
    const std::size_t last = std::min(first + kBlock, b.nodes);
    if (std::any_of(fresh + first, fresh + last, [](bool is) { return is; })) {
      Range whole;
      std::vector<Range> ranges(G);
      for (std::size_t n = first; n < last; ++n) {
        for (std::size_t g = 0; fresh[n] && g < G; ++g) {
          ranges[g].add(b.center + 3 * (n * G + g), b.radius[n * G + g]);
          whole.add(b.center + 3 * (n * G + g), b.radius[n * G + g]);
        }
      }
      some.among(all, whole);
      for (std::size_t g = 0; g < G; ++g) few[g].among(some, ranges[g]);
    }
    for (std::size_t row = first * G; row < last * G; ++row) {
      const std::int64_t begin = start[row], end = start[row + 1];
      if (!fresh[row / G]) {
        near.part.insert(near.part.end(), part + begin, part + end);
        for (std::int64_t k = begin; k < end; ++k) near.from.push_back(k);
      } else {
        for (std::int64_t k = begin; k < end; ++k) {
          if (part[k] < most) places[static_cast<std::size_t>(part[k])] = k;
        }
        const Boxes& around = few[row % G];
        const double reach = b.radius[row] * b.radius[row];
        around.distances(b.center + 3 * row, squares);
        for (std::size_t k = 0; k < squares.size(); ++k) {
          if (squares[k] > reach) continue;
          near.part.push_back(around.part[k]);
          const std::int64_t was = source[around.part[k]];
          near.from.push_back(was < 0 ? -1 : places[static_cast<std::size_t>(was)]);
        }
        for (std::int64_t k = begin; k < end; ++k) {
          if (part[k] < most) places[static_cast<std::size_t>(part[k])] = -1;
        }
      }
      near.start.push_back(static_cast<std::int64_t>(near.part.size()));
    }
  }
  return near;
}

}  // namespace strips
