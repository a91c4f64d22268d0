#include "robot.hpp"

#include <algorithm>
#include <cmath>

namespace strips {

namespace {

constexpr std::size_t kMostLeaves = 64;  // spheres of a body
constexpr double kFineExcess = 1e-3;     // [m] a sphere that sticks out by less is not divided
constexpr double kPi = 3.14159265358979323846;

double wrap(double angle) {
  double rest = std::fmod(kPi - angle, 2.0 * kPi);  // as numpy.mod: into [0, 2 pi)
  if (rest < 0.0) rest += 2.0 * kPi;
  return kPi - rest;
}

double half_cot(double theta) {
  if (std::abs(theta) < SMALL_TURN) return 1.0 - theta * theta / 12.0;
  const double half = 0.5 * theta;
  return half / std::tan(half);
}

}  // namespace

void place(const Tree& tree, const double* coordinates, std::size_t n, double* T, double* J, std::size_t capacity) {
  for (std::size_t node = 0; node < n; ++node) {
    const double* q = coordinates + node * tree.nv;
    double* columns = J == nullptr ? nullptr : J + node * tree.motions() * 6;
    for (int i = 1; i < tree.joints; ++i) {
      const std::int64_t m = tree.motion[i];
      double* out = T + (i * capacity + node) * 12;
      if (m < 0) {  // the planar root
        const double c = std::cos(q[2]), s = std::sin(q[2]);
        const double base[12] = {c, -s, 0.0, q[0], s, c, 0.0, q[1], 0.0, 0.0, 1.0, 0.0};
        std::copy(base, base + 12, out);
        if (columns != nullptr) {
          const double rows[18] = {c, s, 0, 0, 0, 0, -s, c, 0, 0, 0, 0, q[1], -q[0], 0, 0, 0, 1};
          std::copy(rows, rows + 18, columns);
        }
        continue;
      }
      const double* P = T + (tree.parents[i] * capacity + node) * 12;
      const double* o = &tree.offset[i * 16];
      double f[12];
      for (int k = 0; k < 12; ++k) {
        const double *row = P + k / 4 * 4, *column = o + k % 4;
        f[k] = row[0] * column[0] + row[1] * column[4] + row[2] * column[8] + (k % 4 == 3 ? row[3] : 0.0);
      }
      const double rate = tree.rate[m], value = rate * q[tree.coordinate[m]] + tree.shift[m];
      if (tree.prismatic[i]) {
        for (int r = 0; r < 3; ++r) f[4 * r + 3] += f[4 * r + 2] * value;
      } else {
        const double c = std::cos(value), s = std::sin(value);
        for (int r = 0; r < 3; ++r) {
          const double x = f[4 * r], y = f[4 * r + 1];
          f[4 * r] = c * x + s * y;
          f[4 * r + 1] = c * y - s * x;
        }
      }
      std::copy(f, f + 12, out);
      if (columns != nullptr) {
        const double ax = rate * f[2], ay = rate * f[6], az = rate * f[10], px = f[3], py = f[7], pz = f[11];
        const double turns[6] = {py * az - pz * ay, pz * ax - px * az, px * ay - py * ax, ax, ay, az};
        const double slides[6] = {ax, ay, az, 0.0, 0.0, 0.0};
        std::copy_n(tree.prismatic[i] ? slides : turns, 6, columns + m * 6);
      }
    }
  }
}

void difference(const Space& space, const double* a, const double* b, double* v) {
  for (int k = 0; k < space.nv; ++k) v[k] = b[k] - a[k];
  const int base = space.base_nv();
  for (int k = base; k < space.nv; ++k) {
    if (space.circular[k - base]) v[k] = wrap(v[k]);
  }
  if (!space.planar) return;
  const double theta = wrap(v[2]), c = std::cos(a[2]), s = std::sin(a[2]);
  const double tx = c * v[0] + s * v[1], ty = c * v[1] - s * v[0];
  const double alpha = half_cot(theta), half = 0.5 * theta;
  v[0] = alpha * tx + half * ty;
  v[1] = alpha * ty - half * tx;
  v[2] = theta;
}

void integrate(const Space& space, const double* a, const double* v, double scale, double* out) {
  for (int k = 0; k < space.nv; ++k) out[k] = a[k] + scale * v[k];
  if (!space.planar) return;
  const double theta = scale * v[2], vx = scale * v[0], vy = scale * v[1];
  const bool small = std::abs(theta) < SMALL_TURN;
  const double s = small ? 1.0 - theta * theta / 6.0 : std::sin(theta) / theta;
  const double k = small ? 0.5 * theta : (1.0 - std::cos(theta)) / theta;
  const double dx = s * vx - k * vy, dy = k * vx + s * vy;
  const double cosine = std::cos(a[2]), sine = std::sin(a[2]);
  out[0] = a[0] + cosine * dx - sine * dy;
  out[1] = a[1] + sine * dx + cosine * dy;
}

const std::vector<SphereTree>& Bodies::spheres() const {
  std::call_once(kept->flag, [this] {
    for (const Solid& solid : solids) kept->value.push_back(sphere_tree(*solid.shape, kMostLeaves, kFineExcess));
  });
  return kept->value;
}

double Bounds::travel(const Tree& tree, const double* v, std::size_t body) const {
  double sum = 0.0;
  for (int m = 0; m < tree.motions(); ++m) sum += std::abs(v[tree.coordinate[m]]) * radius[m * bodies + body];
  return tree.planar ? sum + std::hypot(v[0], v[1]) : sum;
}

double Bounds::tight(const Bodies& robot, const Frames& frames, std::size_t node, std::size_t body,
                     const double* v) const {
  const Tree& tree = robot.tree;
  Vec3 one, two;
  robot.ends_at(frames, node, body, one, two);
  double outer = 0.0, sum = 0.0;  // joints further out are larger motions: what they do adds to a lever
  for (int m = tree.motions() - 1; m >= 0; --m) {
    const double r = radius[m * bodies + body], speed = std::abs(v[tree.coordinate[m]]), rate = std::abs(tree.rate[m]);
    if (!(tree.planar && m < 2) && tree.supports(robot.joint[body], m)) {
      const double* c = frames.J + (node * tree.motions() + m) * 6;
      const Vec3 linear(c[0], c[1], c[2]), angular(c[3], c[4], c[5]);
      double lever = rate;
      if (angular.cwiseAbs().maxCoeff() > SLIDING_TURN * rate) {
        const double reach = std::sqrt(
            std::max((angular.cross(one) + linear).squaredNorm(), (angular.cross(two) + linear).squaredNorm()));
        lever = reach + rate * robot.radius[body] + rate * outer;
      }
      sum += std::min(lever, r) * speed;
    }
    outer += r * speed;
  }
  return tree.planar ? sum + std::hypot(v[0], v[1]) : sum;
}

}  // namespace strips
