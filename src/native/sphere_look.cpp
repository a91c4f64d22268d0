// Compiled once for each instruction set, as STRIPS_LOOK, with vectors of STRIPS_WIDTH numbers: nothing in here may be
// shared with what is compiled for another one, so that there are no templates and nothing of the standard library.
#include "sphere_look.hpp"

namespace strips {

namespace {

constexpr int kWidth = STRIPS_WIDTH;
typedef float Lanes __attribute__((vector_size(4 * kWidth)));
typedef std::int32_t Which __attribute__((vector_size(4 * kWidth)));  // -1 in lanes where something holds, else 0

constexpr float kInfinite = __builtin_inff();

inline float least(float a, float b) { return a < b ? a : b; }
inline float most(float a, float b) { return a > b ? a : b; }
inline Lanes all(float x) { return Lanes{} + x; }
inline Lanes positive(Lanes a) { return a > 0.0f ? a : Lanes{}; }
inline Lanes size(Lanes a) { return a < 0.0f ? -a : a; }
inline Lanes root(Lanes a) {
  for (int k = 0; k < kWidth; ++k) a[k] = __builtin_sqrtf(a[k]);
  return a;
}
inline Lanes& lanes(float* x) { return *reinterpret_cast<Lanes*>(x); }

// A bit for each lane in which it holds.
inline unsigned bits(Which which) {
#if defined(__AVX__) && STRIPS_WIDTH == 8
  return static_cast<unsigned>(__builtin_ia32_movmskps256(reinterpret_cast<Lanes>(which)));
#elif defined(__SSE__) && STRIPS_WIDTH == 4
  return static_cast<unsigned>(__builtin_ia32_movmskps(reinterpret_cast<Lanes>(which)));
#else
  Which weights;
  for (int k = 0; k < kWidth; ++k) weights[k] = 1 << k;
  which &= weights;
  std::int32_t sum = 0;
  for (int k = 0; k < kWidth; ++k) sum |= which[k];
  return static_cast<unsigned>(sum);
#endif
}

// Sine and cosine of angles within a turn, to 2e-7: of the quarter that an angle is in, by their series.
inline void turn(Lanes angle, Lanes& sine, Lanes& cosine) {
  const Lanes quarters = angle * 0.636619772f;
  const Which n = __builtin_convertvector(quarters + (quarters < 0.0f ? all(-0.5f) : all(0.5f)), Which);
  const Lanes whole = __builtin_convertvector(n, Lanes);
  const Lanes x = (angle - whole * 1.57079637f) + whole * 4.37113883e-8f, y = x * x;
  const Lanes s = x + x * y * (-1.6666654611e-1f + y * (8.3321608736e-3f + y * -1.9515295891e-4f));
  const Lanes c =
      1.0f - 0.5f * y + y * y * (4.166664568298827e-2f + y * (-1.388731625493765e-3f + y * 2.443315711809948e-5f));
  const Which odd = (n & 1) != 0;
  const Lanes a = odd ? c : s, b = odd ? s : c;
  sine = (n & 2) != 0 ? -a : a;
  cosine = ((n + 1) & 2) != 0 ? -b : b;
}

// One vector of rows, from `begin` on.
struct Look {
  const SphereScene& scene;
  SphereScratch& scratch;
  const int begin;
  const bool first;
  unsigned rows, hit = 0;  // bits of this vector's lanes
  SphereOpen* open;
  std::size_t most_open;
  std::size_t& opened;

  bool over() const { return hit == rows || (first && hit != 0); }
  float* number(float* from, std::size_t k) const { return from + k * kRows + begin; }
  Lanes growth(const float* grown, std::size_t k) const {
    return grown == nullptr ? Lanes{} : *reinterpret_cast<const Lanes*>(grown + k * kRows + begin);
  }

  void place() {
    for (int k = 0; k < 12; ++k) lanes(number(scratch.T, k)) = all(k % 5 == 0 ? 1.0f : 0.0f);
    for (int i = 1; i < scene.joints; ++i) {
      float* T = scratch.T + 12 * kRows * static_cast<std::size_t>(i);
      float* value = scratch.values + 3 * kRows * static_cast<std::size_t>(i);
      Lanes s, c;
      if (scene.kind[i] == 0) {
        turn(lanes(number(value, 2)), s, c);
        const Lanes base[12] = {c,       -s,      Lanes{},   lanes(number(value, 0)),
                                s,       c,       Lanes{},   lanes(number(value, 1)),
                                Lanes{}, Lanes{}, all(1.0f), Lanes{}};
        for (int k = 0; k < 12; ++k) lanes(number(T, k)) = base[k];
        continue;
      }
      float* P = scratch.T + 12 * kRows * static_cast<std::size_t>(scene.parents[i]);
      const float* o = scene.offset + 12 * static_cast<std::size_t>(i);
      Lanes f[12];
      for (int k = 0; k < 12; ++k) {
        const int row = k / 4 * 4, column = k % 4;
        f[k] = lanes(number(P, row)) * o[column] + lanes(number(P, row + 1)) * o[4 + column] +
               lanes(number(P, row + 2)) * o[8 + column];
        if (column == 3) f[k] += lanes(number(P, row + 3));
      }
      if (scene.kind[i] == 2) {
        for (int r = 0; r < 12; r += 4) f[r + 3] += f[r + 2] * lanes(number(value, 0));
      } else {
        turn(lanes(number(value, 0)), s, c);
        for (int r = 0; r < 12; r += 4) {
          const Lanes x = f[r], y = f[r + 1];
          f[r] = c * x + s * y;
          f[r + 1] = c * y - s * x;
        }
      }
      for (int k = 0; k < 12; ++k) lanes(number(T, k)) = f[k];
    }
  }

  float* posed(std::size_t body, std::size_t sphere) {
    float* at = scratch.at + 3 * kRows * sphere;
    if (scratch.stamp[sphere] == scratch.stamped) return at;
    float* T = scratch.T + 12 * kRows * static_cast<std::size_t>(scene.joint[body]);
    const float* c = scene.center + 3 * sphere;
    for (std::size_t i = 0; i < 3; ++i) {
      lanes(number(at, i)) = lanes(number(T, 4 * i)) * c[0] + lanes(number(T, 4 * i + 1)) * c[1] +
                             lanes(number(T, 4 * i + 2)) * c[2] + lanes(number(T, 4 * i + 3));
    }
    scratch.stamp[sphere] = scratch.stamped;
    return at;
  }

  // The square of a point's distance to an obstacle's core, at least, and where it is that, or lies within.
  Lanes squared(const SphereObstacle& o, Lanes x, Lanes y, Lanes z, Which& sure) const {
    if (o.kind == SphereObstacle::kHull) {
      Lanes above = all(-kInfinite);
      for (const float* p = o.plane; p != o.plane + 4 * o.planes; p += 4) {
        const Lanes d = p[0] * x + p[1] * y + p[2] * z - p[3];
        above = d > above ? d : above;
      }
      sure = above < -scene.pad;
      above = positive(above);
      return above * above;
    }
    sure = Which{} - 1;
    x -= o.t[0];
    y -= o.t[1];
    z -= o.t[2];
    if (o.kind == SphereObstacle::kBall) return x * x + y * y + z * z;
    if (o.kind != SphereObstacle::kUpright) {
      const Lanes u = o.R[0] * x + o.R[3] * y + o.R[6] * z, v = o.R[1] * x + o.R[4] * y + o.R[7] * z;
      z = o.R[2] * x + o.R[5] * y + o.R[8] * z;
      x = u;
      y = v;
    }
    z = positive(size(z) - o.half[2]);
    if (o.kind == SphereObstacle::kRod) return x * x + y * y + z * z;
    if (o.kind == SphereObstacle::kCan) {
      x = positive(root(x * x + y * y) - o.half[0]);
      return x * x + z * z;
    }
    x = positive(size(x) - o.half[0]);
    y = positive(size(y) - o.half[1]);
    return x * x + y * y + z * z;
  }

  // Obstacles whose boxes come within reach of some lane's point; how many there are.
  std::size_t gather(float* at, Lanes reach, unsigned left) const {
    float low[3], high[3];
    for (std::size_t i = 0; i < 3; ++i) {
      const float* x = number(at, i);
      low[i] = kInfinite;
      high[i] = -kInfinite;
      for (int k = 0; k < kWidth; ++k) {
        if (!(left >> k & 1)) continue;
        low[i] = least(low[i], x[k] - reach[k]);
        high[i] = most(high[i], x[k] + reach[k]);
      }
    }
    const auto apart = [&](const float* l, const float* h) {
      return l[0] > high[0] || h[0] < low[0] || l[1] > high[1] || h[1] < low[1] || l[2] > high[2] || h[2] < low[2];
    };
    std::size_t count = 0;
    for (std::size_t k = 0; k < scene.branches;) {
      const SphereBranch& branch = scene.branch[k];
      if (apart(branch.low, branch.high)) {
        k = branch.next;
        continue;
      }
      for (std::uint32_t o = branch.first; o < branch.first + branch.count; ++o) {
        if (!apart(scene.obstacle[o].low, scene.obstacle[o].high)) scratch.near[count++] = o;
      }
      ++k;
    }
    return count;
  }

  // What a sphere leaves open of what is pending, and below it.
  void descend(std::size_t body, std::size_t sphere, const SphereScratch::Pending* from, std::size_t count,
               SphereScratch::Pending* next) {
    float* at = posed(body, sphere);
    const Lanes x = lanes(number(at, 0)), y = lanes(number(at, 1)), z = lanes(number(at, 2));
    const Lanes outer = scene.outer[sphere] + scene.margin + scene.pad + growth(scene.grown, body);
    const float inner = scene.inner[sphere] + scene.margin - scene.pad;
    const bool leaf = scene.next[sphere] == sphere + 1,
               solid = scene.inner[sphere] > scene.pad && scene.grown == nullptr;
    std::size_t left = 0;
    for (std::size_t k = 0; k < count; ++k) {
      const std::uint32_t which = from[k].which;
      unsigned some = from[k].rows & ~hit & ~scratch.opened[which];
      if (some == 0) continue;
      const SphereObstacle& obstacle = scene.obstacle[scratch.near[which]];
      Which sure;
      const Lanes d2 = squared(obstacle, x, y, z, sure);
      const Lanes reach = outer + obstacle.swept;
      const float touch = inner + obstacle.swept;
      some &= ~bits(d2 > reach * reach);
      if (some == 0) continue;
      if (solid && touch > 0.0f) {
        hit |= some & bits((d2 < touch * touch) & sure);
        if (over()) return;
        some &= ~hit;
      }
      if (leaf) scratch.opened[which] |= some;
      if (!leaf && some != 0) next[left++] = {which, some};
    }
    if (left == 0) return;
    for (std::size_t k = sphere + 1; k < scene.next[sphere]; k = scene.next[k]) {
      descend(body, k, next, left, next + left);
      if (over()) return;
    }
  }

  void against_obstacles(std::size_t body) {
    const std::size_t root = scene.first[body];
    const unsigned left = rows & ~hit;
    const Lanes reach = scene.outer[root] + scene.margin + scene.pad + growth(scene.grown, body);
    const std::size_t count = gather(posed(body, root), reach, left);
    if (count == 0) return;
    for (std::size_t k = 0; k < count; ++k) {
      scratch.opened[k] = 0;
      scratch.pending[k] = {static_cast<std::uint32_t>(k), left};
    }
    descend(body, root, scratch.pending, count, scratch.pending + count);
    for (std::size_t k = 0; k < count && !over(); ++k) {
      note(scratch.opened[k], 0, static_cast<std::uint32_t>(body), scene.obstacle[scratch.near[k]].part);
    }
  }

  void against_itself(std::size_t a, std::size_t i, std::size_t b, std::size_t j, const Lanes& grown, unsigned some,
                      unsigned& undecided) {
    some &= ~hit & ~undecided;
    if (some == 0) return;
    float *at = posed(a, i), *to = posed(b, j);
    const Lanes x = lanes(number(at, 0)) - lanes(number(to, 0)), y = lanes(number(at, 1)) - lanes(number(to, 1)),
                z = lanes(number(at, 2)) - lanes(number(to, 2)), d2 = x * x + y * y + z * z;
    const Lanes reach = scene.outer[i] + scene.outer[j] + scene.self_margin + scene.pad + grown;
    const float touch = scene.inner[i] + scene.inner[j] + scene.self_margin - scene.pad;
    some &= ~bits(d2 > reach * reach);
    if (some == 0) return;
    if (scene.pair_grown == nullptr && scene.inner[i] > scene.pad && scene.inner[j] > scene.pad) {
      hit |= some & bits(d2 < touch * touch);
      if (over()) return;
      some &= ~hit;
    }
    const bool leaf_i = scene.next[i] == i + 1, leaf_j = scene.next[j] == j + 1;
    if (leaf_i && leaf_j) {
      undecided |= some;
    } else if (leaf_j || (!leaf_i && scene.outer[i] >= scene.outer[j])) {
      for (std::size_t k = i + 1; k < scene.next[i] && !over(); k = scene.next[k]) {
        against_itself(a, k, b, j, grown, some, undecided);
      }
    } else {
      for (std::size_t k = j + 1; k < scene.next[j] && !over(); k = scene.next[k]) {
        against_itself(a, i, b, k, grown, some, undecided);
      }
    }
  }

  void note(unsigned some, std::uint32_t self, std::uint32_t body, std::uint32_t other) {
    for (std::uint32_t k = 0; k < kWidth; ++k) {
      if ((some >> k & 1) && opened < most_open)
        open[opened] = {k + static_cast<std::uint32_t>(begin), self, body, other};
      opened += some >> k & 1;
    }
  }

  static void to_front(std::uint32_t* order, std::size_t at) {
    const std::uint32_t moved = order[at];
    for (; at > 0; --at) order[at] = order[at - 1];
    order[0] = moved;
  }

  void run() {
    ++scratch.stamped;
    place();
    for (std::size_t k = 0; k < scene.bodies && !over(); ++k) {
      const unsigned before = hit;
      against_obstacles(scene.body_order[k]);
      if (hit != before) to_front(scene.body_order, k);
    }
    for (std::size_t k = 0; k < scene.pairs && !over(); ++k) {
      const unsigned before = hit;
      const std::uint32_t which = scene.pair_order[k];
      const std::size_t a = scene.pair[2 * which], b = scene.pair[2 * which + 1];
      unsigned undecided = 0;
      against_itself(a, scene.first[a], b, scene.first[b], growth(scene.pair_grown, which), rows, undecided);
      if (!over()) note(undecided, 1, which, 0);
      if (hit != before) to_front(scene.pair_order, k);
    }
  }
};

}  // namespace

unsigned STRIPS_LOOK(const SphereScene& scene, SphereScratch& scratch, unsigned rows, bool first, SphereOpen* open,
                     std::size_t most_open, std::size_t& opened) {
  unsigned hit = 0;
  opened = 0;
  for (int begin = 0; begin < kRows; begin += kWidth) {
    const unsigned some = rows >> begin & ((1u << kWidth) - 1u);
    if (some == 0) continue;
    Look look{scene, scratch, begin, first, some, 0, open, most_open, opened};
    look.run();
    hit |= look.hit << begin;
    if (first && hit != 0) break;
  }
  return hit;
}

}  // namespace strips
