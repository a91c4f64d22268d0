#include "spheres.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

namespace strips {

namespace {

using Points = std::vector<Vec3>;

constexpr int kSides = 16;          // of the prisms that stand for cylinders and cones
constexpr int kDescents = 48;       // steps towards the best centre
constexpr double kRounding = 1e-6;  // [m] by which radii are safe from rounding in double precision
constexpr double kOutside = 1e-8;   // [m] what a hull in a plane may leave out
constexpr double kOnPlane = 1e-12;  // [m] a corner so near to a cut lies on it
constexpr std::uint32_t kNowhere = static_cast<std::uint32_t>(-1);
constexpr std::size_t kBranches = 4;  // of a sphere
constexpr double kPi = 3.14159265358979323846;

// A convex part of a body: its corners, and pairs of them with all its edges among them.
struct Part {
  Points corners;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;

  std::uint32_t add(const Vec3& corner) {
    corners.push_back(corner);
    return static_cast<std::uint32_t>(corners.size() - 1);
  }
  void all_edges(std::uint32_t first) {
    for (std::uint32_t k = first; k < corners.size(); ++k) {
      for (std::uint32_t i = first; i < k; ++i) edges.emplace_back(i, k);
    }
  }
};

// The corners, in order, of the hull of points across an axis; nothing where they nearly coincide and lead it astray.
std::vector<std::size_t> hull_across(const Points& points, int axis) {
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  std::vector<std::size_t> order(points.size()), chain;
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return points[a][u] < points[b][u] || (points[a][u] == points[b][u] && points[a][v] < points[b][v]);
  });
  const auto left = [&](std::size_t a, std::size_t b, std::size_t c) {
    const Vec3 one = points[b] - points[a], two = points[c] - points[a];
    return one[u] * two[v] > one[v] * two[u];
  };
  for (int side = 0; side < 2 && points.size() > 1; ++side) {
    const std::size_t begin = chain.size();
    for (std::size_t k : order) {
      while (chain.size() >= begin + 2 && !left(chain[chain.size() - 2], chain.back(), k)) chain.pop_back();
      chain.push_back(k);
    }
    chain.pop_back();  // the other side begins with it
    std::reverse(order.begin(), order.end());
  }
  for (std::size_t k = 0; k < chain.size(); ++k) {
    const Vec3 &a = points[chain[k]], along = points[chain[(k + 1) % chain.size()]] - a;
    const double most = kOutside * std::hypot(along[u], along[v]);
    for (const Vec3& p : points) {
      if (along[v] * (p[u] - a[u]) - along[u] * (p[v] - a[v]) > most) return {};
    }
  }
  return chain;
}

// The parts on either side of a plane across an axis.
std::pair<Part, Part> cut(const Part& part, int axis, double at) {
  Part sides[2];
  std::vector<std::uint32_t> number[2];
  Points across;
  std::vector<std::uint32_t> known[2];  // of what is in the plane
  for (const Vec3& p : part.corners) {
    const double height = p[axis] - at;
    const bool in[2] = {height <= kOnPlane, height >= -kOnPlane};
    for (int i = 0; i < 2; ++i) number[i].push_back(in[i] ? sides[i].add(p) : kNowhere);
    if (!in[0] || !in[1]) continue;
    across.push_back(p);
    for (int i = 0; i < 2; ++i) known[i].push_back(number[i].back());
  }
  for (const auto& [j, k] : part.edges) {
    bool whole = false;
    for (int i = 0; i < 2; ++i) {
      if (number[i][j] == kNowhere || number[i][k] == kNowhere) continue;
      sides[i].edges.emplace_back(number[i][j], number[i][k]);
      whole = true;
    }
    if (whole) continue;
    const Vec3 &p = part.corners[j], &q = part.corners[k];
    Vec3 between = p + (at - p[axis]) / (q[axis] - p[axis]) * (q - p);
    between[axis] = at;
    across.push_back(between);
    for (int i = 0; i < 2; ++i) {
      const std::uint32_t end = number[i][j] == kNowhere ? number[i][k] : number[i][j];
      known[i].push_back(sides[i].add(between));
      sides[i].edges.emplace_back(end, known[i].back());
    }
  }
  const std::vector<std::size_t> around = hull_across(across, axis);
  for (int i = 0; i < 2; ++i) {
    for (std::size_t k = 0; k < around.size(); ++k) {
      sides[i].edges.emplace_back(known[i][around[k]], known[i][around[(k + 1) % around.size()]]);
    }
    for (std::size_t k = 0; around.empty() && k < across.size(); ++k) {  // any two of them may have an edge
      for (std::size_t j = 0; j < k; ++j) sides[i].edges.emplace_back(known[i][j], known[i][k]);
    }
  }
  return {std::move(sides[0]), std::move(sides[1])};
}

double farthest(const Points& corners, const Vec3& from, Vec3& corner) {
  double most = -1.0;
  for (const Vec3& p : corners) {
    const double d = (p - from).squaredNorm();
    if (d <= most) continue;
    most = d;
    corner = p;
  }
  return std::sqrt(most);
}

struct Ball {
  Vec3 center;
  double outer, depth;
  double excess(double swept) const { return outer + swept - std::max(0.0, depth + swept); }
};

// The ball about corners that sticks out of the body least: radius less depth is convex in the centre, so that steps
// against what grows find it.
Ball ball_of(const Hull& body, const Points& corners) {
  Vec3 low = corners[0], high = corners[0], corner = corners[0], out = Vec3::Zero();
  for (const Vec3& p : corners) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  Vec3 at = 0.5 * (low + high);
  Ball best{at, INFINITY, 0.0};
  const double reach = 0.5 * (high - low).norm();
  for (int k = 0; k <= kDescents; ++k) {
    const double outer = farthest(corners, at, corner), depth = body.depth(at, out);
    if (outer - depth < best.outer - best.depth) best = {at, outer, depth};
    if (body.normals.empty() || outer == 0.0) break;
    Vec3 down = (corner - at) / outer - out;
    at += reach / (k + 2.0) * 0.5 * down;
  }
  return best;
}

struct Builder {
  const Hull& body;
  std::size_t most;
  double fine;
  SphereTree tree;

  void add(const Part& part, std::size_t leaves) {
    const Points& corners = part.corners;
    Ball ball = ball_of(body, corners);
    SphereTree::Sphere made{};
    for (int i = 0; i < 3; ++i) {
      made.center[i] = static_cast<float>(ball.center[i]);
      ball.center[i] = made.center[i];
    }
    Vec3 unused;
    const double outer = farthest(corners, ball.center, unused) + body.swept + kRounding;
    const double inner = body.depth(ball.center, unused) + body.swept - kRounding;
    made.outer = std::nextafter(static_cast<float>(outer), std::numeric_limits<float>::max());
    made.inner = std::max(0.0f, std::nextafter(static_cast<float>(inner), 0.0f));
    const std::size_t at = tree.spheres.size();
    tree.spheres.push_back(made);
    if (leaves >= kBranches && outer - std::max(inner, 0.0) > fine) {
      const auto [low, high] = halves(part);
      for (const Part* half : {&low, &high}) {
        const auto [one, two] = halves(*half);
        add(one, leaves / kBranches);
        add(two, leaves / kBranches);
      }
    }
    tree.spheres[at].next = static_cast<std::uint32_t>(tree.spheres.size());
  }

  // Cut across the longest side of the box about the corners.
  static std::pair<Part, Part> halves(const Part& part) {
    Vec3 low = part.corners[0], high = part.corners[0];
    for (const Vec3& p : part.corners) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    int axis;
    (high - low).maxCoeff(&axis);
    return cut(part, axis, 0.5 * (low[axis] + high[axis]));
  }
};

}  // namespace

Hull::Hull(const coal::ShapeBase& shape) : swept(shape.getSweptSphereRadius()) {
  switch (shape.getNodeType()) {
    case coal::GEOM_BOX:
      box(static_cast<const coal::Box&>(shape).halfSide, 1.0);
      break;
    case coal::GEOM_SPHERE:
      corners.push_back(Vec3::Zero());
      swept += static_cast<const coal::Sphere&>(shape).radius;
      break;
    case coal::GEOM_CAPSULE: {
      const auto& capsule = static_cast<const coal::Capsule&>(shape);
      corners = {Vec3(0.0, 0.0, -capsule.halfLength), Vec3(0.0, 0.0, capsule.halfLength)};
      swept += capsule.radius;
      break;
    }
    case coal::GEOM_CYLINDER:
      round(static_cast<const coal::Cylinder&>(shape).radius, static_cast<const coal::Cylinder&>(shape).halfLength,
            false);
      break;
    case coal::GEOM_CONE:
      round(static_cast<const coal::Cone&>(shape).radius, static_cast<const coal::Cone&>(shape).halfLength, true);
      break;
    case coal::GEOM_ELLIPSOID:  // the box about it, and the one in it
      box(static_cast<const coal::Ellipsoid&>(shape).radii, 1.0 / std::sqrt(3.0));
      break;
    default: {
      const auto* convex = dynamic_cast<const coal::Convex<coal::Triangle>*>(&shape);
      if (convex == nullptr) throw std::invalid_argument("spheres for a shape of an unknown kind");
      facets(*convex);
    }
  }
  for (const Vec3& n : normals) {
    double most = -INFINITY;
    for (const Vec3& p : corners) most = std::max(most, n.dot(p));
    outer.push_back(most);
  }
}

double Hull::depth(const Vec3& at, Vec3& out) const {
  double least = normals.empty() ? 0.0 : INFINITY;
  for (std::size_t k = 0; k < normals.size(); ++k) {
    const double d = inner[k] - normals[k].dot(at);
    if (d >= least) continue;
    least = d;
    out = normals[k];
  }
  return least;
}

// Faces at `part` of the way to those of a box.
void Hull::box(const Vec3& half, double part) {
  for (int k = 0; k < 8; ++k) {
    corners.emplace_back(k & 1 ? half[0] : -half[0], k & 2 ? half[1] : -half[1], k & 4 ? half[2] : -half[2]);
  }
  for (int i = 0; i < 3; ++i) {
    for (double sign : {-1.0, 1.0}) {
      normals.push_back(sign * Vec3::Unit(i));
      inner.push_back(part * half[i]);
    }
  }
}

// A cylinder, or a cone with its tip at the top: the corners of the prism about it, and the sides of the one in it.
void Hull::round(double radius, double half, bool tip) {
  const double step = 2.0 * kPi / kSides, about = radius / std::cos(0.5 * step), within = radius * std::cos(0.5 * step);
  for (int k = 0; k < kSides; ++k) {
    const Vec3 corner(about * std::cos(k * step), about * std::sin(k * step), 0.0);
    corners.push_back(corner - half * Vec3::UnitZ());
    if (!tip) corners.push_back(corner + half * Vec3::UnitZ());
    const Vec3 level(std::cos((k + 0.5) * step), std::sin((k + 0.5) * step), 0.0);
    const Vec3 side = tip ? Vec3(2.0 * half * level + within * Vec3::UnitZ()) : level;
    normals.push_back(side.normalized());
    inner.push_back((tip ? within * half : within) / side.norm());
  }
  if (tip) corners.push_back(half * Vec3::UnitZ());
  for (double sign : {-1.0, 1.0}) {
    if (tip && sign > 0.0) continue;
    normals.push_back(sign * Vec3::UnitZ());
    inner.push_back(half);
  }
}

void Hull::facets(const coal::Convex<coal::Triangle>& shape) {
  corners.assign(shape.points->begin(), shape.points->end());
  bool closed = true;  // whether the triangles are the whole surface of the hull, so that their sides are its edges
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> sides;
  for (const coal::Triangle& t : *shape.polygons) {
    const Vec3& a = corners[t[0]];
    Vec3 n = (corners[t[1]] - a).cross(corners[t[2]] - a);
    for (int i = 0; i < 3; ++i) {
      const auto j = static_cast<std::uint32_t>(t[i]), k = static_cast<std::uint32_t>(t[(i + 1) % 3]);
      ++sides[{std::min(j, k), std::max(j, k)}];
    }
    const double length = n.norm();
    if (length == 0.0) continue;
    n /= length;
    double up = 0.0, down = 0.0;  // which way a triangle turns is nobody's promise: the others are on its inner side
    for (const Vec3& p : corners) {
      up = std::max(up, n.dot(p - a));
      down = std::max(down, n.dot(a - p));
    }
    const double sign = up <= down ? 1.0 : -1.0;
    closed = closed && std::min(up, down) <= kOutside;
    normals.push_back(sign * n);
    inner.push_back(sign * n.dot(a) - std::min(up, down));
  }
  for (const auto& [side, count] : sides) {
    closed = closed && count == 2;
    edges.push_back(side);
  }
  if (!closed) edges.clear();
}

SphereTree sphere_tree(const coal::ShapeBase& shape, std::size_t most, double fine) {
  const Hull body(shape);
  Part whole{body.corners, body.edges};
  if (whole.edges.empty()) whole.all_edges(0);
  Builder builder{body, most, fine, {}};
  builder.add(whole, most);
  return std::move(builder.tree);
}

}  // namespace strips
