#include "timing.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace strips {

namespace {

constexpr double kFlat = 1e-9;  // rates that count as none
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTie = 1.0 + 1e-9;
constexpr int kDegree = 7;
// Shapes by powers of u, ascending; which of them lead a base aside: (body's x, y or yaw; shape). See path.py.
constexpr double kPowers[kShapes][kDegree + 1] = {
    {0, 0, 0, 10, -15, 6, 0, 0}, {0, 0, 0, 64, -192, 192, -64, 0}, {0, 0, 0, -256, 1280, -2304, 1792, -512}};
constexpr int kRolling[][2] = {{0, 0}, {0, 1}, {0, 2}, {2, 1}, {2, 2}}, kSliding[][2] = {{0, 0}, {1, 0}};
constexpr std::size_t kMost = 5;

// Bounds of the path acceleration u by the squared path speed x in every step of a grid: -room - slope x <= u <=
// room - slope x for `size` rows, twice the path's own, as the step's u holds at both of its ends.
struct Rates {
  std::size_t size;
  bool sound = true;  // whether the path is one: it moves, and everything is a number
  std::vector<double> step, room, slope, most;

  // Of a path `scale` long; rows in which it hardly moves are left out where `thin`.
  Rates(const Grid& g, double scale, bool thin) : size(2 * g.size), step(g.count), most(g.count, kInfinity) {
    const std::size_t m = g.size;
    std::vector<double> a(g.count * size), b(a.size()), large(size, 0.0);
    for (std::size_t i = 0; i < g.count; ++i) {
      const std::size_t next = std::min(i + 1, g.count - 1);
      step[i] = (g.s[next] - g.s[i]) / scale;
      for (std::size_t k = 0; k < size; ++k) {
        const std::size_t at = (k < m ? i : next) * m + k % m;
        b[i * size + k] = g.y2[at] * (scale / g.acceleration[k % m]);
        a[i * size + k] = g.y1[at] / g.acceleration[k % m] + (k < m ? 0.0 : 2.0 * step[i] * b[i * size + k]);
        large[k] = std::max(large[k], std::abs(a[i * size + k]));
        sound = sound && std::isfinite(a[i * size + k]) && std::isfinite(b[i * size + k]);
      }
    }
    const double greatest = *std::max_element(large.begin(), large.end()), least = thin ? 1e-9 * greatest : -1.0;
    sound = sound && greatest > 0.0;
    room.assign(a.size(), kInfinity);
    slope.assign(a.size(), 0.0);
    for (std::size_t k = 0; k < a.size(); ++k) {
      if (!(large[k % size] > least)) continue;
      if (std::abs(a[k]) < kFlat) {
        most[k / size] = std::min(most[k / size], 1.0 / std::abs(b[k]));
      } else {
        room[k] = 1.0 / std::abs(a[k]);
        slope[k] = b[k] / a[k];
      }
    }
  }

  // The row that bounds u from above (or, with `sign` -1, from below) at x, and the bound.
  std::pair<std::size_t, double> bound(std::size_t i, double x, double sign) const {
    std::pair<std::size_t, double> found{0, kInfinity};
    for (std::size_t k = i * size; k < (i + 1) * size; ++k) {
      const double u = room[k] - sign * slope[k] * x;
      if (u < found.second) found = {k, u};
    }
    return {found.first, sign * found.second};
  }

  // The largest x at a point from which some u keeps all rows, and x at the next within [0, reach]. What u may be is
  // concave in x, so Newton's steps from above end at it.
  double controllable(std::size_t i, double x, double reach) const {
    const double rate = 0.5 / step[i];
    x = std::min(x, most[i]);
    for (int tries = 0; tries < 64; ++tries) {
      const auto high = bound(i, x, 1.0), low = bound(i, x, -1.0);
      // u <= c - d x and u >= e - f x: rows, or the ends of the next point's range
      double c = reach * rate, d = rate, e = 0.0, f = rate;
      if (high.second < c - d * x) c = room[high.first], d = slope[high.first];
      if (low.second > e - f * x) e = -room[low.first], f = slope[low.first];
      const double over = (e - f * x) - (c - d * x);
      if (!(over > 1e-12 * (std::abs(e) + std::abs(f) * x))) break;
      x -= over / (d - f);
      if (!(x > 0.0)) return 0.0;
    }
    return x;
  }
};

}  // namespace

void travel_at(const Travel& curve, const double* s, std::size_t count, double* y, double* y1, double* y2) {
  const std::size_t m = curve.size;
  std::vector<double> before((curve.windows + 1) * m, 0.0);  // a step stays
  for (std::size_t k = 0; curve.weights && k < curve.windows * m; ++k) {
    before[m + k] = before[k] + curve.weights[k / m * kShapes * m + k % m];
  }
  for (std::size_t g = 0; g < count; ++g) {
    const double* end = curve.knots + curve.pieces;
    const std::size_t i = std::upper_bound(curve.knots + 1, end, s[g]) - curve.knots - 1;
    const double x = s[g] - curve.knots[i], *c = curve.coefficients + i * m;
    const std::size_t next = curve.pieces * m;
    double shape[kShapes][3], width = 1.0;
    std::size_t j = 0;
    if (curve.weights) {
      j = std::upper_bound(curve.edges + 1, curve.edges + curve.windows, s[g]) - curve.edges - 1;
      width = curve.edges[j + 1] - curve.edges[j];
      const double u = (s[g] - curve.edges[j]) / width;
      for (std::size_t k = 0; k < kShapes; ++k) {
        double value = 0.0, rate = 0.0, bend = 0.0;
        for (int p = kDegree; p >= 0; --p) {
          bend = bend * u + rate;
          rate = rate * u + value;
          value = value * u + kPowers[k][p];
        }
        shape[k][0] = value, shape[k][1] = rate / width, shape[k][2] = 2.0 * bend / (width * width);
      }
    }
    for (std::size_t k = 0; k < m; ++k) {
      const double c0 = c[k], c1 = c[next + k], c2 = c[2 * next + k], c3 = c[3 * next + k];
      double found[3] = {c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2.0 * c2 + 3.0 * x * c3),
                         2.0 * c2 + 6.0 * x * c3};
      if (curve.weights) {
        found[0] += before[j * m + k];
        for (std::size_t w = 0; w < kShapes; ++w) {
          const double weight = curve.weights[(j * kShapes + w) * m + k];
          for (int order = 0; order < 3; ++order) found[order] += weight * shape[w][order];
        }
      }
      if (y) y[g * m + k] = found[0];
      y1[g * m + k] = found[1];
      y2[g * m + k] = found[2];
    }
  }
}

void lead_base(const Windows& w, double largest, double near, double stalled, int iterations, double* weights) {
  const int (*parts)[2] = w.rolling ? kRolling : kSliding;
  const std::size_t used = w.rolling ? kMost : 2, size = w.count * kShapes * 3;
  const double part = 1.0 / static_cast<double>(w.points);
  std::vector<double> now(size, 0.0), jacobian(w.count * 2 * kMost), miss(w.count * 2);
  std::vector<bool> full(w.count, false);
  std::fill(weights, weights + size, 0.0);
  double least = kInfinity;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    std::fill(jacobian.begin(), jacobian.end(), 0.0);
    double at[2] = {0.0, 0.0}, worst = 0.0;
    for (std::size_t i = 0; i < w.count; ++i) {
      const double* u = now.data() + i * kShapes * 3;
      double* J = jacobian.data() + i * 2 * kMost;
      for (std::size_t q = 0; q < w.points; ++q) {
        const double *shape = w.shape + q * kShapes, *rate = w.rate + q * kShapes;
        double more[3] = {0.0, 0.0, 0.0};
        for (std::size_t c = 0; c < kShapes; ++c) {
          more[0] += u[3 * c] * rate[c];
          more[1] += u[3 * c + 1] * rate[c];
          more[2] += u[3 * c + 2] * shape[c];
        }
        const double *twist = w.twist + (i * w.points + q) * 3, angle = w.yaw[i * w.points + q] + more[2] / w.lever;
        const double vx = twist[0] + more[0] / w.width, vy = twist[1] + more[1] / w.width;
        const double cos = std::cos(angle), sin = std::sin(angle), px = cos * vx - sin * vy, py = sin * vx + cos * vy;
        at[0] += w.width * part * px;
        at[1] += w.width * part * py;
        const double directions[3][2] = {{cos, sin}, {-sin, cos}, {-py, px}};
        for (std::size_t k = 0; k < used; ++k) {
          const int axis = parts[k][0], c = parts[k][1];
          const double along = part * (axis < 2 ? rate[c] : shape[c] * (w.width / w.lever));
          for (int row = 0; row < 2; ++row) J[row * kMost + k] += directions[axis][row] * along;
        }
      }
      for (int row = 0; row < 2; ++row) {
        miss[2 * i + row] = w.target[2 * i + row] - at[row];
        worst = std::max(worst, std::abs(miss[2 * i + row]));
      }
    }
    const bool stays = iteration > 1 && worst > stalled * least;
    if (worst < kTie * least) {
      std::copy(now.begin(), now.end(), weights);
      least = worst;
    }
    if (worst < near || stays) return;
    for (std::size_t i = w.count; i-- > 0;) {  // a window that is full keeps what it is when its follower is asked
      const double* J = jacobian.data() + i * 2 * kMost;
      double ask[2] = {miss[2 * i], miss[2 * i + 1]}, xx = 1e-6, xy = 0.0, yy = 1e-6;
      if (i > 0 && !full[i - 1]) ask[0] -= miss[2 * i - 2], ask[1] -= miss[2 * i - 1];
      for (std::size_t k = 0; k < used; ++k) {
        xx += J[k] * J[k], xy += J[k] * J[kMost + k], yy += J[kMost + k] * J[kMost + k];
      }
      const double det = xx * yy - xy * xy, p = (yy * ask[0] - xy * ask[1]) / det,
                   r = (xx * ask[1] - xy * ask[0]) / det;
      double *u = now.data() + i * kShapes * 3, greatest = 0.0;
      for (std::size_t k = 0; k < used; ++k) u[3 * parts[k][1] + parts[k][0]] += p * J[k] + r * J[kMost + k];
      for (std::size_t k = 0; k < 3 * kShapes; ++k) greatest = std::max(greatest, std::abs(u[k]));
      greatest /= largest * w.width;
      full[i] = greatest > 1.0;
      for (std::size_t k = 0; full[i] && k < 3 * kShapes; ++k) u[k] /= greatest;
    }
  }
}

bool fastest(const Grid& grid, const double* bound, double start, double* x) {
  // lengths of 1 in a unit of time in which y1 stays as it is, so that tolerances mean the same for every path
  const double scale = grid.s[grid.count - 1];
  const Rates rates(grid, scale, true);
  if (!rates.sound) return false;
  const std::size_t last = grid.count - 1;
  std::vector<double> reach(grid.count, 0.0);
  for (std::size_t i = last; i-- > 0;) {
    reach[i] = rates.controllable(i, bound[i] / scale, reach[i + 1]);
    if (!(reach[i] > 0.0)) return false;
  }
  x[0] = start / scale;
  if (!(x[0] <= reach[0] * (1.0 + 1e-9))) return false;
  x[0] = std::min(x[0], reach[0]);
  for (std::size_t i = 0; i < last; ++i) {
    const double u = rates.bound(i, x[i], 1.0).second;
    x[i + 1] = std::max(std::min(x[i] + 2.0 * rates.step[i] * u, reach[i + 1]), 0.0);
    if (i + 1 < last && !(x[i + 1] > 0.0)) return false;
  }
  for (std::size_t i = 0; i <= last; ++i) x[i] *= scale;
  return true;
}

void braked(const Grid& grid, double start, double part, double* x) {
  const Rates rates(grid, 1.0, false);
  std::fill(x, x + grid.count, 0.0);
  x[0] = start;
  for (std::size_t i = 0; i + 1 < grid.count && x[i] > 0.0; ++i) {
    const double lower = rates.bound(i, x[i], -1.0).second, upper = rates.bound(i, x[i], 1.0).second;
    // in a bend that takes so much that the robot has to speed up, lower is above 0
    const double u =
        lower < 0.0 ? std::min(part * lower, 0.5 * (lower + upper)) : lower + (1.0 - part) * (upper - lower);
    x[i + 1] = std::max(x[i] + 2.0 * rates.step[i] * u, 0.0);
  }
}

}  // namespace strips
