#include "holes.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace strips {

namespace {

// Holes of an image in half pixels: points lie on its pixels and midway between them, and around it nothing is lost.
class Holes {
 public:
  Holes(const float* ranges, int rows, int columns, int widest)
      : rows_(2 * rows + 3), columns_(2 * columns + 3), too_wide_(widest * widest + 1), least_(at(rows_, 0), 0) {
    std::vector<std::uint8_t> lost(least_.size(), 0);  // whether every pixel about a point is
    for (int r = 0; r < rows; ++r) {
      for (int c = 0; c < columns; ++c) lost[pixel(r, c)] = std::isnan(ranges[r * columns + c]);
    }
    const std::vector<int> up = along(lost);
    for (int r = 0; r < rows_; r += 2) {  // first between the pixels of a row, then between rows
      for (int c = 1; c < columns_; c += 2) lost[at(r, c)] = lost[at(r, c - 1)] && lost[at(r, c + 1)];
    }
    for (int r = 1; r < rows_; r += 2) {
      for (int c = 0; c < columns_; ++c) lost[at(r, c)] = lost[at(r - 1, c)] && lost[at(r + 1, c)];
    }
    for (int r = 0; r < rows_; ++r) {
      for (int c = 0; c < columns_; ++c) {
        if (lost[at(r, c)]) least_[at(r, c)] = nearest(up, r, c);
      }
    }
  }

  // Squares of the width, in pixels, of the widest disc without an answer about each pixel; `too_wide` where it may be
  // any.
  std::vector<int> widths() const {
    std::vector<int> found = least_;
    for (int r = 1; r + 1 < rows_; ++r) {
      for (int c = 1; c + 1 < columns_; ++c) {
        if (least_[at(r, c)] > kOne && !is_within_another(r, c)) spread(r, c, found);
      }
    }
    return found;
  }

  std::size_t pixel(int row, int column) const { return at(2 * row + 2, 2 * column + 2); }
  int too_wide() const { return too_wide_; }

 private:
  static constexpr int kOne = 4;  // of a pixel alone

  std::size_t at(int r, int c) const {
    return static_cast<std::size_t>(r) * static_cast<std::size_t>(columns_) + static_cast<std::size_t>(c);
  }

  // How far it is along its column, from each point in a column of pixels, to one that is not lost.
  std::vector<int> along(const std::vector<std::uint8_t>& lost) const {
    std::vector<int> up(lost.size(), 0);
    for (int c = 0; c < columns_; c += 2) {
      for (int r = 1; r < rows_; ++r) up[at(r, c)] = r % 2 == 0 && !lost[at(r, c)] ? 0 : up[at(r - 1, c)] + 1;
      for (int r = rows_ - 2; r >= 0; --r) up[at(r, c)] = std::min(up[at(r, c)], up[at(r + 1, c)] + 1);
    }
    return up;
  }

  // The square of how far it is to the nearest pixel that is not lost.
  int nearest(const std::vector<int>& up, int r, int c) const {
    int best = too_wide_;
    for (int off = c % 2; off * off < best; off += 2) {
      for (const int other : {c - off, c + off}) {
        if (other < 0 || other >= columns_) continue;
        const int square = off * off + up[at(r, other)] * up[at(r, other)];
        best = std::min(best, square);
      }
    }
    return best;
  }

  // Whether a neighbour's disc counts wherever that about a point does.
  bool is_within_another(int r, int c) const {
    const int mine = least_[at(r, c)];
    bool inside = mine == too_wide_;
    for (int dr = -1; dr <= 1; ++dr) {
      for (int dc = -1; dc <= 1; ++dc) {
        if (dr == 0 && dc == 0) continue;
        const int other = least_[at(r + dr, c + dc)];
        inside = inside && other == too_wide_;
        const double further = std::sqrt(2.0) * (std::sqrt(other) - std::sqrt(mine));
        if (further > std::hypot(dr, dc) * (1.0 + 1e-9)) return true;
      }
    }
    return inside;
  }

  // A disc counts for the pixels up to the corners of the square about it.
  void spread(int r, int c, std::vector<int>& found) const {
    const int width = least_[at(r, c)], far = static_cast<int>(std::sqrt(2.0 * width)) + 1;
    for (int y = std::max(r - far, 2) / 2 * 2; y <= std::min(r + far, rows_ - 3); y += 2) {
      for (int x = std::max(c - far, 2) / 2 * 2; x <= std::min(c + far, columns_ - 3); x += 2) {
        int& one = found[at(y, x)];
        if (one > 0 && one < width && (y - r) * (y - r) + (x - c) * (x - c) <= 2 * width) one = width;
      }
    }
  }

  int rows_, columns_, too_wide_;
  std::vector<int> least_;
};

}  // namespace

void fill_holes(const float* ranges, std::size_t rows, std::size_t columns, double unit, int widest, float* out) {
  constexpr int lines[4][2] = {{0, 1}, {1, 0}, {1, 1}, {1, -1}};
  const auto h = static_cast<std::int64_t>(rows), w = static_cast<std::int64_t>(columns);
  // How many steps it is from a pixel to the first that is not lost, and its range; 0 where that is none of the next.
  const auto border = [&](std::int64_t r, std::int64_t c, const int* line, int sign, float& range) {
    for (int k = 1; k <= widest; ++k) {
      r += sign * line[0];
      c += sign * line[1];
      if (r < 0 || r >= h || c < 0 || c >= w) return 0;
      range = ranges[r * w + c];
      if (!std::isnan(range)) return k;
    }
    return 0;
  };
  std::copy(ranges, ranges + rows * columns, out);
  if (std::none_of(ranges, ranges + rows * columns, [](float range) { return std::isnan(range); })) return;
  const Holes holes(ranges, static_cast<int>(h), static_cast<int>(w), widest);
  const std::vector<int> widths = holes.widths();
  for (std::int64_t r = 0; r < h; ++r) {
    for (std::int64_t c = 0; c < w; ++c) {
      const int width = widths[holes.pixel(static_cast<int>(r), static_cast<int>(c))];
      if (width == 0 || width == holes.too_wide()) continue;
      double shortest = std::numeric_limits<double>::infinity();
      float value = std::numeric_limits<float>::quiet_NaN();
      for (const auto& line : lines) {
        float near = 0.0f, far = 0.0f;
        const int before = border(r, c, line, 1, near), after = before == 0 ? 0 : border(r, c, line, -1, far);
        const double run = (before + after) * std::hypot(line[0], line[1]);
        if (after == 0 || before + after > widest || run >= shortest) continue;
        shortest = run;
        value = std::min(near, far);
      }
      const double seen = std::min(static_cast<double>(value), unit / std::sqrt(width));
      if (!std::isnan(value)) out[r * w + c] = static_cast<float>(seen);
    }
  }
}

}  // namespace strips
