#include "rays.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace strips {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kLeastDivisor = 1e-14;
constexpr std::uint32_t kLeaf = 2;    // bodies that a node keeps together
constexpr std::size_t kPacket = 8;    // rays that go down the tree together
constexpr float kSlack = 1e-5f;       // [m] what single precision decides is taken to be larger by this, and by a
constexpr float kSlackRatio = 1e-6f;  // part of how far away it is: no body that a ray touches is dropped

double safe(double d) { return std::abs(d) < kLeastDivisor ? std::copysign(kLeastDivisor, d) : d; }

float loosely(double x) { return static_cast<float>(x) * (1.0f + kSlackRatio) + kSlack; }

struct Span {
  double enter, leave;
  bool there() const { return enter <= leave; }
  Span both(const Span& other) const { return {std::max(enter, other.enter), std::min(leave, other.leave)}; }
};
constexpr Span kNowhere{kInfinity, -kInfinity};

Span slab(double o, double d, double half) {
  const double inverse = 1.0 / safe(d), a = (-half - o) * inverse, b = (half - o) * inverse;
  return {std::min(a, b), std::max(a, b)};
}

// Within a radius of the origin, in `n` dimensions: from the foot of the perpendicular, for b² - a c cancels far away.
template <int n>
Span disc(const double* o, const double* d, double radius) {
  double a = 0.0, b = 0.0, c = 0.0, foot = 0.0;
  for (int k = 0; k < n; ++k) {
    a += d[k] * d[k];
    b += o[k] * d[k];
    c += o[k] * o[k];
  }
  if (!(a > kLeastDivisor)) return c <= radius * radius ? Span{-kInfinity, kInfinity} : kNowhere;
  const double middle = -b / a;
  for (int k = 0; k < n; ++k) {
    const double x = o[k] + middle * d[k];
    foot += x * x;
  }
  const double depth = (radius * radius - foot) / a;
  if (!(depth >= 0.0)) return kNowhere;
  const double root = std::sqrt(depth);
  return {middle - root, middle + root};
}

Span box(const double* o, const double* d, const double* half) {
  return slab(o[0], d[0], half[0]).both(slab(o[1], d[1], half[1])).both(slab(o[2], d[2], half[2]));
}

Span cylinder(const double* o, const double* d, double radius, double half) {
  return disc<2>(o, d, radius).both(slab(o[2], d[2], half));
}

Span capsule(const double* o, const double* d, double radius, double half) {
  Span all = cylinder(o, d, radius, half);
  if (!all.there()) all = kNowhere;
  for (const double sign : {-1.0, 1.0}) {
    const double end[3] = {o[0], o[1], o[2] - sign * half};
    const Span ball = disc<3>(end, d, radius);
    all = {std::min(all.enter, ball.enter), std::max(all.leave, ball.leave)};
  }
  return all;
}

// rho <= k w, where w is the depth below the tip: the borders that a ray crosses, the side (twice) and the base.
Span cone(const double* o, const double* d, double radius, double half) {
  const double k = radius / (2.0 * half), w = half - o[2], dw = -d[2];
  const double a = d[0] * d[0] + d[1] * d[1] - (k * dw) * (k * dw);
  const double b = o[0] * d[0] + o[1] * d[1] - k * k * w * dw;
  const double c = o[0] * o[0] + o[1] * o[1] - (k * w) * (k * w);
  const bool straight = std::abs(a) < 1e-12;  // parallel to the side
  const double square = b * b - a * c;
  const double root = std::sqrt(std::max(square, 0.0)), big = -(b + std::copysign(root, b));
  const bool real = square >= 0.0 || straight;
  Span all = kNowhere;
  const auto take = [&](double t, bool there) {
    if (there) all = {std::min(all.enter, t), std::max(all.leave, t)};
  };
  const auto along = [&](double t) {
    const double at = w + t * dw;
    return at >= -1e-12 && at <= 2.0 * half + 1e-12;
  };
  const double first = big / (straight ? 1.0 : a), second = c / (std::abs(big) < kLeastDivisor ? kLeastDivisor : big);
  take(first, real && !straight && along(first));
  take(second, real && along(second));
  const double base = (2.0 * half - w) / safe(dw);
  take(base, std::hypot(o[0] + base * d[0], o[1] + base * d[1]) <= radius);
  return all;
}

Span polyhedron(const double* o, const double* d, const double* plane, const double* end) {
  Span all{-kInfinity, kInfinity};
  for (; plane != end; plane += 4) {
    const double height = plane[0] * o[0] + plane[1] * o[1] + plane[2] * o[2] - plane[3];
    const double speed = plane[0] * d[0] + plane[1] * d[1] + plane[2] * d[2];
    if (speed < 0.0) {
      all.enter = std::max(all.enter, -height / speed);
    } else if (speed > 0.0) {
      all.leave = std::min(all.leave, -height / speed);
    } else if (height > 0.0) {
      return kNowhere;
    }
    if (!all.there() || all.leave < 0.0) return kNowhere;
  }
  return all;
}

}  // namespace

RayBodies::RayBodies(const std::int64_t* kind, const double* size, const std::int64_t* start, const double* planes,
                     std::size_t count)
    : kind_(kind, kind + count),
      size_(size, size + 3 * count),
      planes_(planes, planes + 4 * start[count]),
      start_(start, start + count + 1),
      rotation_(9 * count),
      translation_(3 * count),
      box_(6 * count),
      middle_(3 * count),
      order_(count) {}

void RayBodies::place(const double* rotation, const double* translation) {
  const std::size_t count = size();
  rotation_.assign(rotation, rotation + 9 * count);
  translation_.assign(translation, translation + 3 * count);
  for (std::size_t p = 0; p < count; ++p) {
    const double *R = rotation + 9 * p, *s = &size_[3 * p], *t = translation + 3 * p;
    const bool round = kind_[p] == SPHERE, ends = kind_[p] == CAPSULE,
               edged = kind_[p] == BOX || kind_[p] == POLYHEDRON;
    for (std::size_t k = 0; k < 3; ++k) {
      const double *row = R + 3 * k, turned = std::sqrt(row[0] * row[0] + row[1] * row[1]);
      double half = s[0];
      if (edged)
        half = std::abs(row[0]) * s[0] + std::abs(row[1]) * s[1] + std::abs(row[2]) * s[2];
      else if (!round)
        half = (ends ? s[0] : turned * s[0]) + std::abs(row[2]) * s[1];
      const float slack = kSlack + kSlackRatio * static_cast<float>(std::abs(t[k]) + half);
      box_[6 * p + k] = static_cast<float>(t[k] - half) - slack;
      box_[6 * p + 3 + k] = static_cast<float>(t[k] + half) + slack;
      middle_[3 * p + k] = static_cast<float>(t[k]);
    }
    order_[p] = static_cast<std::uint32_t>(p);
  }
  nodes_.clear();
  if (count == 0) return;
  nodes_.reserve(2 * count);
  nodes_.emplace_back();
  split(0, 0, static_cast<std::uint32_t>(count));
}

// Halves by number along the longest side of the boxes' middles: a tree of even depth, made quickly.
void RayBodies::split(std::uint32_t node, std::uint32_t first, std::uint32_t last) {
  float low[3], high[3], from[3], to[3];
  for (int k = 0; k < 3; ++k) {
    low[k] = from[k] = std::numeric_limits<float>::infinity();
    high[k] = to[k] = -low[k];
  }
  for (std::uint32_t i = first; i < last; ++i) {
    const float *b = &box_[6 * order_[i]], *m = &middle_[3 * order_[i]];
    for (int k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], b[k]);
      high[k] = std::max(high[k], b[3 + k]);
      from[k] = std::min(from[k], m[k]);
      to[k] = std::max(to[k], m[k]);
    }
  }
  for (int k = 0; k < 3; ++k) {
    nodes_[node].low[k] = low[k];
    nodes_[node].high[k] = high[k];
  }
  if (last - first <= kLeaf) {
    nodes_[node].first = first;
    nodes_[node].count = last - first;
    return;
  }
  int axis = 0;
  for (int k = 1; k < 3; ++k) {
    if (to[k] - from[k] > to[axis] - from[axis]) axis = k;
  }
  const std::uint32_t half = first + (last - first) / 2;
  std::nth_element(order_.begin() + first, order_.begin() + half, order_.begin() + last,
                   [&](std::uint32_t a, std::uint32_t b) { return middle_[3 * a + axis] < middle_[3 * b + axis]; });
  nodes_.emplace_back();
  split(node + 1, first, half);
  const std::uint32_t second = static_cast<std::uint32_t>(nodes_.size());
  nodes_.emplace_back();
  nodes_[node].first = second;
  nodes_[node].count = 0;
  split(second, half, last);
}

RayBodies::Hit RayBodies::meet(std::size_t p, const double* origin, const double* direction) const {
  const double *R = &rotation_[9 * p], *t = &translation_[3 * p], *s = &size_[3 * p];
  const double x[3] = {origin[0] - t[0], origin[1] - t[1], origin[2] - t[2]};
  double o[3], d[3];
  for (int k = 0; k < 3; ++k) {
    o[k] = R[k] * x[0] + R[3 + k] * x[1] + R[6 + k] * x[2];
    d[k] = R[k] * direction[0] + R[3 + k] * direction[1] + R[6 + k] * direction[2];
  }
  Span span = kNowhere;
  switch (kind_[p]) {
    case BOX:
      span = box(o, d, s);
      break;
    case SPHERE:
      span = disc<3>(o, d, s[0]);
      break;
    case CYLINDER:
      span = cylinder(o, d, s[0], s[1]);
      break;
    case CAPSULE:
      span = capsule(o, d, s[0], s[1]);
      break;
    case CONE:
      span = cone(o, d, s[0], s[1]);
      break;
    default:
      span = polyhedron(o, d, &planes_[4 * start_[p]], &planes_[4 * start_[p + 1]]);
  }
  return {span.enter, span.leave};
}

Vec3 RayBodies::normal_at(std::size_t p, const Vec3& point) const {
  const Eigen::Map<const Mat3> R(&rotation_[9 * p]);
  const Vec3 x = R.transpose() * (point - Eigen::Map<const Vec3>(&translation_[3 * p]));
  const double* s = &size_[3 * p];
  const auto unit = [](Vec3 v) -> Vec3 { return v / std::max(v.norm(), kLeastDivisor); };
  Vec3 n = Vec3::Zero();
  switch (kind_[p]) {
    case BOX: {
      int axis = 0;
      for (int k = 1; k < 3; ++k) {
        if (s[k] - std::abs(x[k]) < s[axis] - std::abs(x[axis])) axis = k;
      }
      n[axis] = x[axis] < 0.0 ? -1.0 : 1.0;
      break;
    }
    case SPHERE:
      n = unit(x);
      break;
    case CYLINDER:
      n = s[1] - std::abs(x[2]) < s[0] - std::hypot(x[0], x[1]) ? unit({0.0, 0.0, x[2]}) : unit({x[0], x[1], 0.0});
      break;
    case CAPSULE:
      n = unit({x[0], x[1], x[2] - std::clamp(x[2], -s[1], s[1])});
      break;
    case CONE: {
      const double slope = std::hypot(s[0], 2.0 * s[1]);
      const double rho = std::hypot(x[0], x[1]);
      const double side = (s[0] * (s[1] - x[2]) / (2.0 * s[1]) - rho) * 2.0 * s[1] / slope;
      n = unit({x[0], x[1], 0.0}) * (2.0 * s[1] / slope);
      n[2] = s[0] / slope;
      n = x[2] + s[1] < side ? Vec3(0.0, 0.0, -1.0) : unit(n);
      break;
    }
    default: {
      double nearest = -kInfinity;
      for (std::size_t k = start_[p]; k < start_[p + 1]; ++k) {
        const Eigen::Map<const Vec3> plane(&planes_[4 * k]);
        const double height = plane.dot(x) - planes_[4 * k + 3];
        if (height > nearest) {
          nearest = height;
          n = plane;
        }
      }
    }
  }
  return R * n;
}

void RayBodies::cast(const double* origin, bool common, const double* direction, std::size_t count, double reach,
                     double inside, double* distance, double* normal) const {
  if (nodes_.empty()) return;
  struct Waiting {
    std::uint32_t node;
    float from;
  };
  Waiting stack[96];  // two for each level of an even tree of 2^40
  for (std::size_t begin = 0; begin < count; begin += kPacket) {
    const std::size_t width = std::min(kPacket, count - begin);
    float o[3][kPacket], inverse[3][kPacket], limit[kPacket];
    std::size_t met[kPacket];
    std::fill_n(met, kPacket, size());
    for (std::size_t i = 0; i < kPacket; ++i) {
      const std::size_t ray = begin + std::min(i, width - 1);
      for (int k = 0; k < 3; ++k) {
        o[k][i] = static_cast<float>(origin[(common ? 0 : 3 * ray) + k]);
        inverse[k][i] = static_cast<float>(1.0 / safe(direction[3 * ray + k]));
      }
      limit[i] = loosely(std::min(reach, distance[ray]));
    }
    // How near the nearest of the rays that meet a node's box does so; infinite where none does.
    const auto enters = [&](const Node& node) {
      float nearest = std::numeric_limits<float>::infinity();
      float from[kPacket], to[kPacket];
      for (std::size_t i = 0; i < kPacket; ++i) {
        from[i] = 0.0f;
        to[i] = limit[i];
      }
      for (int k = 0; k < 3; ++k) {
        for (std::size_t i = 0; i < kPacket; ++i) {
          const float a = (node.low[k] - o[k][i]) * inverse[k][i], b = (node.high[k] - o[k][i]) * inverse[k][i];
          const float first = a < b ? a : b, last = a < b ? b : a;
          from[i] = from[i] > first ? from[i] : first;
          to[i] = to[i] < last ? to[i] : last;
        }
      }
      for (std::size_t i = 0; i < kPacket; ++i) {
        const float at =
            from[i] <= to[i] + (kSlack + kSlackRatio * to[i]) ? from[i] : std::numeric_limits<float>::infinity();
        nearest = nearest < at ? nearest : at;
      }
      return nearest;
    };
    std::size_t top = 0;
    float farthest = *std::max_element(limit, limit + width);
    const float whole = enters(nodes_[0]);
    if (whole < std::numeric_limits<float>::infinity()) stack[top++] = {0, whole};
    while (top > 0) {
      const Waiting next = stack[--top];
      if (next.from > farthest) continue;
      const Node& node = nodes_[next.node];
      if (node.count == 0) {
        const std::uint32_t one = next.node + 1, two = node.first;
        const float near_one = enters(nodes_[one]), near_two = enters(nodes_[two]);
        const bool swap = near_two < near_one;
        const Waiting nearer{swap ? two : one, swap ? near_two : near_one};
        const Waiting further{swap ? one : two, swap ? near_one : near_two};
        if (further.from < std::numeric_limits<float>::infinity()) stack[top++] = further;
        if (nearer.from < std::numeric_limits<float>::infinity()) stack[top++] = nearer;
        continue;
      }
      for (std::uint32_t j = node.first; j < node.first + node.count; ++j) {
        const std::size_t p = order_[j];
        const float* b = &box_[6 * p];
        for (std::size_t i = 0; i < width; ++i) {
          float from = 0.0f, to = limit[i];
          for (int k = 0; k < 3; ++k) {
            const float low = (b[k] - o[k][i]) * inverse[k][i], high = (b[3 + k] - o[k][i]) * inverse[k][i];
            from = std::max(from, std::min(low, high));
            to = std::min(to, std::max(low, high));
          }
          if (!(from <= to + (kSlack + kSlackRatio * to))) continue;
          const std::size_t ray = begin + i;
          const Hit hit = meet(p, origin + (common ? 0 : 3 * ray), direction + 3 * ray);
          if (!(hit.leave >= 0.0 && hit.leave >= hit.enter)) continue;
          const double at = hit.enter < 0.0 ? inside : hit.enter;
          if (!(at <= reach && at < distance[ray])) continue;
          distance[ray] = at;
          limit[i] = loosely(at);
          met[i] = p;
        }
      }
      farthest = *std::max_element(limit, limit + width);
    }
    if (normal == nullptr) continue;
    for (std::size_t i = 0; i < width; ++i) {
      const std::size_t ray = begin + i;
      if (met[i] == size()) continue;
      const Eigen::Map<const Vec3> from(origin + (common ? 0 : 3 * ray)), along(direction + 3 * ray);
      const Vec3 n = normal_at(met[i], from + distance[ray] * along);
      std::copy(n.data(), n.data() + 3, normal + 3 * ray);
    }
  }
}

}  // namespace strips
