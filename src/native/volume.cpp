#include "volume.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace strips {

namespace {

constexpr float kFarthest = 1e4f;  // [m] that an image may see
constexpr int kEdge = VolumeMap::EDGE;
const double kHalfDiagonal = 0.5 * std::sqrt(3.0);

// The least and the largest of any rectangle of pixels, at most four of which it takes to cover: of halves of halves.
class Pyramid {
 public:
  Pyramid(const float* image, std::size_t rows, std::size_t columns) {
    std::vector<float> known(image, image + rows * columns);
    for (float& x : known) x = x > 0.0f && x < kFarthest ? x : 0.0f;  // what is no number, too
    levels_.push_back({rows, columns, known, known});
    while (rows > 1 || columns > 1) {
      const Level& fine = levels_.back();
      Level next{(rows + 1) / 2, (columns + 1) / 2, {}, {}};
      next.least.resize(next.rows * next.columns);
      next.most.resize(next.rows * next.columns);
      for (std::size_t r = 0; r < next.rows; ++r) {
        for (std::size_t c = 0; c < next.columns; ++c) {
          const std::size_t r2 = std::min(2 * r + 1, rows - 1), c2 = std::min(2 * c + 1, columns - 1);
          const std::size_t a = 2 * r * columns + 2 * c, b = 2 * r * columns + c2;
          const std::size_t d = r2 * columns + 2 * c, e = r2 * columns + c2;
          const std::size_t at = r * next.columns + c;
          const auto& l = fine.least;
          const auto& m = fine.most;
          next.least[at] = std::min(std::min(l[a], l[b]), std::min(l[d], l[e]));
          next.most[at] = std::max(std::max(m[a], m[b]), std::max(m[d], m[e]));
        }
      }
      rows = next.rows;
      columns = next.columns;
      levels_.push_back(std::move(next));
    }
  }

  float of(std::size_t row, std::size_t column) const { return levels_[0].least[row * levels_[0].columns + column]; }

  // Of rows r0 to r1 and columns c0 to c1, both of them included.
  template <bool least>
  float of(std::size_t r0, std::size_t r1, std::size_t c0, std::size_t c1) const {
    std::size_t k = 0;
    while ((r1 >> k) - (r0 >> k) > 1 || (c1 >> k) - (c0 >> k) > 1) ++k;
    const Level& level = levels_[k];
    const std::vector<float>& x = least ? level.least : level.most;
    const std::size_t top = (r0 >> k) * level.columns, bottom = (r1 >> k) * level.columns, left = c0 >> k,
                      right = c1 >> k;
    const float a = x[top + left], b = x[top + right], c = x[bottom + left], d = x[bottom + right];
    return least ? std::min(std::min(a, b), std::min(c, d)) : std::max(std::max(a, b), std::max(c, d));
  }

 private:
  struct Level {
    std::size_t rows, columns;
    std::vector<float> least, most;
  };
  std::vector<Level> levels_;
};

// As std::floor does, which is a call where the processor's own instruction may not be there.
inline double floored(double x) {
  if (!(std::abs(x) < 1e15)) return std::floor(x);
  const double whole = static_cast<double>(static_cast<std::int64_t>(x));
  return whole > x ? whole - 1.0 : whole;
}

// How far a ball is by an image's measure; its middle is so far from a range finder, and so far from its axis.
struct Ball {
  double near, far, distance, flat;
  bool known;  // else it is too near, or about the axis, to say which pixels it covers
};

inline Ball ball_at(const Optics& optics, const double* c, double radius) {
  Ball ball;
  ball.flat = optics.camera ? c[2] : std::hypot(c[0], c[1]);
  ball.distance = optics.camera ? c[2] : std::hypot(ball.flat, c[2]);
  ball.near = ball.distance - radius;
  ball.far = ball.distance + radius;
  ball.known = ball.flat > radius;
  return ball;
}

// The column and the row of its middle.
inline void project(const Optics& optics, const double* c, const Ball& ball, double* at) {
  const double x = optics.camera ? c[0] / c[2] : std::atan2(c[1], c[0]);
  const double y = optics.camera ? c[1] / c[2] : std::atan2(c[2], ball.flat);
  at[0] = optics.middle[0] + optics.scale[0] * x;
  at[1] = optics.middle[1] + optics.scale[1] * y;
}

// The first and the last pixels that a ball covers, not yet cut to the image.
struct Cover {
  double rows[2], columns[2];
};

inline Cover cover(const Optics& optics, const double* c, double radius, const Ball& ball) {
  Cover result;
  if (optics.camera) {
    const double below = c[2] * c[2] - radius * radius;
    for (int k = 0; k < 2; ++k) {  // tangents to the ball in the plane of z and x, or of z and y
      const double root = radius * std::sqrt(c[k] * c[k] + below);
      double* pixels = k == 0 ? result.columns : result.rows;
      pixels[0] = optics.middle[k] + optics.scale[k] * ((c[k] * c[2] - root) / below);
      pixels[1] = optics.middle[k] + optics.scale[k] * ((c[k] * c[2] + root) / below);
    }
    return result;
  }
  const double wide = std::asin(radius / ball.flat), high = std::asin(radius / ball.distance);
  double middle[2];
  project(optics, c, ball, middle);
  for (int k = 0; k < 2; ++k) {
    const double half = std::abs(optics.scale[k]) * (k == 0 ? wide : high);
    double* pixels = k == 0 ? result.columns : result.rows;
    pixels[0] = middle[k] - half;
    pixels[1] = middle[k] + half;
  }
  return result;
}

// To where the pixel over a ball's middle surely sees; 0 beside the image.
inline float middle_sees(const Pyramid& pyramid, const Optics& optics, const double* c, const Ball& ball) {
  double at[2];
  project(optics, c, ball, at);
  double column = floored(at[0] + 0.5);
  const double row = floored(at[1] + 0.5), columns = static_cast<double>(optics.columns);
  if (optics.round) column -= columns * floored(column / columns);
  if (!(row >= 0.0 && row < static_cast<double>(optics.rows) && column >= 0.0 && column < columns)) return 0.0f;
  return pyramid.of(static_cast<std::size_t>(row), static_cast<std::size_t>(column));
}

// What the pixels over a ball say: the least that they surely see, and, where both are asked for, the most; nothing of
// pixels beside the image.
struct Seen {
  float least, most;
};

template <bool both>
inline Seen seen(const Pyramid& pyramid, const Optics& optics, const Cover& ball) {
  constexpr float kNone = 0.0f;
  const auto last = [](std::size_t n) { return static_cast<double>(n - 1); };
  double r0 = floored(ball.rows[0] + 0.5), r1 = floored(ball.rows[1] + 0.5);
  double c0 = floored(ball.columns[0] + 0.5), c1 = floored(ball.columns[1] + 0.5);
  bool whole = r0 >= 0.0 && r1 <= last(optics.rows);
  r0 = std::max(r0, 0.0);
  r1 = std::min(r1, last(optics.rows));
  if (r0 > r1) return {kNone, kNone};
  const auto of = [&](double from, double to, Seen& all) {
    const auto a = static_cast<std::size_t>(r0), b = static_cast<std::size_t>(r1);
    const auto c = static_cast<std::size_t>(from), d = static_cast<std::size_t>(to);
    all.least = std::min(all.least, pyramid.of<true>(a, b, c, d));
    if (both) all.most = std::max(all.most, pyramid.of<false>(a, b, c, d));
  };
  Seen all{std::numeric_limits<float>::infinity(), kNone};
  if (optics.round) {
    const double n = static_cast<double>(optics.columns);
    if (c1 - c0 >= n - 1.0) {
      of(0.0, n - 1.0, all);
    } else {
      const double shift = n * floored(c0 / n);
      c0 -= shift;
      c1 -= shift;
      of(c0, std::min(c1, n - 1.0), all);
      if (c1 > n - 1.0) of(0.0, c1 - n, all);
    }
  } else {
    whole = whole && c0 >= 0.0 && c1 <= last(optics.columns);
    c0 = std::max(c0, 0.0);
    c1 = std::min(c1, last(optics.columns));
    if (c0 > c1) return {kNone, kNone};
    of(c0, c1, all);
  }
  if (!whole) all.least = kNone;
  return all;
}

std::int64_t floor_divided(std::int64_t a, std::int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }
std::int64_t modulo(std::int64_t a, std::int64_t b) { return a - b * floor_divided(a, b); }

}  // namespace

VolumeMap::VolumeMap(const std::int64_t* blocks, const std::int64_t* corner, double cell, const Evidence& evidence)
    : cell_(cell), evidence_(evidence) {
  std::copy(blocks, blocks + 3, blocks_.begin());
  std::copy(corner, corner + 3, corner_.begin());
  const std::size_t count = static_cast<std::size_t>(blocks_[0] * blocks_[1] * blocks_[2]);
  known_.assign(count * VOLUME, UNSEEN);
  floors_.assign(count, 0);
  passed_.assign(count, 0);
  filled_.assign(count, Bits{});
  sure_.assign(count, Bits{});
  hit_.assign(count, Bits{});
  changed_.among.assign(count, 0);
  cleared_.among.assign(count, 0);
}

bool VolumeMap::inside(const Block& block) const {
  for (int k = 0; k < 3; ++k) {
    if (block[k] < corner_[k] || block[k] >= corner_[k] + blocks_[k]) return false;
  }
  return true;
}

// Blocks stay where they are in memory while the window goes on, as on a ring along each axis.
std::size_t VolumeMap::slot(const Block& block) const {
  std::int64_t at = 0;
  for (int k = 0; k < 3; ++k) at = at * blocks_[k] + modulo(block[k], blocks_[k]);
  return static_cast<std::size_t>(at);
}

VolumeMap::Block VolumeMap::block_of(std::size_t at) const {
  Block block;
  std::int64_t rest = static_cast<std::int64_t>(at);
  for (int k = 2; k >= 0; --k) {
    const std::int64_t place = rest % blocks_[k];
    rest /= blocks_[k];
    block[k] = corner_[k] + modulo(place - corner_[k], blocks_[k]);
  }
  return block;
}

bool VolumeMap::locate(const double* point, std::size_t& at, int& voxel) const {
  Block block;
  voxel = 0;
  for (int k = 0; k < 3; ++k) {
    const double number = std::floor(point[k] / cell_);
    if (!(std::abs(number) < 1e15)) return false;
    const auto whole = static_cast<std::int64_t>(number);
    block[k] = floor_divided(whole, kEdge);
    voxel = kEdge * voxel + static_cast<int>(whole - kEdge * block[k]);
  }
  if (!inside(block)) return false;
  at = slot(block);
  return true;
}

void VolumeMap::note(Noted& noted, std::size_t at) {
  if (noted.among[at]) return;
  noted.among[at] = 1;
  noted.blocks.push_back(block_of(at));
}

void VolumeMap::put(std::size_t at, int voxel, int known, bool neither) {
  std::int8_t& now = known_[at * VOLUME + static_cast<std::size_t>(voxel)];
  floors_[at] += (known == evidence_.floor) - (now == evidence_.floor);
  passed_[at] += (known == PASSED) - (now == PASSED);
  now = static_cast<std::int8_t>(known);
  std::uint64_t& word = filled_[at][static_cast<std::size_t>(voxel / 64)];
  std::uint64_t& sure = sure_[at][static_cast<std::size_t>(voxel / 64)];
  const std::uint64_t bit = std::uint64_t{1} << (voxel % 64);
  const bool was = (word & bit) != 0;
  const bool is = !neither && known > PASSED && (was ? known >= evidence_.emptied : known > evidence_.filled);
  if (((sure & bit) != 0) != (is || (known > PASSED && known <= 0))) {
    sure ^= bit;
    note(cleared_, at);
  }
  if (was == is) return;
  word ^= bit;
  note(changed_, at);
}

void VolumeMap::pass(std::size_t at, int voxel, bool sure) {
  if (hit_[at][static_cast<std::size_t>(voxel / 64)] >> (voxel % 64) & 1) return;
  const int now = known_[at * VOLUME + static_cast<std::size_t>(voxel)];
  if (now == evidence_.floor || (now == PASSED && !sure)) return;
  if (now == UNSEEN && !sure) return put(at, voxel, PASSED);
  const int next = std::max((now <= PASSED ? 0 : now) - evidence_.miss, evidence_.floor);
  put(at, voxel, !sure && now >= evidence_.emptied && next < evidence_.emptied ? UNSEEN : next);
}

void VolumeMap::roll(const std::int64_t* corner) {
  Block next;
  std::copy(corner, corner + 3, next.begin());
  if (next == corner_) return;
  for (std::size_t at = 0; at < filled_.size(); ++at) {
    const Block block = block_of(at);
    bool stays = true;
    for (int k = 0; k < 3; ++k) stays = stays && block[k] >= next[k] && block[k] < next[k] + blocks_[k];
    if (stays) continue;
    const bool full = std::any_of(filled_[at].begin(), filled_[at].end(), [](std::uint64_t word) { return word != 0; });
    if (full) note(changed_, at);
    std::fill_n(known_.begin() + static_cast<std::ptrdiff_t>(at * VOLUME), VOLUME, UNSEEN);
    filled_[at] = sure_[at] = hit_[at] = Bits{};
    floors_[at] = passed_[at] = 0;
    changed_.among[at] = cleared_.among[at] = 0;  // what comes into this place is another block
  }
  corner_ = next;
}

void VolumeMap::hit(const double* points, const std::int8_t* weight, std::size_t count, std::int8_t* before) {
  for (std::size_t at : touched_) hit_[at] = Bits{};
  touched_.clear();
  look(points, count, before);
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t at;
    int voxel;
    if (weight[i] <= 0 || !locate(points + 3 * i, at, voxel)) continue;
    std::uint64_t& word = hit_[at][static_cast<std::size_t>(voxel / 64)];
    const std::uint64_t bit = std::uint64_t{1} << (voxel % 64);
    const int was = before[i] <= PASSED ? 0 : std::max<int>(before[i], 0);
    const int now = std::min(was + weight[i], evidence_.top);
    if (word & bit) {  // by several pixels: the most counts
      if (now > known_[at * VOLUME + static_cast<std::size_t>(voxel)]) put(at, voxel, now);
      continue;
    }
    word |= bit;
    touched_.push_back(at);
    put(at, voxel, now);
  }
}

void VolumeMap::carve(const Sight& sight) {
  const Optics& optics = sight.optics;
  const Pyramid pyramid(sight.clear, optics.rows, optics.columns);
  const double farthest = pyramid.of<false>(0, optics.rows - 1, 0, optics.columns - 1);
  if (!(farthest > sight.nearest)) return;
  const double *R = sight.rotation, *o = sight.origin;
  const double edge = kEdge * cell_, small = kHalfDiagonal * cell_;
  // Of a camera's depth the corners of its image are further away than what it is deep.
  double reach = farthest;
  if (optics.camera) {
    double slopes = 1.0;
    for (int k = 0; k < 2; ++k) {
      const double size = static_cast<double>(k == 0 ? optics.columns : optics.rows);
      const double wide = std::max(optics.middle[k] + 0.5, size - 0.5 - optics.middle[k]) / optics.scale[k];
      slopes += wide * wide;
    }
    reach *= std::sqrt(slopes);
  }
  Block low, high;
  for (int k = 0; k < 3; ++k) {
    low[k] = std::max(corner_[k], static_cast<std::int64_t>(std::floor((o[k] - reach) / edge)));
    high[k] = std::min(corner_[k] + blocks_[k] - 1, static_cast<std::int64_t>(std::floor((o[k] + reach) / edge)));
  }
  // From the middle of a cube to those of its eight halves, for the halves of one, two and four voxels, as the sensor
  // has it.
  double steps[3][8][3];
  for (int level = 0; level < 3; ++level) {
    for (int part = 0; part < 8; ++part) {
      const double off = 0.5 * (1 << level) * cell_;
      const double x[3] = {part & 4 ? off : -off, part & 2 ? off : -off, part & 1 ? off : -off};
      for (int k = 0; k < 3; ++k) steps[level][part][k] = R[k] * x[0] + R[3 + k] * x[1] + R[6 + k] * x[2];
    }
  }
  // A voxel of a block, with its middle.
  const auto look = [&](std::size_t at, int voxel, const double* c) {
    const std::int8_t now = known_[at * VOLUME + static_cast<std::size_t>(voxel)];
    const Ball one = ball_at(optics, c, small);
    if (!one.known || one.near < sight.nearest || one.far >= farthest) return;
    if (now == evidence_.floor || (now == PASSED && one.far > sight.sure)) return;
    if (middle_sees(pyramid, optics, c, one) <= one.near) return;  // as of most: nothing comes of it
    const float least = seen<false>(pyramid, optics, cover(optics, c, small, one)).least;
    if (least > one.far) {
      pass(at, voxel, one.far <= sight.sure);
      return;
    }
    if (least > 0.5 * (one.near + one.far) && one.far <= sight.sure) grant(at, voxel);
    if (least > one.near && one.far <= sight.exact) fade(at, voxel);
  };
  // A cube of a block, 2 to the power of `level` voxels wide, from voxel `first` on: as a whole where one answer does
  // for all.
  const auto within = [&](const auto& self, std::size_t at, const int* first, int level, const double* c) -> void {
    const int wide = 1 << level, half = wide / 2;
    const Ball all = ball_at(optics, c, wide * small);
    if (all.near > farthest || all.far < sight.nearest) return;
    const bool beyond = all.near > sight.sure;
    if (settled(at, first, wide, beyond)) return;
    if (all.known) {
      const Seen pixels = seen<true>(pyramid, optics, cover(optics, c, wide * small, all));
      if (pixels.most < all.near) return;
      if (all.near >= sight.nearest && pixels.least > all.far && (beyond || all.far <= sight.sure)) {
        for (int x = first[0]; x < first[0] + wide; ++x) {
          for (int y = first[1]; y < first[1] + wide; ++y) {
            for (int z = first[2]; z < first[2] + wide; ++z) pass(at, 64 * x + 8 * y + z, !beyond);
          }
        }
        return;
      }
    }
    for (int part = 0; part < 8; ++part) {
      const double* step = steps[level - 1][part];
      const double middle[3] = {c[0] + step[0], c[1] + step[1], c[2] + step[2]};
      const int x = first[0] + (part & 4 ? half : 0), y = first[1] + (part & 2 ? half : 0),
                z = first[2] + (part & 1 ? half : 0);
      if (level == 1) {
        look(at, 64 * x + 8 * y + z, middle);
      } else {
        const int place[3] = {x, y, z};
        self(self, at, place, level - 1, middle);
      }
    }
  };
  Block block;
  const int corner[3] = {0, 0, 0};
  for (block[0] = low[0]; block[0] <= high[0]; ++block[0]) {
    for (block[1] = low[1]; block[1] <= high[1]; ++block[1]) {
      for (block[2] = low[2]; block[2] <= high[2]; ++block[2]) {
        const std::size_t at = slot(block);
        if (floors_[at] == VOLUME) continue;
        double x[3], c[3];
        for (int k = 0; k < 3; ++k) x[k] = (static_cast<double>(block[k]) + 0.5) * edge - o[k];
        for (int k = 0; k < 3; ++k) c[k] = R[k] * x[0] + R[3 + k] * x[1] + R[6 + k] * x[2];
        within(within, at, corner, 3, c);
      }
    }
  }
}

// Whether a look through a cube of voxels of a block says nothing new: they are as free as voxels can be, or have been
// passed, where it is too far away to be sure of anything.
bool VolumeMap::settled(std::size_t at, const int* first, int edge, bool far) const {
  if (edge == EDGE) return floors_[at] + (far ? passed_[at] : 0) == VOLUME;
  const std::int8_t* known = known_.data() + at * VOLUME;
  for (int x = first[0]; x < first[0] + edge; ++x) {
    for (int y = first[1]; y < first[1] + edge; ++y) {
      const std::int8_t* row = known + 64 * x + 8 * y + first[2];
      for (int z = 0; z < edge; ++z) {
        if (row[z] != evidence_.floor && !(far && row[z] == PASSED)) return false;
      }
    }
  }
  return true;
}

// What was hit, and is looked at from nearby with nothing before it, and is not hit, is less and less of an obstacle,
// and then neither.
void VolumeMap::fade(std::size_t at, int voxel) {
  const int now = known_[at * VOLUME + static_cast<std::size_t>(voxel)];
  if (now <= 0 || (hit_[at][static_cast<std::size_t>(voxel / 64)] >> (voxel % 64) & 1)) return;
  put(at, voxel, std::max(now - evidence_.miss, 0), now <= evidence_.miss);
}

void VolumeMap::grant(std::size_t at, int voxel) {
  if (known_[at * VOLUME + static_cast<std::size_t>(voxel)] <= PASSED) put(at, voxel, 0);
}

void VolumeMap::grant(const double* points, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t at;
    int voxel;
    if (locate(points + 3 * i, at, voxel)) grant(at, voxel);
  }
}

void VolumeMap::forget(const double* points, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t at;
    int voxel;
    if (locate(points + 3 * i, at, voxel)) put(at, voxel, UNSEEN);
  }
}

void VolumeMap::look(const double* points, std::size_t count, std::int8_t* known) const {
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t at;
    int voxel;
    known[i] = locate(points + 3 * i, at, voxel) ? known_[at * VOLUME + static_cast<std::size_t>(voxel)] : UNSEEN;
  }
}

std::vector<std::int64_t> VolumeMap::changed(bool doubtful) {
  std::vector<std::int64_t> all;
  Noted& noted = doubtful ? cleared_ : changed_;
  for (const Block& block : noted.blocks) {
    all.insert(all.end(), block.begin(), block.end());
    if (inside(block)) noted.among[slot(block)] = 0;
  }
  noted.blocks.clear();
  return all;
}

VolumeMap::Bits VolumeMap::listed(const Block& block, bool doubtful) const {
  if (!inside(block)) return Bits{};
  Bits bits = doubtful ? sure_[slot(block)] : filled_[slot(block)];
  if (doubtful) {
    for (std::uint64_t& word : bits) word = ~word;
  }
  return bits;
}

namespace {

// Voxels of a cube, `row` of x and y has those along z: runs along z, equal runs beside each other along y, and equal
// rectangles along x.
template <int edge, class Row>
std::vector<std::int64_t> merged(std::array<std::array<Row, edge>, edge>& left, const std::int64_t* first) {
  std::vector<std::int64_t> found;
  for (int x = 0; x < edge; ++x) {
    for (int y = 0; y < edge; ++y) {
      while (left[x][y] != 0) {
        const unsigned word = left[x][y];
        int z = 0;
        while (!(word >> z & 1)) ++z;
        int top = z + 1, wide = y + 1, deep = x + 1;
        while (top < edge && (word >> top & 1)) ++top;
        const auto run = static_cast<unsigned>(((std::uint64_t{1} << (top - z)) - 1) << z);
        const auto whole = [&](int i) {
          for (int k = y; k < wide; ++k) {
            if ((left[i][k] & run) != run) return false;
          }
          return true;
        };
        while (wide < edge && (left[x][wide] & run) == run) ++wide;
        while (deep < edge && whole(deep)) ++deep;
        for (int i = x; i < deep; ++i) {
          for (int k = y; k < wide; ++k) left[i][k] = static_cast<Row>(left[i][k] & ~run);
        }
        const int ends[6] = {x, y, z, deep, wide, top};
        for (int k = 0; k < 6; ++k) found.push_back(first[k % 3] + ends[k]);
      }
    }
  }
  return found;
}

}  // namespace

std::vector<std::int64_t> VolumeMap::boxes(const std::int64_t* at, bool doubtful) const {
  const Bits bits = listed({at[0], at[1], at[2]}, doubtful);
  std::array<std::array<std::uint8_t, kEdge>, kEdge> left;
  for (std::size_t x = 0; x < kEdge; ++x) {
    for (std::size_t y = 0; y < kEdge; ++y) left[x][y] = static_cast<std::uint8_t>(bits[x] >> (kEdge * y) & 0xff);
  }
  const std::int64_t first[3] = {kEdge * at[0], kEdge * at[1], kEdge * at[2]};
  return merged<kEdge, std::uint8_t>(left, first);
}

std::vector<std::int64_t> VolumeMap::boxes(const std::int64_t* at, bool doubtful, const VolumeMap& fine) const {
  const Bits bits = listed({at[0], at[1], at[2]}, doubtful);
  std::array<std::array<std::uint16_t, 2 * kEdge>, 2 * kEdge> left{};
  for (int x = 0; x < kEdge; ++x) {
    for (int y = 0; y < kEdge; ++y) {
      for (int z = 0; z < kEdge; ++z) {
        if (!(bits[static_cast<std::size_t>(x)] >> (kEdge * y + z) & 1)) continue;
        for (int k = 0; k < 4; ++k) left[2 * x + k / 2][2 * y + k % 2] |= static_cast<std::uint16_t>(3u << (2 * z));
      }
    }
  }
  for (int part = 0; part < 8; ++part) {
    const int shift[3] = {part / 4, part / 2 % 2, part % 2};
    Block block;
    for (int k = 0; k < 3; ++k) block[static_cast<std::size_t>(k)] = 2 * at[k] + shift[k];
    if (!fine.inside(block)) continue;
    const std::int8_t* known = fine.known_.data() + fine.slot(block) * VOLUME;
    for (int x = 0; x < kEdge; ++x) {
      for (int y = 0; y < kEdge; ++y) {
        std::uint16_t& row = left[kEdge * shift[0] + x][kEdge * shift[1] + y];
        if (row == 0) continue;
        for (int z = 0; z < kEdge; ++z) {
          const int now = known[64 * x + 8 * y + z];
          if (now > PASSED && now <= fine.evidence_.emptied) {
            row = static_cast<std::uint16_t>(row & ~(1u << (kEdge * shift[2] + z)));
          }
        }
      }
    }
  }
  const std::int64_t first[3] = {2 * kEdge * at[0], 2 * kEdge * at[1], 2 * kEdge * at[2]};
  return merged<2 * kEdge, std::uint16_t>(left, first);
}

std::size_t VolumeMap::count(bool unseen) const {
  if (unseen) {
    return static_cast<std::size_t>(
        std::count_if(known_.begin(), known_.end(), [](std::int8_t known) { return known <= PASSED; }));
  }
  std::size_t all = 0;
  for (const Bits& bits : filled_) {
    for (std::uint64_t word : bits) {
      for (; word != 0; word &= word - 1) ++all;
    }
  }
  return all;
}

std::size_t grid_boxes(const std::int64_t* low, const std::int64_t* high, std::size_t count, double cell, double* cells,
                       double* middles, double* edges, double* whole) {
  std::size_t n = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::int64_t *a = low + 3 * i, *b = high + 3 * i;
    n += static_cast<std::size_t>((b[0] - a[0]) * (b[1] - a[1]) * (b[2] - a[2]));
  }
  if (cells == nullptr) return n;
  double least[3], most[3];
  for (std::size_t i = 0; i < count; ++i) {
    const std::int64_t *a = low + 3 * i, *b = high + 3 * i;
    for (int k = 0; k < 3; ++k) {
      const double from = cell * static_cast<double>(a[k]), to = cell * static_cast<double>(b[k]);
      middles[3 * i + k] = 0.5 * (from + to);
      edges[3 * i + k] = std::nearbyint((to - from) * 1e12) / 1e12;
      least[k] = i == 0 ? from : std::min(least[k], from);
      most[k] = i == 0 ? to : std::max(most[k], to);
    }
    for (std::int64_t x = a[0]; x < b[0]; ++x) {
      for (std::int64_t y = a[1]; y < b[1]; ++y) {
        for (std::int64_t z = a[2]; z < b[2]; ++z) {
          *cells++ = (static_cast<double>(x) + 0.5) * cell;
          *cells++ = (static_cast<double>(y) + 0.5) * cell;
          *cells++ = (static_cast<double>(z) + 0.5) * cell;
        }
      }
    }
  }
  for (int k = 0; k < 3; ++k) {
    whole[k] = 0.5 * (least[k] + most[k]);
    whole[3 + k] = 0.5 * (most[k] - least[k]);
  }
  double far = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    double square = 0.0;
    for (int k = 0; k < 3; ++k) {
      const double off = std::abs(middles[3 * i + k] - whole[k]) + 0.5 * edges[3 * i + k];
      square += off * off;
    }
    far = std::max(far, square);
  }
  whole[6] = std::sqrt(far);
  return n;
}

}  // namespace strips
