#include "grid.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <stdexcept>
#include <utility>

#include "constants.hpp"

namespace strips {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kLargestCost = 1e100;  // of a cell: that of a path does not overflow
constexpr double kRounding = 1e-9;      // of a path's cost, relative
constexpr std::size_t kMoves = 2 * std::size(GRID_MOVES);

constexpr std::ptrdiff_t longest_move() {
  int longest = 0;
  for (const auto& move : GRID_MOVES) {
    for (int by : move) longest = std::max(longest, by < 0 ? -by : by);
  }
  return longest;
}
constexpr std::ptrdiff_t kLongest = longest_move();  // rows or columns that a move leads on at most

// To a cell so many rows and columns on, and so many cells in all; and half its length in cells.
struct Move {
  std::ptrdiff_t di, dj, by;
  double half;
};

// The least and the largest of costs that are finite; infinity and nothing where none is.
std::pair<double, double> range_of(const double* cost, std::size_t count) {
  constexpr std::size_t kSide = 8;  // side by side: one comparison after the other would take as long as a search
  double least[kSide], most[kSide] = {};
  std::fill_n(least, kSide, kInfinity);
  const auto take = [&](std::size_t at, double each) {
    least[at] = each < least[at] ? each : least[at];
    const double finite = each < kInfinity ? each : 0.0;
    most[at] = finite > most[at] ? finite : most[at];
  };
  std::size_t k = 0;
  for (; k + kSide <= count; k += kSide) {
    for (std::size_t i = 0; i < kSide; ++i) take(i, cost[k + i]);
  }
  for (; k < count; ++k) take(0, cost[k]);
  return {*std::min_element(least, least + kSide), *std::max_element(most, most + kSide)};
}

// A half plane of an outline: it bounds y by reach * factor - slope * x from above, from below, or x alone.
struct HalfPlane {
  double factor, slope;
  int side;
};

// The lower envelope of a parabola about each cell of a row: Felzenszwalb and Huttenlocher, Distance Transforms of
// Sampled Functions (2012).
struct Envelope {
  explicit Envelope(std::size_t size) : vertex(size), begin(size + 1), high(size), inverse(size) {
    for (std::size_t k = 1; k < size; ++k) inverse[k] = 0.5 / static_cast<double>(k);
  }

  // Squared distances (size) from squared distances within each column.
  void run(const double* squared, std::size_t size, double* out) {
    std::size_t top = 0;
    vertex[0] = 0;
    high[0] = squared[0];
    begin[0] = -kInfinity;
    for (std::size_t q = 1; q < size; ++q) {
      const double x = static_cast<double>(q), here = squared[q] + x * x;
      double from;
      while (true) {
        from = (here - high[top]) * inverse[q - vertex[top]];
        if (from > begin[top]) break;
        --top;
      }
      vertex[++top] = q;
      high[top] = here;
      begin[top] = from;
    }
    begin[top + 1] = kInfinity;
    std::size_t q = 0;
    for (std::size_t k = 0; k <= top; ++k) {
      for (const double v = static_cast<double>(vertex[k]); q < size && static_cast<double>(q) <= begin[k + 1]; ++q) {
        const double d = static_cast<double>(q) - v;
        out[q] = d * d + squared[vertex[k]];
      }
    }
  }

  std::vector<std::size_t> vertex;           // of the parabolas that are lowest somewhere
  std::vector<double> begin, high, inverse;  // where each is lowest from; its height at 0; halves of 1 / k
};

}  // namespace

void fill_outlines(const Outlines& o, const Cells& cells, std::int64_t* owner) {
  std::vector<HalfPlane> planes;
  for (std::size_t k = 0; k < o.directions; ++k) {
    const double nx = o.around[2 * k], ny = o.around[2 * k + 1];
    const int side = ny > UPRIGHT_NORMAL ? 1 : ny < -UPRIGHT_NORMAL ? -1 : 0;
    const double scale = side == 0 ? 1.0 : ny;
    planes.push_back({1.0 / scale, nx / scale, side});
  }
  const double edge = cells.resolution, rows = static_cast<double>(cells.rows);
  const double columns = static_cast<double>(cells.columns);
  std::vector<double> reach(o.directions);
  for (std::size_t n = 0; n < o.count; ++n) {
    for (std::size_t k = 0; k < o.directions; ++k) reach[k] = o.reach[n * o.directions + k] + 0.5 * edge;
    const std::size_t quarter = o.directions / 4;
    const double x0 = o.at[2 * n] - cells.low[0], y0 = o.at[2 * n + 1] - cells.low[1];
    const double left = std::max(std::ceil((x0 - reach[2 * quarter]) / edge), 0.0);
    const double right = std::min(std::floor((x0 + reach[0]) / edge), rows - 1.0);
    const double lower = std::max(std::ceil((y0 - reach[3 * quarter]) / edge), 0.0);
    const double upper = std::min(std::floor((y0 + reach[quarter]) / edge), columns - 1.0);
    if (!(left <= right && lower <= upper)) continue;
    const std::size_t last = static_cast<std::size_t>(right), top = static_cast<std::size_t>(upper);
    for (std::size_t i = static_cast<std::size_t>(left); i <= last; ++i) {
      const double x = edge * static_cast<double>(i) - x0;
      double above = kInfinity, below = -kInfinity, room = kInfinity;
      for (std::size_t k = 0; k < o.directions; ++k) {
        const double bound = reach[k] * planes[k].factor - planes[k].slope * x;
        double& nearest = planes[k].side > 0 ? above : planes[k].side < 0 ? below : room;
        nearest = planes[k].side < 0 ? std::max(nearest, bound) : std::min(nearest, bound);
      }
      if (!(room >= 0.0)) continue;
      for (std::size_t j = static_cast<std::size_t>(lower); j <= top; ++j) {
        const double y = edge * static_cast<double>(j) - y0;
        if (y >= below && y <= above) owner[i * cells.columns + j] = o.whose[n];
      }
    }
  }
}

void clearance_map(const bool* taken, std::size_t rows, std::size_t columns, double resolution, double* clear) {
  const std::size_t count = rows * columns;
  if (std::find(taken, taken + count, true) == taken + count) {
    std::fill_n(clear, count, kInfinity);
    return;
  }
  // Distances along each column, in cells, from both of its ends: a column without a taken cell is further away than
  // any cell of the grid can be.
  const double far = static_cast<double>(rows + columns);
  for (std::size_t k = 0; k < count; ++k) {
    const double before = k < columns ? far : std::min(clear[k - columns] + 1.0, far);
    clear[k] = taken[k] ? 0.0 : before;
  }
  for (std::size_t k = count - columns; k-- > 0;) clear[k] = std::min(clear[k], clear[k + columns] + 1.0);
  Envelope envelope(columns);
  std::vector<double> squared(columns);
  for (double* row = clear; row != clear + count; row += columns) {
    for (std::size_t j = 0; j < columns; ++j) squared[j] = row[j] * row[j];
    envelope.run(squared.data(), columns, row);
    for (std::size_t j = 0; j < columns; ++j) row[j] = resolution * std::sqrt(row[j]);
  }
}

void cell_cost(const double* clear, std::size_t count, double inner, double comfort, double narrow, double* cost) {
  for (std::size_t k = 0; k < count; ++k) {
    const double missing = 1.0 - std::min(std::max((clear[k] - inner) / comfort, 0.0), 1.0);
    const double each = 1.0 + (narrow - 1.0) * (missing * missing);
    cost[k] = clear[k] < inner ? kInfinity : each;
  }
}

// A*. What is left costs at least the way among cells of the least cost. The cells to look at wait in lists by what a
// path over them costs at least, a step of the least cost wide, in a ring: no move leads further than once around it.
// The one that waits longest comes first: what came last is seldom final, and what follows from it would be done again.
std::vector<std::int64_t> cheapest_route(const double* cost, std::size_t rows, std::size_t columns, std::size_t first,
                                         std::size_t last) {
  if (first == last) return {static_cast<std::int64_t>(first)};
  const std::size_t count = rows * columns;
  const std::pair<double, double> range = range_of(cost, count);
  const double least = range.first, most = range.second;
  if (least == kInfinity) return {};
  if (!(least > 1.0 / kLargestCost && most < kLargestCost && most <= kLargestRatio * least)) {
    throw std::invalid_argument("cells that cost nothing, too much, or too differently");
  }
  const std::ptrdiff_t height = static_cast<std::ptrdiff_t>(rows), width = static_cast<std::ptrdiff_t>(columns);
  const std::ptrdiff_t start = static_cast<std::ptrdiff_t>(first), goal = static_cast<std::ptrdiff_t>(last);
  Move moves[kMoves];
  double longest = 0.0;
  for (std::size_t k = 0; k < kMoves; ++k) {
    const int sign = k % 2 == 0 ? 1 : -1, di = sign * GRID_MOVES[k / 2][0], dj = sign * GRID_MOVES[k / 2][1];
    moves[k] = {di, dj, di * width + dj, 0.5 * std::sqrt(static_cast<double>(di * di + dj * dj))};
    longest = std::max(longest, 2.0 * moves[k].half);
  }
  const auto holds = [&](std::ptrdiff_t i, std::ptrdiff_t j) { return i >= 0 && j >= 0 && i < height && j < width; };
  const double straight = least * std::sqrt(5.0), diagonal = least * std::sqrt(2.0);
  const auto left = [&](std::ptrdiff_t i, std::ptrdiff_t j) {
    const double dx = static_cast<double>(std::abs(i - goal / width));
    const double dy = static_cast<double>(std::abs(j - goal % width));
    const double a = std::max(dx, dy), b = std::min(dx, dy);
    return a >= 2.0 * b ? b * straight + (a - 2.0 * b) * least : (a - b) * straight + (2.0 * b - a) * diagonal;
  };
  std::size_t turn = 1;
  while (static_cast<double>(turn) < longest * (most / least + 1.0) + 2.0) turn *= 2;
  std::vector<std::vector<std::uint32_t>> ring(turn);
  std::vector<double> total(count, kInfinity);
  std::vector<std::uint8_t> waits(count, 0);
  std::size_t waiting = 0;
  std::size_t step = static_cast<std::size_t>(left(start / width, start % width) / least);
  const auto reach = [&](std::ptrdiff_t cell, std::ptrdiff_t i, std::ptrdiff_t j, double now) {
    total[cell] = now;
    waits[cell] = 1;
    ++waiting;
    const std::size_t at = std::max(static_cast<std::size_t>((now + left(i, j)) / least), step);
    ring[at & (turn - 1)].push_back(static_cast<std::uint32_t>(cell));
  };
  reach(start, start / width, start % width, 0.0);
  for (; waiting > 0; ++step) {
    std::vector<std::uint32_t>& here = ring[step & (turn - 1)];
    for (std::size_t n = 0; n < here.size(); ++n) {
      const std::ptrdiff_t cell = here[n], i = cell / width, j = cell % width;
      if (!waits[cell]) continue;
      waits[cell] = 0;
      const bool inside = i >= kLongest && j >= kLongest && i + kLongest < height && j + kLongest < width;
      const double before = total[cell], own = cost[cell];
      for (const Move& move : moves) {
        if (!inside && !holds(i + move.di, j + move.dj)) continue;
        const double now = before + (own + cost[cell + move.by]) * move.half;
        if (now < total[cell + move.by]) reach(cell + move.by, i + move.di, j + move.dj, now);
      }
    }
    waiting -= here.size();
    here.clear();
    if (total[goal] * (1.0 + kRounding) < least * static_cast<double>(step + 1)) break;
  }
  if (total[goal] == kInfinity) return {};
  // Back from the goal, by the first of the moves that explain a cell's cost: the twin goes the same way.
  std::vector<std::int64_t> route{goal};
  while (route.back() != start) {
    const std::ptrdiff_t cell = route.back(), i = cell / width, j = cell % width;
    const auto explains = [&](const Move& move) {
      if (!holds(i + move.di, j + move.dj)) return false;
      return total[cell + move.by] + (cost[cell + move.by] + cost[cell]) * move.half == total[cell];
    };
    const Move* move = std::find_if(std::begin(moves), std::end(moves), explains);
    if (move == std::end(moves)) throw std::logic_error("a cell that no other leads to");
    route.push_back(cell + move->by);
  }
  std::reverse(route.begin(), route.end());
  return route;
}

}  // namespace strips
